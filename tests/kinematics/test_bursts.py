"""Detection of bursts without false alarms for movements."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.kinematics.marker_faults import find_bursts

RATE = 100.0


def spatial(plane: np.ndarray, noise: float = 5e-4) -> np.ndarray:
    """Return positions (F, M, 3) from complex (F, M), with noise out of the plane."""
    z = np.random.default_rng(0).normal(0, noise, plane.shape)
    return np.stack([plane.real, plane.imag, np.where(np.isfinite(plane), z, np.nan)], axis=2)


@pytest.mark.parametrize("sizes", [(0.02, 0.08), (0.5, 0.9)])
def test_bursts_are_found_to_the_frame_and_movements_are_not(chain, sizes: tuple[float, float]) -> None:
    for seed in range(10):
        points = spatial(chain(seed, noise=5e-4, missing=0.02).points)
        assert not find_bursts(points, RATE).any()
        rng = np.random.default_rng(seed)
        truth = np.zeros(points.shape[:2], dtype=bool)
        for marker in rng.choice(points.shape[1], 8, replace=False):
            start, length = rng.integers(5, 290), rng.integers(1, 100)
            truth[start : start + length, marker] = True
            direction = rng.normal(0, 1, 3)
            points[start : start + length, marker] += rng.uniform(*sizes) * direction / np.linalg.norm(direction)
        truth &= np.isfinite(points[..., 0])
        assert (find_bursts(points, RATE) == truth).all()


def test_a_burst_within_a_burst(chain) -> None:
    points = spatial(chain(3).points)
    points[100:180, 6] += [0.05, 0.0, 0.0]
    points[130:150, 6] += [0.0, 0.04, 0.03]
    truth = np.zeros(points.shape[:2], dtype=bool)
    truth[100:180, 6] = True
    assert (find_bursts(points, RATE) == truth).all()


def test_a_marker_that_comes_back_another_way(chain) -> None:
    """It counts as a reflection that drifts."""
    points = spatial(chain(3).points)
    points[100:120, 6] += np.linspace([0.3, 0.0, 0.1], [0.15, 0.2, 0.0], 20)
    truth = np.zeros(points.shape[:2], dtype=bool)
    truth[100:120, 6] = True
    assert (find_bursts(points, RATE) == truth).all()


@pytest.mark.parametrize("length", [200, 250])
def test_a_marker_that_stays_elsewhere_is_no_burst(chain, length: int) -> None:
    points = spatial(chain(3).points)
    points[100 : 100 + length, 6, 0] += 0.7
    assert not find_bursts(points, RATE).any()
