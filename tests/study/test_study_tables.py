"""The study's tables against numbers worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from study_cases import Made, body, landmarks

from mocap_id.config.study import Person
from mocap_id.dynamics.prediction import Agreement
from mocap_id.errors import ConfigError
from mocap_id.reporting.results import ResultTable
from mocap_id.workflows.study import sit_to_stand
from mocap_id.workflows.study.sit_to_stand import (
    STUDY,
    TABLES,
    length_rows,
    model_rows,
    parameter_rows,
    strategy_rows,
    variation_rows,
)
from mocap_id.workflows.study.study import find_mean_sd, pool_errors


def only(rows: list[dict[str, Any]], **wanted: object) -> dict[str, Any]:
    """The one row that has these values."""
    found = [row for row in rows if all(row.get(name) == value for name, value in wanted.items())]
    assert len(found) == 1, found
    return found[0]


def test_lengths_are_held_against_landmarks_and_stature_beside_them() -> None:
    """Table 6.1: s01's shank is 0.40 and 0.42 against 0.40 (0 and +5 %), s02's 0.36 (−10 %)."""
    one, two = landmarks(0.40, 0.40, height=1.75), landmarks(0.40, 0.40)
    cases = [
        Made("a", shank=0.40, person=one).case(),
        Made("b", shank=0.42, person=one).case(),
        Made("c", "s02", shank=0.36, person=two).case(),
    ]
    rows = length_rows(cases)
    own = only(rows, subject="s01", segment="shank", method="framework")
    assert (own["error_mean"], own["trials"]) == (pytest.approx(2.5), 2)
    assert own["error_sd"] == pytest.approx(5 / math.sqrt(2))
    assert own["reference"] == "landmarks"
    stature = only(rows, subject="s01", segment="shank", method="stature")
    assert stature["length_mean"] == pytest.approx(0.246 * 1.75)
    assert stature["error_mean"] == pytest.approx(100 * (0.246 * 1.75 / 0.40 - 1))
    assert only(rows, subject="s02", segment="shank", method="stature")["why"] == "the height is not given"
    cohort = only(rows, subject="cohort", segment="shank", method="framework")
    assert (cohort["subjects"], cohort["trials"]) == (2, 3)
    assert cohort["error_mean"] == pytest.approx((2.5 - 10) / 2), "each person counts once, whatever the trials"
    assert cohort["error_sd"] == pytest.approx(12.5 / math.sqrt(2))
    assert only(rows, subject="cohort", segment="shank", method="stature")["subjects"] == 1


def test_without_landmarks_lengths_are_held_against_stature() -> None:
    rows = length_rows([Made(person=Person(height=1.70)).case()])
    row = only(rows, subject="s01", segment="thigh")
    assert (row["reference"], row["method"]) == ("stature (winter)", "framework")
    assert row["error_mean"] == pytest.approx(100 * (0.42 / (0.245 * 1.70) - 1))
    assert math.isnan(row["error_sd"]), "one trial has no spread"


def test_references_of_two_kinds_are_not_averaged() -> None:
    people = (landmarks(0.40, 0.40), Person(height=1.70), Person())
    cases = [Made(f"t{k}", f"s{k}", person=person).case() for k, person in enumerate(people)]
    rows = length_rows(cases)
    kinds = [row["reference"] for row in rows if row["subject"] == "cohort" and row["segment"] == "shank"]
    assert kinds == ["landmarks", "stature (winter)"]
    nothing = only(rows, subject="s2", segment="shank")
    assert "neither landmarks_m nor height" in nothing["why"]
    assert math.isnan(nothing["error_mean"])
    assert nothing["length_mean"] == 0.40, "the length is known all the same"
    assert [row["reference"] for row in strategy_rows(cases) if row["subject"] == "cohort"] == [*kinds, ""]


def test_a_landmark_of_one_segment_says_nothing_of_the_other() -> None:
    rows = length_rows([Made(person=landmarks(0.40, None, height=1.7)).case()])
    assert (
        only(rows, subject="s01", segment="thigh", method="framework")["why"] == "landmarks_m does not give the thigh"
    )
    assert {row["segment"] for row in rows if row["subject"] == "cohort"} == {"shank"}


def test_strategies_average_over_people() -> None:
    """Table 6.2: s01 moves twice by the normal strategy (2 and 4 mm), s02 once (6 mm)."""
    person = landmarks(0.40, 0.40)
    cases = [
        Made("a", reprojection_mm=2.0, condition=50, person=person).case(),
        Made("b", reprojection_mm=4.0, condition=70, person=person).case(),
        Made("c", "s02", reprojection_mm=6.0, condition=90, thigh=0.44, person=person).case(),
        Made("d", "s02", "stable", reprojection_mm=9.0, person=person).case(),
        Made("e", "s02", "stable", failed="broken").case(),
    ]
    rows = strategy_rows(cases)
    assert only(rows, subject="s01", strategy="normal")["reprojection_mean"] == pytest.approx(0.003)
    cohort = only(rows, subject="cohort", strategy="normal")
    assert cohort["reprojection_mean"] == pytest.approx(0.0045)
    assert cohort["reprojection_sd"] == pytest.approx(0.003 / math.sqrt(2))
    assert cohort["condition_number_mean"] == pytest.approx(75)
    assert cohort["thigh_error_mean"] == pytest.approx((5 + 10) / 2)
    assert only(rows, subject="cohort", strategy="stable")["trials"] == 1


def test_every_model_meets_every_action_of_its_person_and_of_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def apply_model(source: Any, target: Any) -> Any:
        asked.append((source.name, target.name))
        raise ConfigError(f"{target.source}: the reason")

    monkeypatch.setattr(sit_to_stand, "apply_model", apply_model)
    own = (body("own", 0.0, 1.0), body("own, held out", 0.1, 1.0), body("winter", 3.0, 4.0, ((1.0, 2.0),)))
    cases = [
        Made("a", bodies=own).case(),
        Made("b", strategy="stable", bodies=own).case(),
        Made("c", "s02", bodies=own).case(),
        Made("d", "s02", failed="broken").case(),
    ]
    rows = model_rows(cases)
    assert asked == [("b", "a"), ("a", "b")]
    impossible = only(rows, action_trial="a", model_trial="b")
    assert (impossible["why"], impossible["model"], impossible["pairs"]) == ("the reason", "stable", 0)
    winter = only(rows, action_trial="c", model="winter")
    assert (winter["Fy_mean"], winter["Fy_sd"], winter["Fy_rms"]) == (3.0, 4.0, 5.0)
    assert (winter["tau_1_mean"], winter["tau_1_sd"]) == (1.0, 2.0)
    assert [row["model"] for row in rows if row["subject"] == "cohort" and row["action"] == "normal"] == [
        "winter",
        "own",
        "own, held out",
    ]


def test_a_model_without_a_body_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def apply_model(source: Any, target: Any) -> Any:
        assert source.name == "a", "the other one has nothing to apply"
        raise ConfigError("there is nothing to compare with")

    monkeypatch.setattr(sit_to_stand, "apply_model", apply_model)
    nothing = Made("b", value=None).case()
    assert nothing.identified is not None
    nothing.identified.parameters[:] = np.nan
    rows = model_rows([Made("a", bodies=(body("own", 0, 1),)).case(), nothing])
    assert "no body to transfer from b" in only(rows, action_trial="a", model_trial="b")["why"]


def test_pool_errors_errors_are_those_of_the_samples_put_together() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.normal(2, 1, 500), rng.normal(-1, 3, 500)
    errors = [Agreement(float(x.mean()), float(x.std()), 0.0) for x in (first, second)]
    together = np.concatenate([first, second])
    assert pool_errors([*errors, None]) == (pytest.approx(together.mean()), pytest.approx(together.std()))
    assert all(map(math.isnan, pool_errors([None])))


def test_mean_and_spread_leave_out_what_is_missing() -> None:
    assert find_mean_sd([1.0, None, math.nan, 5.0]) == (3.0, pytest.approx(math.sqrt(8)))
    assert all(map(math.isnan, find_mean_sd([])))


def test_modified_parameters_do_not_feel_a_turned_frame() -> None:
    """(mx2, my2) = 5 (cos, sin): mx2 varies, the length does not."""
    angles = (1.0, 1.2, 1.1)
    values = [(70.0, 1.0, 5 * math.cos(angle), 5 * math.sin(angle), 9.0) for angle in angles]
    cases = [Made(f"t{k}", value=value).case() for k, value in enumerate(values)]
    rows = variation_rows(cases)
    mr = only(rows, subject="s01", set="modified", parameter="mr2")
    assert (mr["mean"], mr["cv"], mr["unit"]) == (pytest.approx(5.0), pytest.approx(0.0, abs=1e-12), "kg*m")
    mx = only(rows, subject="s01", set="base", parameter="mx2")
    expected = [value[2] for value in values]
    assert mx["cv"] == pytest.approx(np.std(expected, ddof=1) / np.mean(expected))
    assert mr["reference_mean"] == 5.0
    names = [row["parameter"] for row in rows if row["subject"] == "s01" and row["set"] == "modified"]
    assert names == ["m1", "mx1", "mr2", "I2"]


def test_the_cohort_has_the_mean_of_the_peoples_coefficients() -> None:
    masses = {"s01": (70.0, 72.0), "s02": (80.0, 88.0), "s03": (60.0,)}
    cases = [
        Made(f"{subject}-{k}", subject, value=(mass, 1.0, 3.0, 4.0, 9.0)).case()
        for subject, own in masses.items()
        for k, mass in enumerate(own)
    ]
    rows = variation_rows(cases)
    first, second = math.sqrt(2) / 71, math.sqrt(32) / 84
    cohort = only(rows, subject="cohort", set="base", parameter="m1")
    assert (cohort["cv"], cohort["subjects"]) == (pytest.approx((first + second) / 2), 2)
    assert cohort["cv_sd"] == pytest.approx(abs(first - second) / math.sqrt(2))
    assert cohort["reference_cv"] == 0.0
    assert only(rows, subject="s03", set="base", parameter="m1")["why"] == "a single trial has no variation"


def test_what_is_zero_but_for_rounding_has_no_coefficient_of_variation() -> None:
    cases = [Made(f"t{k}", reference=(70.0, 2.0, 1e-17 * k, 5.0, 10.0)).case() for k in (1, 2)]
    row = only(variation_rows(cases), subject="s01", set="base", parameter="mx2")
    assert math.isnan(row["reference_cv"])


def test_trials_tell_failures_and_how_the_models_did() -> None:
    cases = [Made("a", bodies=(body("own", 3.0, 4.0),)).case(), Made("b", failed="it is broken").case()]
    good, bad = ResultTable.of(TABLES["trials"], cases).records
    assert (good["verdict"], good["codes"], good["complete"]) == ("caution", "joint-uncertain, parameters-weak", 1)
    assert (good["cop_x_own_rms"], good["reprojection"]) == (5.0, 0.002)
    assert (bad["verdict"], bad["exit_code"], bad["message"]) == ("failed", 3, "it is broken")


def test_times_are_taken_where_the_movement_is_timed() -> None:
    times = {"to_fifth_stand_s": 9.5, "to_fifth_seat_contact_s": 10.75, "mean_cycle_s": 2.0, "failed_attempts": 1}
    timed, other = ResultTable.of(TABLES["trials"], [Made("a", five_times=times).case(), Made("b").case()]).records
    assert (timed["five_times"], timed["five_times_seated"]) == (9.5, 10.75)
    assert (timed["cycle"], timed["failed_attempts"]) == (2.0, 1)
    assert other["five_times"] is None


def test_every_parameter_stands_with_its_deviation() -> None:
    rows = list(parameter_rows([Made("a").case(), Made("b", value=None).case()]))
    assert [row["parameter"] for row in rows] == ["m1", "mx1", "mx2", "my2", "I2"]
    assert (rows[2]["value"], rows[2]["sd"], rows[2]["reference"]) == (3.0, 0.1, 0.0)
    assert [row["verdict"] for row in rows] == ["known"] * 4 + ["weak"]


def test_a_study_without_any_success_has_whole_if_empty_tables() -> None:
    made = STUDY.make_tables([Made("a", failed="broken").case()])
    assert list(made) == list(TABLES)
    assert len(made["trials"].frame) == 1
    assert made["models"].frame.empty
    for name, schema in TABLES.items():
        assert [column.name for column in schema.columns] == list(made[name].frame.columns), name


def test_a_row_may_not_hold_what_the_columns_do_not_name() -> None:
    with pytest.raises(ValueError, match=r"lengths\.parquet has no columns \['wrong'\]"):
        ResultTable.of(TABLES["lengths"], [{"wrong": 1}])
