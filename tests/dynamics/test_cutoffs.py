"""The search for cut-offs: it finds the least error, and says why it looked no further."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mocap_id.dynamics.identification import Cutoffs, LeftOutPrediction, choose_cutoffs, score_left_out
from mocap_id.dynamics.measured_motion import CUTOFFS, USUAL

SAMPLES = 40


def held(rms: np.ndarray) -> LeftOutPrediction:
    """Predictions that are off by these errors (3,), within the band; what is not left out is not predicted."""
    left_out = np.arange(SAMPLES) < 30
    sign = np.where(np.arange(SAMPLES) % 2, 1.0, -1.0)[:, None]
    wrench = np.where(left_out[:, None], 100.0 + sign * rms, 1e9)
    measured, nothing = np.full((SAMPLES, 3), 100.0), np.full((SAMPLES, 3), np.nan)
    return LeftOutPrediction(
        left_out, np.zeros(SAMPLES, dtype=int), nothing, nothing, wrench, measured, np.zeros((1, 4)), np.zeros(1)
    )


def bowl(best: Cutoffs) -> tuple[list[Cutoffs], object]:
    """Errors that grow by the square of the steps from the best cut-offs; a record of what was asked for."""
    asked: list[Cutoffs] = []

    def predicted(bands: Cutoffs) -> LeftOutPrediction:
        asked.append(bands)
        steps = np.array([CUTOFFS.index(a) - CUTOFFS.index(b) for a, b in zip(bands, best, strict=True)])
        return held(np.array([5.0, 3.0, 1.0]) * np.exp(0.02 * steps**2))

    return asked, predicted


@pytest.mark.parametrize("best", list(itertools.product((2.5, 4.0, 8.0), repeat=3)))
def test_the_least_of_a_convex_cost_is_found(best: Cutoffs) -> None:
    asked, predicted = bowl(best)
    bands, why, cost = choose_cutoffs(predicted)  # type: ignore[arg-type]
    assert bands == best
    assert cost == pytest.approx(np.log(15.0), abs=1e-6)
    assert "best" in why
    assert len(asked) == len(set(asked))  # none is tried twice
    assert asked[0] == USUAL


def test_what_hardly_matters_leaves_the_usual_cut_offs() -> None:
    better = {(2.5, 5.0, 4.0): 0.9995, (3.0, 6.0, 4.0): 0.9995}
    chosen, _, _ = choose_cutoffs(lambda bands: held(np.array([5.0 * better.get(bands, 1.0), 3.0, 1.0])))
    assert chosen == USUAL


def test_without_predictions_the_usual_ones_are_taken() -> None:
    asked: list[Cutoffs] = []

    def nothing(bands: Cutoffs) -> None:
        asked.append(bands)

    chosen, why, cost = choose_cutoffs(nothing)
    assert asked == [USUAL]
    assert chosen == USUAL
    assert cost == np.inf
    assert "no repetition" in why


def test_cut_offs_without_predictions_are_not_better() -> None:
    chosen, _, cost = choose_cutoffs(lambda bands: held(np.ones(3)) if bands == USUAL else None)
    assert chosen == USUAL
    assert np.isfinite(cost)


def test_the_cost_is_the_sum_of_the_logarithms_of_the_rms_errors() -> None:
    rms = np.array([4.0, 0.5, 0.02])
    assert score_left_out(held(rms)) == pytest.approx(np.sum(np.log(rms)), abs=1e-6)
    assert score_left_out(None) == np.inf
    found = held(rms)
    found.filtered[2, 1] = np.nan  # a sample of which a part is unknown does not count
    found.filtered_measured[2] = 1e6
    assert score_left_out(found) == pytest.approx(np.sum(np.log(rms)), abs=1e-6)
    found.filtered[:] = np.nan
    assert score_left_out(found) == np.inf
