"""Required accuracy of the filter on simulated recordings with the true chain."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.estimation import States, smooth
from mocap_id.estimation.filter_problem import MarkerChain

pytestmark = pytest.mark.recordings


@dataclass(frozen=True)
class Scored:
    states: States
    error: FloatArray
    r2: FloatArray


def scored(folder: Path) -> Scored:
    """Smooth a trial with its true chain and plane."""
    truth = json.loads((folder / "truth.json").read_text())
    file = ezc3d.c3d(str(folder / "trial.c3d"))
    labels = [label.split(":")[-1] for label in file["parameters"]["POINT"]["LABELS"]["value"]]
    markers, plane = truth["markers"], truth["plane"]
    points = file["data"]["points"][:3, [labels.index(marker["label"]) for marker in markers]]
    lab = 1e-3 * (np.moveaxis(points, 0, -1).swapaxes(0, 1) - plane["origin_lab_mm"])
    states = smooth(
        np.stack([lab @ plane["x_axis_lab"], lab @ plane["y_axis_lab"]], axis=-1),
        truth["point_rate_hz"],
        MarkerChain(
            np.array([segment["p_in_parent_m"] for segment in truth["segments"][1:]]),
            np.array([marker["segment"] for marker in markers]),
            np.array([marker["local_xyz_m"][:2] for marker in markers]),
        ),
    )
    with np.load(folder / "truth.npz") as arrays:
        true = np.stack([arrays[name] for name in ("q", "qd", "qdd", "qddd")], axis=-1)
    error = states.mean - true
    return Scored(states, error, 1.0 - (error**2).mean(axis=0) / true.var(axis=0))


@pytest.mark.parametrize(
    ("trial", "angle_deg", "acceleration_r2"),
    [
        ("sts-normal-clean", 0.001, 0.9999),
        ("sts-normal", 0.1, 0.999),
        ("sts-dynamic", 0.1, 0.999),
        ("ur5-elbow-fast", 0.01, 0.999),
    ],
)
def test_angles_and_accelerations(recordings: Path, trial: str, angle_deg: float, acceleration_r2: float) -> None:
    result = scored(recordings / "simulated" / trial)
    rmse = np.degrees(np.sqrt((result.error[..., 0] ** 2).mean(axis=0)))
    assert np.all(rmse <= angle_deg)
    assert np.all(result.r2[:, 2] >= acceleration_r2)
    assert result.states.observed.all()


def test_stated_intervals_of_velocity_and_acceleration_cover_despite_soft_tissue(recordings: Path) -> None:
    result = scored(recordings / "simulated" / "sts-normal")
    inside = np.abs(result.error) <= 1.96 * result.states.sd
    assert np.all(inside[..., 1:3].mean(axis=0) >= 0.95)
