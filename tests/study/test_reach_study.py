"""Tables, figures and page of a reach study from given results."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from reach_cases import THESIS, Reach, results
from scipy.stats import spearmanr

from mocap_id.reporting.figure import Figure, Line, Panel
from mocap_id.reporting.study import CohortData
from mocap_id.reporting.study.reach import draw_reach_figures
from mocap_id.workflows.study.arms import REACHES, make_reach_page, make_shape
from mocap_id.workflows.study.study import IntervalEstimate, correlate_ranks


def frames(reaches: Sequence[Reach]) -> dict[str, pd.DataFrame]:
    return {name: table.frame for name, table in REACHES.make_tables(results(reaches)).items()}


def page(reaches: Sequence[Reach]) -> str:
    trials = results(reaches)
    entries = tuple(trial.entry(trial.name, trial.subject, f"../{trial.name}/report.html") for trial in trials)
    return make_reach_page(CohortData("a study", entries, REACHES.make_tables(trials)), trials).decode()


def test_the_thesis_table_has_its_order_and_its_correlation() -> None:
    found = frames(THESIS)
    people = found["people"]
    assert people["subject"].tolist()[:4] == ["healthy1", "healthy2", "healthy3", "patient1"]
    assert people["score"].tolist()[3:] == [1.0, 2.0, 3.0, 5.0]
    assert people.loc[3, ["volume", "volume_low", "volume_high"]].tolist() == pytest.approx([0.358, 0.338, 0.378])
    volume = found["correlation"].iloc[0]
    assert volume["people"] == 4
    assert volume["spearman"] == -1.0
    assert volume["p"] == pytest.approx(2 / 24)
    assert volume["spearman_high"] > 0, "four people in perfect order prove nothing"


def test_a_person_is_the_mean_of_both_sides() -> None:
    reaches = [Reach(volume=0.3), Reach(session="b", volume=0.2), Reach(side="left", volume=0.1, error=0.04)]
    (row,) = frames(reaches)["people"].to_dict("records")
    assert row["volume"] == pytest.approx(0.175)
    assert (row["volume_right"], row["volume_left"]) == pytest.approx((0.25, 0.1))
    assert row["volume"] - row["volume_low"] == pytest.approx(0.03), "errors of one person's trials may be common"


def test_differences_are_paired() -> None:
    reaches = [
        Reach(subject, side, session, volume=volume + (0.02 if session == "b" else 0) - (0.05 if side == "left" else 0))
        for subject, volume in (("p1", 0.3), ("p2", 0.2), ("p3", 0.1))
        for side in ("right", "left")
        for session in ("a", "b")
    ]
    reaches += [Reach("alone", "left", "a", volume=0.4)]
    found = frames(reaches)["differences"]
    volume = found[found["measure"] == "volume"]
    cohort = volume[volume["subject"] == "cohort"].set_index("comparison")
    assert cohort.loc["left - right", ["people", "difference"]].tolist() == pytest.approx([3, -0.05])
    assert cohort.loc["b - a", ["people", "difference", "sd"]].tolist() == pytest.approx([3, 0.02, 0.0])
    one = volume[(volume["subject"] == "p2") & (volume["label"] == "left")].iloc[0]
    assert one["difference_high"] - one["difference"] == pytest.approx(0.02 * 2**0.5)
    assert "alone" not in set(volume["subject"])


def test_the_interval_of_a_mean_difference_is_students() -> None:
    volumes = {"p1": (0.30, 0.33), "p2": (0.20, 0.21), "p3": (0.1, 0.15)}
    reaches = [
        Reach(name, "right", s, volume=v) for name, two in volumes.items() for s, v in zip("ab", two, strict=True)
    ]
    found = frames(reaches)["differences"]
    row = found[(found["measure"] == "volume") & (found["subject"] == "cohort")].iloc[0]
    half = 4.302653 * np.std([0.03, 0.01, 0.05], ddof=1) / 3**0.5  # t table, 2 degrees of freedom
    assert row["difference_high"] - row["difference"] == pytest.approx(half)


def test_an_unknown_volume_and_a_failure_are_rows_with_a_reason() -> None:
    found = frames([Reach(), Reach(session="b", volume=None), Reach("p2", failed="no such file", score=None)])
    trials = found["trials"].set_index("trial")
    assert trials.loc["p1-right-b", "why"] == "no forearm"
    assert trials.loc["p2-right-a", ["verdict", "message"]].tolist() == ["failed", "no such file"]
    people = found["people"].set_index("subject")
    assert people.loc["p1", ["trials", "of_trials"]].tolist() == [1, 2]
    assert np.isnan(people.loc["p2", "volume"])
    assert found["correlation"]["spearman"].isna().all()
    assert found["differences"].empty


def test_the_page_shows_table_and_shapes() -> None:
    text = page(THESIS)
    for words in ("thesis table 7.1", "0.358 (0.338 … 0.378)", "patient4 (5)", "Reachable volumes, left and right"):
        assert words in text
    empty = page([Reach(volume=None), Reach("p2", failed="gone")])
    assert "No reachable volume: no trial has one." in empty
    assert "Correlation with" not in empty


def test_sides_and_sessions_are_drawn_on_one_scale_and_can_be_turned() -> None:
    reaches = [
        Reach(name, side, session, volume=volume * scale)
        for name, volume in (("p1", 0.3), ("p2", 0.1))
        for side, scale in (("right", 1.0), ("left", 0.9))
        for session in ("a", "b")
    ]
    reaches.append(Reach("p3", volume=0.2))
    trials = results(reaches)
    data = CohortData("a study", (), REACHES.make_tables(trials))
    drawn = {one.name: one.figure for one in draw_reach_figures(data, tuple(map(make_shape, trials))).all}
    sides, sessions = drawn["reach-sides"], drawn["reach-sessions"]
    assert isinstance(sides, Figure)
    assert isinstance(sessions, Figure)
    assert [panel.title for panel in sides.panels] == ["p1 (1)", "p2 (1)", "p3 (1)"]
    assert [panel.title for panel in sessions.panels] == [
        *("p1 (1), right", "p1 (1), left", "p2 (1), right", "p2 (1), left", "p3 (1), right")
    ]
    assert len({panel.x_range for panel in (*sides.panels, *sessions.panels)}) == 1
    for panel in (*sides.panels, *sessions.panels):
        assert panel.view is not None
        assert panel.x_range == panel.y_range
        ends = np.array([[item.x, item.y, item.z] for item in panel.items if isinstance(item, Line)], dtype=object)
        assert all(np.nanmax(np.abs(each)) < panel.x_range[1] for row in ends for each in row)
    assert labels(sides.panels[0]) == ["right", "left"]
    assert labels(sides.panels[2]) == ["right"]
    assert labels(sessions.panels[0]) == ["a", "b"]
    assert draw_reach_figures(
        CohortData("s", (), REACHES.make_tables(results(THESIS))), tuple(map(make_shape, results(THESIS)))
    ).all[2].figure == ("Every trial belongs to the same session.")


def labels(panel: Panel) -> list[str]:
    return [item.label for item in panel.items if isinstance(item, Line) and item.label]


@pytest.mark.parametrize("n", [5, 6])
def test_correlation_is_that_of_scipy(n: int) -> None:
    rng = np.random.default_rng(n)
    x, y = rng.integers(0, 4, n).astype(float), rng.normal(size=n)
    estimate, p, _ = correlate_ranks(x, y)
    reference = spearmanr(x, y).statistic
    assert estimate.value == pytest.approx(reference)
    orders = [spearmanr(x, order).statistic for order in permutations(y)]
    assert p == pytest.approx(np.mean(np.abs(orders) >= abs(reference) - 1e-9))
    assert estimate.low <= reference <= estimate.high


def test_the_interval_of_a_correlation_holds_the_truth() -> None:
    rng = np.random.default_rng(3)
    held, trials, pearson = 0, 30, 0.7
    for _ in range(trials):
        x = rng.normal(size=9)
        y = pearson * x + np.sqrt(1 - pearson**2) * rng.normal(size=9)
        estimate = correlate_ranks(np.searchsorted([-1.0, 0.0, 1.0], x).astype(float), y)[0]
        held += estimate.low <= 6 / np.pi * np.arcsin(pearson / 2) <= estimate.high
    assert held >= 0.88 * trials


def test_too_few_people_or_equal_scores_have_no_correlation() -> None:
    assert np.isnan(correlate_ranks(np.arange(3.0), np.arange(3.0))[0].value)
    assert np.isnan(correlate_ranks(np.ones(9), np.arange(9.0))[0].value)


def test_a_difference_combines_the_intervals_on_their_sides() -> None:
    found = IntervalEstimate(5.0, 4.0, 7.0).minus(IntervalEstimate(3.0, 0.0, 3.5))
    assert (found.value, found.low, found.high) == pytest.approx((2.0, 2 - 1.25**0.5, 2 + 13**0.5))
