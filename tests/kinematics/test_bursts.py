"""Bursts are found, movements are not."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.kinematics import find_bursts


def test_bursts_are_found_to_the_frame_and_movements_are_not(chain) -> None:
    rate = 100.0
    for seed in range(10):
        points = chain(seed, noise=5e-4, missing=0.02).points.copy()
        assert not find_bursts(points, rate).any()
        rng = np.random.default_rng(seed)
        truth = np.zeros(points.shape, dtype=bool)
        for marker in rng.choice(points.shape[1], 8, replace=False):
            start, length = rng.integers(5, 350), rng.integers(1, 30)
            truth[start : start + length, marker] = True
            points[start : start + length, marker] += rng.uniform(0.5, 0.9) * np.exp(1j * rng.uniform(0, 6))
        truth &= np.isfinite(points)
        assert (find_bursts(points, rate) == truth).all()


@pytest.mark.parametrize("length", [60, 200])
def test_a_marker_that_stays_elsewhere_is_no_burst(chain, length: int) -> None:
    points = chain(3).points.copy()
    points[100 : 100 + length, 6] += 0.7
    assert not find_bursts(points, 100.0).any()
