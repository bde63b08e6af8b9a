"""The clock offset: found to a hundredth of a millisecond, of either sign, between samples."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, moving_body, waves

from mocap_id.dynamics.fit import fit
from mocap_id.dynamics.preparation import FitSettings, SampledWrench, TrialData, prepare, profile_offset
from mocap_id.dynamics.regressor import planar_regressor


def late_plate(offset: float, **noise: tuple[float, float, float]) -> TrialData:
    """A plate whose sample stamped t was taken at t + offset."""
    recorded = moving_body(seconds=15.0, **noise)
    taken = recorded.time + offset
    wrench = planar_regressor(CENTRES, *waves(taken, 3)) @ BODY.ravel()
    noise_only = recorded.wrench - moving_body(seconds=15.0).wrench
    return TrialData(**{**recorded.__dict__, "wrench": wrench + noise_only})


@pytest.mark.parametrize("offset", [-0.0873, -0.0101, 0.0, 0.0034, 0.007, 0.1])
def test_offset_is_found_and_its_interval_holds_it(offset: float) -> None:
    prepared = prepare(late_plate(offset, noise=(1.0, 1.0, 0.3)), FitSettings())
    found = fit(prepared, np.ones(len(prepared.recorded.time), dtype=bool))
    assert found.offset_known
    assert found.offset == pytest.approx(offset, abs=2e-4)
    assert abs(found.best_offset - offset) < 4 * np.sqrt(found.covariance[-1, -1])


def test_without_noise_it_is_exact() -> None:
    prepared = prepare(late_plate(0.0123), FitSettings())
    assert fit(prepared, np.ones(1500, dtype=bool)).best_offset == pytest.approx(0.0123, abs=1e-5)


def test_an_offset_beyond_the_limit_is_not_known_and_not_applied() -> None:
    prepared = prepare(late_plate(0.12), FitSettings(offset_limit=0.05))
    found = fit(prepared, np.ones(1500, dtype=bool))
    assert abs(found.best_offset) == pytest.approx(0.05)
    assert not found.offset_known
    assert found.offset == 0.0


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("limit", [0.01, 0.012, 0.013, 0.043, 0.0449, 0.05])
def test_no_minimum_within_any_limit_is_never_taken_for_one(limit: float, sign: int) -> None:
    """Limits that are no multiple of the search's step: it must end at them, not short of or beyond them."""
    prepared = prepare(late_plate(sign * 0.12), FitSettings(offset_limit=limit))
    found = fit(prepared, np.ones(1500, dtype=bool))
    assert found.best_offset == pytest.approx(sign * limit)
    assert not found.offset_known


def test_an_offset_close_to_the_limit_is_known() -> None:
    found = fit(prepare(late_plate(0.0425), FitSettings(offset_limit=0.043)), np.ones(1500, dtype=bool))
    assert found.offset_known
    assert found.offset == pytest.approx(0.0425, abs=2e-4)


def test_it_can_be_found_and_left_in() -> None:
    prepared = prepare(late_plate(0.02), FitSettings(apply_offset=False))
    found = fit(prepared, np.ones(1500, dtype=bool))
    assert found.best_offset == pytest.approx(0.02, abs=2e-3)
    assert found.offset == 0.0


def test_seven_milliseconds_matter() -> None:
    """What the offset costs where it is not taken out: the reason for finding it."""
    recorded = late_plate(0.007)
    truth = np.array([55.0 * 0.41 + 3.4])  # my3 + p4y m4
    errors = []
    for apply in (True, False):
        prepared = prepare(recorded, FitSettings(apply_offset=apply))
        base = fit(prepared, np.ones(1500, dtype=bool)).problem.free_solution()
        errors.append(abs(base[6] / truth[0] - 1))
    assert errors[0] < 1e-4
    assert errors[1] > 20 * errors[0]


def test_interpolation_keeps_gaps_open() -> None:
    time = np.arange(0, 2, 0.01)
    values = np.column_stack([np.sin(time), np.cos(time)])
    values[80:90] = np.nan
    sampled = SampledWrench(time, values)
    between = np.array([0.505, 0.85, 1.503, 2.5])
    found = sampled(between)
    np.testing.assert_allclose(found[[0, 2]], np.column_stack([np.sin(between), np.cos(between)])[[0, 2]], atol=1e-7)
    assert np.isnan(found[[1, 3]]).all()
    np.testing.assert_allclose(sampled(between, derivative=1)[0], [np.cos(0.505), -np.sin(0.505)], atol=1e-5)


def test_profile_needs_no_good_start() -> None:
    """The coarse search holds the whole range, so a second minimum far from zero is not taken for the first."""
    time = np.arange(0, 10, 0.01)
    wave = np.sin(2 * np.pi * 8 * time) * np.exp(-(((time - 5) / 0.8) ** 2))
    regressor = wave[:, None, None]
    sampled = SampledWrench(time, np.interp(time + 0.09, time, wave)[:, None])
    inner = slice(100, -100)
    found, at_edge = profile_offset(regressor[inner], sampled, time[inner], np.ones(1), 0.15)
    assert found == pytest.approx(0.09, abs=2e-3)
    assert not at_edge
