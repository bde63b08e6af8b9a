"""Instant of zero chair force, on curves with an exactly known end."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import betainc

from mocap_id.protocols.sit_to_stand import estimate_noise_on_chair, extend_contact_to_release, extrapolate_release

RATE, END, FULL, NOISE = 100.0, 2.0, 450.0, 0.8
TIME = np.arange(0.0, 4.0, 1 / RATE)


def unloading(lasts: float, first: float, last: float) -> np.ndarray:
    """Force of a chair that is fully loaded until ``lasts`` s before the end, with a smooth decrease."""
    return FULL * betainc(last, first, np.clip((END - TIME) / lasts, 0.0, 1.0))


COURSES = [(0.25, 5, 5), (0.4, 5, 5), (0.6, 5, 5), (0.4, 2, 3), (0.4, 3, 2), (0.3, 1, 1)]


@pytest.mark.parametrize(("lasts", "first", "last"), COURSES)
def test_the_release_is_extrapolated_beyond_the_visible_force(lasts: float, first: float, last: float) -> None:
    rng, late, seen = np.random.default_rng(0), [], []
    for _ in range(20):
        force = unloading(lasts, first, last) + NOISE * rng.normal(size=len(TIME))
        shown = TIME[np.flatnonzero(unloading(lasts, first, last) > 4 * NOISE)[-1]]
        late.append(extrapolate_release(TIME, force, shown, FULL) - END)
        seen.append(shown - END)
    assert abs(np.median(late)) < 0.07 * lasts
    assert np.max(np.abs(late)) < 0.06
    assert abs(np.median(late)) < 0.6 * abs(np.median(seen)) + 0.01


def test_without_noise_a_power_is_found_to_a_millisecond() -> None:
    force = 3000.0 * np.maximum(END - TIME, 0.0) ** 3
    assert extrapolate_release(TIME, force, END - 0.15, FULL) == pytest.approx(END, abs=1e-3)


def test_a_sudden_release_is_found_within_its_sample() -> None:
    force = np.where(TIME <= END, FULL, 0.0)
    assert END <= extrapolate_release(TIME, force, END, FULL) <= END + 1 / RATE


def test_a_touch_is_a_release_in_reverse() -> None:
    force = unloading(0.4, 5, 5)
    there = force > 4 * NOISE
    mirrored = extend_contact_to_release(TIME, there[::-1].copy(), force[::-1].copy())
    np.testing.assert_array_equal(mirrored, extend_contact_to_release(TIME, there, force)[::-1])
    assert extend_contact_to_release(TIME, there, force).sum() > there.sum()


def test_unknown_samples_do_not_matter() -> None:
    force = np.full(len(TIME), np.nan)
    there = TIME < 2.0
    np.testing.assert_array_equal(extend_contact_to_release(TIME, there, force), there)


@pytest.mark.parametrize(("of_motion", "of_plate"), [(2.0, 0.2), (0.0, 1.0), (3.0, 1.0)])
def test_noise_on_the_chair_is_found_from_samples_above_it(of_motion: float, of_plate: float) -> None:
    """Noise of the motion acts on Fy through bent legs, so a long stand shows only the noise of the plate."""
    rng = np.random.default_rng(1)
    height = np.concatenate([np.full(1200, 0.98), rng.uniform(0.35, 0.95, 300), [np.nan]])
    sd = np.hypot(of_plate, of_motion * np.sqrt(1 - height**2))
    noise = rng.normal(size=len(height)) * sd
    assert estimate_noise_on_chair(noise, height) == pytest.approx(np.hypot(of_motion, of_plate), rel=0.12)
    assert estimate_noise_on_chair(np.full(3, np.nan), np.zeros(3)) == 0.0
