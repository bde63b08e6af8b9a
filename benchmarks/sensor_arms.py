"""Arms in space with inertial sensors, compared with markers alone and with a gap of all markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import harness
import numpy as np
from harness import Comparison, Run
from sensor_conditions import compute_clock_errors
from space import TO_TRIAL, compute_rms_length, stack_columns

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.geometry import so3
from mocap_id_simulation import ArmOptions, generate_arm, write_arm
from mocap_id_simulation.options import Preset
from mocap_id_simulation.trial_files import points_bytes

ACCELERATION: Mapping[Preset, float] = {"default": 0.26, "hard": 0.30}
"""Largest angular acceleration error of the forearm with sensors, rad/s²."""
_ON = ("thorax", "upper_arm", "forearm")


@dataclass(frozen=True)
class _Errors:
    """Errors of a run, of thorax, upper arm and forearm in the axes of the trial."""

    done: Run
    turn: FloatArray  # (F, 3, 3) of the rotation, rad, without its constant
    rate: FloatArray  # (F, 3, 3) of the angular velocity, rad/s
    gain: FloatArray  # (F, 3, 3) of the angular acceleration, rad/s²
    sd: FloatArray  # (3, F, 3) standard deviations of these per axis


def list_limits(preset: Preset) -> dict[str, float]:
    """Return the limits of the errors of :func:`measure`."""
    accelerations = (
        "acceleration of the forearm, rad/s²",
        "from markers alone, rad/s²",
        "acceleration of the upper arm, rad/s²",
        "of the upper arm from markers alone, rad/s²",
    )
    rotations = [
        f"{name} in {gap}, degrees"
        for gap in ("2 s without markers", "the same 2 s with markers")
        for name in ("upper arm", "forearm")
    ]
    clock = {"clock where the motion shows it, ms": 2.0}
    return dict.fromkeys(accelerations, ACCELERATION[preset]) | clock | dict.fromkeys(rotations, 3.0)


def measure(seed: int, preset: Preset) -> Comparison:
    """Simulate an arm and run it with inertial sensors, without them, and with a gap of all markers."""
    options = ArmOptions(seed=seed, preset=preset, cycles=1, imus=True)
    with harness.temporary_folder() as place:
        configuration = write_arm(place / "trial", options)
        text = configuration.read_text("utf-8")
        configuration.write_text(text.split("imus:")[0], "utf-8")
        alone = _run(configuration)
        if alone is None:
            return Comparison(("no arm found",))
        configuration.write_text(text, "utf-8")
        try:
            both = _run(configuration)
        except ConfigError:
            return Comparison(("segment of a sensor not found",))
        assert both is not None  # the markers are the same
        hidden = _hide(configuration, options)
        gap = _run(configuration)
        truth = both.done.truth
    sizes = [compute_rms_length(each.gain[:, k]) for k in (2, 1) for each in (both, alone)]
    clocks = compute_clock_errors(both.done, truth["n_frames"] / truth["point_rate_hz"] / 2)
    clock = 1e3 * max((abs(off) for off, _, observable in clocks if observable), default=0.0)
    rotations = [_find_largest(each, hidden, k) for each in (gap, both) for k in (1, 2)]
    inside = {"clock": float(np.mean([abs(off) < harness.QUANTILE * sd for off, sd, _ in clocks]))}
    for k, name in ((1, "upper arm"), (2, "forearm")):
        inside[f"velocity of the {name}"] = _compute_share_inside(both.rate[:, k], both.sd[1, :, k])
        inside[f"acceleration of the {name}"] = _compute_share_inside(both.gain[:, k], both.sd[2, :, k])
        if gap is not None:
            inside[f"rotation of the {name} without markers"] = _compute_share_inside(
                gap.turn[hidden, k], gap.sd[0, hidden, k]
            )
    errors = dict(zip(list_limits(preset), [*sizes, clock, *rotations], strict=True))
    return Comparison(both.done.codes, errors, inside)


def _run(configuration: Path) -> _Errors | None:
    """Run a trial and compare it with its truth; return None if it is refused or has no arm."""
    done = harness.run_trial(configuration)
    if done.summary["verdict"]["level"] == "refused":
        return None
    (poses,) = done.read("poses.parquet")
    if f"{_ON[-1]}_qw" not in poses.names:
        return None
    keys = ("seg_R", "omega", "alpha")
    true = dict(zip(keys, done.true(poses["time"], *keys), strict=True))
    rotations = np.moveaxis(TO_TRIAL @ true["seg_R"][:, : len(_ON)], 1, 0)
    turns = [_compute_rotation_error(poses, *each) for each in zip(_ON, rotations, strict=True)]
    rate, gain = (
        np.stack([stack_columns(poses, name, [f"{key}_{axis}" for axis in "xyz"]) for name in _ON], axis=1)
        - true[key][:, : len(_ON)] @ TO_TRIAL.T
        for key in ("omega", "alpha")
    )
    sd = np.stack([poses.stack([f"sd_{name}_{key}" for name in _ON]) for key in ("rotation", "omega", "alpha")])
    return _Errors(done, np.stack(turns, axis=1), rate, gain, sd)


def _compute_rotation_error(poses: Any, name: str, true: FloatArray) -> FloatArray:
    """Return the error (F, 3) of a segment's rotation, rad, without its constant, which is a convention of the axes."""
    scalar, vector = poses[f"{name}_qw"], stack_columns(poses, name, ["qx", "qy", "qz"])
    cross = so3.hat(vector)
    found = np.eye(3) + 2 * scalar[:, None, None] * cross + 2 * cross @ cross
    known = np.isfinite(scalar)
    u, _, v = np.linalg.svd(np.mean(np.swapaxes(true[known], 1, 2) @ found[known], axis=0))
    turned = np.full((len(found), 3), np.nan)
    turned[known] = so3.log(found[known] @ np.swapaxes(true[known] @ (u @ v), 1, 2))
    return turned


def _hide(configuration: Path, options: ArmOptions) -> slice:
    """Hide all markers for 2 s, beginning in a movement, and return these frames."""
    trial = generate_arm(options)
    hidden = harness.choose_gap(np.linalg.norm(trial.omega[:, 2], axis=1), trial.rate, options.seed, (2.0, 4.0))
    points = trial.positions.copy()
    points[hidden] = np.nan
    configuration.with_name("trial.c3d").write_bytes(points_bytes(trial.labels, points, trial.rate))
    return hidden


def _find_largest(of: _Errors | None, frames: slice, k: int) -> float:
    """Return the largest error of a segment's rotation in some frames, degrees; infinity if a rotation is missing."""
    if of is None:
        return float("inf")
    size = np.degrees(np.linalg.norm(of.turn[frames, k], axis=1))
    return float(np.where(np.isfinite(size), size, np.inf).max())


def _compute_share_inside(error: FloatArray, sd: FloatArray) -> float:
    return harness.compute_share_inside(error, np.repeat(sd[:, None], 3, axis=1))
