"""The still pose, and landmarks tied to clusters in it."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.anatomy.landmarks import find_still_pose, locate_landmarks
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.geometry import so3

RATE = 100.0


def trial(quiet: slice, seconds: float = 8.0) -> FloatArray:
    """Ten markers that sway, and swing by 0.3 m outside the quiet samples."""
    rng = np.random.default_rng(1)
    time = np.arange(int(seconds * RATE)) / RATE
    swing = 0.3 * np.sin(4 * (time - time[quiet.start])) * np.where(time < time[quiet.start], 1, 0)
    late = np.where(np.arange(len(time)) >= quiet.stop, 0.3 * np.sin(4 * (time - time[quiet.stop - 1])), 0)
    path = (swing + late)[:, None, None] * np.array([1.0, 0.5, 0.0])
    sway = 0.003 * np.sin(2 * time)[:, None, None] * np.array([1.0, 0.0, 1.0])
    return rng.normal(size=(10, 3)) + path + sway + 0.0005 * rng.normal(size=(len(time), 10, 3))


def test_the_longest_quiet_interval_is_found() -> None:
    quiet = slice(250, 470)
    points = trial(quiet)
    points[300:303] = np.nan
    points[:, 3] = np.nan
    found = find_still_pose(points, RATE)
    assert not found.reasons
    assert abs(found.frames.start - quiet.start) < 15
    assert abs(found.frames.stop - quiet.stop) < 15


def test_a_given_interval_is_used_and_judged() -> None:
    points = trial(slice(250, 470))
    assert not find_still_pose(points, RATE, (3.0, 4.0)).reasons
    moving = find_still_pose(points, RATE, (5.0, 6.0))
    assert moving.frames == slice(500, 601)
    assert [reason.code for reason in moving.reasons] == ["no-still-pose"]
    with pytest.raises(RecordingError, match="outside"):
        find_still_pose(points, RATE, (20.0, 21.0))


def test_without_rest_the_quietest_moment_is_taken_with_a_caution() -> None:
    points = trial(slice(250, 252))
    found = find_still_pose(points, RATE)
    assert [reason.code for reason in found.reasons] == ["no-still-pose"]


def test_landmarks_are_tied_by_the_still_pose_and_hidden_ones_by_the_rest() -> None:
    rng = np.random.default_rng(7)
    count = 300
    rotations = so3.exp(np.cumsum(0.02 * rng.normal(size=(count, 1, 3)), axis=0))
    origins = np.cumsum(0.01 * rng.normal(size=(count, 1, 3)), axis=0)
    local = {"EL": np.array([0.03, -0.3, 0.01]), "EM": np.array([-0.03, -0.3, 0.0]), "GH": np.zeros(3)}
    skin = np.where(np.arange(count) < 100, 0.0, 0.02)[:, None] * np.array([0.0, 1.0, 0.0])
    noise = 0.0005 * rng.normal(size=(3, count, 3))
    points = {
        name: np.einsum("fij,fj->fi", rotations[:, 0], at + skin + noise[i]) + origins[:, 0]
        for i, (name, at) in enumerate(local.items())
    }
    points["EM"][:150] = np.nan
    points["GH"][:] = np.nan
    places, reasons = locate_landmarks(
        points, dict.fromkeys(points, 0), rotations, origins, frames=slice(0, 100), palpation=0.001
    )
    assert np.allclose(places["EL"].local, local["EL"], atol=2e-4)
    assert places["EL"].sd == pytest.approx(0.001, rel=0.01)
    assert np.allclose(places["EM"].local, local["EM"] + [0, 0.02, 0], atol=2e-4)
    assert "GH" not in places
    assert [(r.code, r.level) for r in reasons] == [("landmark-hidden", "ok"), ("landmark-hidden", "caution")]
