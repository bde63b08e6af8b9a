"""Pointer trials: the tip, the landmark, and a pointer that calibrates itself."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.anatomy.frames import PALPATION
from mocap_id.anatomy.landmarks import calibrate_pointer, locate_pointed_landmark, locate_tip
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.geometry import so3

DISTANCES = np.array([0.46, 0.37, 0.27, 0.15])


def touch(swing: float, seed: int = 0, noise: float = 0.0005) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return markers, cluster rotation and origin (200 frames), and the landmark in the cluster, for a turning rod."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2, 200)
    rotation = so3.exp(0.1 * np.stack([np.sin(t), np.cos(t), t], axis=1) + rng.normal(size=3))
    origin = 0.05 * np.stack([np.sin(2 * t), t, np.cos(t)], axis=1) + rng.normal(size=3)
    place = rng.normal(size=3) * 0.1
    lean = (
        rotation
        @ so3.exp(rng.normal(size=3))
        @ so3.exp(swing * np.stack([np.sin(3 * t), np.cos(2 * t), 0 * t], axis=1))
    )
    tip = np.einsum("fij,j->fi", rotation, place) + origin
    markers = tip[:, None] + DISTANCES[None, :, None] * lean[:, None, :, 2]
    return markers + noise * rng.normal(size=markers.shape), rotation, origin, place


def test_the_landmark_is_found_in_the_cluster() -> None:
    markers, rotation, origin, place = touch(0.02)
    markers[20:30, 2] = np.nan
    position, reasons = locate_pointed_landmark(markers, rotation, origin, (DISTANCES, 0.0))
    assert np.allclose(position.local, place, atol=5e-4)
    assert not reasons
    assert position.sd == pytest.approx(PALPATION, rel=0.05)
    tip, residual = locate_tip(markers, DISTANCES)
    assert np.isnan(tip[20:30]).all() and np.isnan(residual[20:30]).all()
    assert np.sqrt(np.nanmean(residual**2)) < 0.001


def test_a_wrong_geometry_or_a_sliding_tip_is_told() -> None:
    markers, rotation, origin, _ = touch(0.02)
    _, wrong = locate_pointed_landmark(markers, rotation, origin, (DISTANCES[::-1].copy() * [1, 0.8, 1.2, 1], 0.0))
    assert "pointer-bent" in [reason.code for reason in wrong]
    slid = markers + np.linspace(0, 0.04, 200)[:, None, None]
    _, moves = locate_pointed_landmark(slid, rotation, origin, (DISTANCES, 0.0))
    assert "pointer-moves" in [reason.code for reason in moves]
    with pytest.raises(RecordingError, match="one distance for each marker"):
        locate_tip(markers, DISTANCES[:2])
    with pytest.raises(RecordingError, match="never visible in the same frame"):
        locate_pointed_landmark(markers, np.full_like(rotation, np.nan), origin, (DISTANCES, 0.0))


@pytest.mark.parametrize("reverse", [False, True])
def test_a_turning_pointer_shows_its_tip_and_its_error_is_covered(reverse: bool) -> None:
    errors = []
    for seed in range(12):
        markers, rotation, origin, _ = touch(0.4, seed, noise=0.001)
        found, sd = calibrate_pointer([((markers[:, ::-1] if reverse else markers), rotation, origin)])
        truth = DISTANCES[::-1] if reverse else DISTANCES
        errors.append(np.mean(found - truth))
        assert abs(errors[-1]) < 4 * sd + 1e-4
        assert sd < 0.005
    assert np.sqrt(np.mean(np.square(errors))) < 0.001


def test_a_still_pointer_does_not_show_its_tip() -> None:
    markers, rotation, origin, _ = touch(0.003)
    with pytest.raises(RecordingError, match="rotates too little"):
        calibrate_pointer([(markers, rotation, origin)])
