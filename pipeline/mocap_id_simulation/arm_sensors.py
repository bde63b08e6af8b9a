"""Further sensors of a simulated arm: the skeleton of a depth camera (Kinect v2), and inertial sensors on the skin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id_simulation.arm import FOREARM, HAND, THORAX, UPPER_ARM, ArmBody
from mocap_id_simulation.chains import SimulatedSpaceTrial
from mocap_id_simulation.instruments import IMU_SEED, SimulatedSensor, measure_motion
from mocap_id_simulation.motion import Y
from mocap_id_simulation.options import PRESETS, ArmOptions

SKELETON_RATE = 30.0  # Hz
_TRUNK = {
    "SpineBase": (-0.030, -0.270, 0.0),
    "SpineMid": (-0.028, -0.128, 0.0),
    "SpineShoulder": (-0.029, -0.002, 0.0),
    "Neck": (-0.018, 0.031, 0.0),
    "Head": (0.010, 0.112, 0.0),
    "HipLeft": (-0.012, -0.285, -0.048),
    "HipRight": (-0.012, -0.285, 0.048),
}
"""Positions in the thorax, as fractions of the stature."""
_HAND_JOINTS = {"Hand": (0.0, -0.045, 0.0), "HandTip": (0.0, -0.095, 0.0), "Thumb": (0.0, -0.045, 0.03)}
"""Positions in the hand, as fractions of the stature."""
_INFERRED = {"Elbow": 0.02, "Wrist": 0.06, "Hand": 0.11, "HandTip": 0.07, "Thumb": 0.16}
"""Fraction of the frames in which the camera only infers the position of a joint."""
_BIAS = {"HandTip": 2.0, "Thumb": 2.5, "Hand": 1.3}
"""Factor on the constant error of a joint."""
_BIAS_SD, _NOISE_SD, _SURFACE = 0.012, 0.0075, -0.012  # m; the camera sees the near side of the body
_DEPTH_NOISE = 1.35  # noise along the line of sight, relative to that across it
_WHITE, _MEMORY = 0.12, 0.22  # fraction of the noise's variance that is white; correlation time of the rest, s
_INFERRED_SD, _JUMP_SD = 0.025, 0.06  # m
_HARD = 1.5  # factor on all errors
_LOST, _DROPPED, _ROW_JITTER = (
    0.01,
    0.025,
    0.0012,
)  # fractions of the frames of a hand and of the rows; jitter of times, s


@dataclass(frozen=True)
class FilmedSkeleton:
    """Recording of the camera, with K rows of J joints, on the camera's clock."""

    joints: tuple[str, ...]
    time: FloatArray  # (K,) s; a row was recorded at ``offset + time`` of the trial
    positions: FloatArray  # (K, J, 3) in camera axes (x to the camera's left, y up, z away from it), m; NaN if missing
    state: IntArray  # (K, J) 2 tracked, 1 inferred, 0 missing
    offset: float  # s
    rotation: FloatArray  # (3, 3) from the camera to the laboratory
    position: FloatArray  # (3,) position of the camera in the laboratory, m

    def document(self) -> dict[str, Any]:
        """Return JSON values for ``truth.json``."""
        return {
            "offset_s": self.offset,
            "camera_R_to_lab": self.rotation.tolist(),
            "camera_p_lab_m": self.position.tolist(),
            "joints": list(self.joints),
        }

    def csv(self) -> bytes:
        """Return the log as CSV."""
        names = [f"{joint}_{part}" for joint in self.joints for part in ("x", "y", "z", "state")]
        lines = [",".join(["time_s", *names])]
        for t, row, state in zip(self.time.tolist(), self.positions, self.state.tolist(), strict=True):
            cells = [f"{t:.4f}"]
            for point, s in zip(row.tolist(), state, strict=True):
                cells += ["", "", ""] if s == 0 else [f"{value:.5f}" for value in point]
                cells.append(str(s))
            lines.append(",".join(cells))
        return ("\n".join(lines) + "\n").encode()


def film_skeleton(trial: SimulatedSpaceTrial, options: ArmOptions) -> FilmedSkeleton:
    """Return the skeleton of a depth camera in front of a person who was simulated with these options.

    With the preset ``clean``, the offset of the clock is the only error.
    """
    rng = np.random.default_rng([options.seed, 30])
    size = {"clean": 0.0, "default": 1.0, "hard": _HARD}[options.preset]
    offset = float(rng.uniform(-0.1, 0.1))
    count = int((trial.time[-1] - 0.2) * SKELETON_RATE)
    ticks = 0.1 + np.arange(count) / SKELETON_RATE + rng.uniform(-1, 1, count) * _ROW_JITTER
    at = ticks[rng.random(count) > _DROPPED]
    joints, lab = _true_joints(trial, at, options.side == "left")
    rotation, position = _draw_camera(rng, trial)
    seen = (lab - position) @ rotation
    state = np.full(seen.shape[:2], 2, dtype=np.int64)
    if size:
        kinds = [joint.removesuffix("Right").removesuffix("Left") for joint in joints]
        bias = rng.normal(0, _BIAS_SD, (len(joints), 3)) * np.array([_BIAS.get(kind, 1.0) for kind in kinds])[:, None]
        bias[:, 2] += _SURFACE
        seen = seen + size * (bias + _draw_camera_noise(rng, len(at), len(joints)))
        for k, kind in enumerate(kinds):
            _infer(rng, seen[:, k], state[:, k], size * _INFERRED.get(kind, 0.0), is_hand=kind == "Hand")
    seen[state == 0] = np.nan
    return FilmedSkeleton(joints, at - offset, seen, state, offset, rotation, position)


def _true_joints(trial: SimulatedSpaceTrial, time: FloatArray, left: bool) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and true positions (K, J, 3) of the joints in the laboratory at times (K,)."""
    body: ArmBody = trial.document["body"]
    height = body.subject.height
    arm, other = ("Left", "Right") if left else ("Right", "Left")
    local = {name: (THORAX, height * np.array(share)) for name, share in _TRUNK.items()}
    local[f"Shoulder{other}"] = (THORAX, body.shoulder * [1, 1, -1])
    local |= {f"{name}{arm}": (HAND, height * np.array(share)) for name, share in _HAND_JOINTS.items()}
    points = {name: trial.origins[:, s] + trial.rotations[:, s] @ np.asarray(at) for name, (s, at) in local.items()}
    points |= {
        f"{name}{arm}": trial.origins[:, s]
        for name, s in (("Shoulder", UPPER_ARM), ("Elbow", FOREARM), ("Wrist", HAND))
    }
    if left:  # the recording contains the mirror image
        points = {name: point * [1, -1, 1] for name, point in points.items()}
        swapped = {"HipLeft": "HipRight", "HipRight": "HipLeft"}
        points = {swapped.get(name, name): point for name, point in points.items()}
    sampled = [np.column_stack([np.interp(time, trial.time, c) for c in point.T]) for point in points.values()]
    return tuple(points), np.stack(sampled, axis=1)


def _draw_camera(rng: np.random.Generator, trial: SimulatedSpaceTrial) -> tuple[FloatArray, FloatArray]:
    """Return rotation and position of the camera, which looks at the person from the front, tilted by some degrees."""
    forward = trial.rotations[0, THORAX, :, 0] * np.array([1.0, 1.0, 0.0])
    away = -forward / np.linalg.norm(forward)
    away = so3.exp(np.array([0.0, 0.0, rng.uniform(-0.3, 0.3)])) @ away
    up = np.array([0.0, 0.0, 1.0])
    left = np.cross(up, away)
    rotation = np.stack([left, up, away], axis=1) @ so3.exp(np.array([rng.uniform(-0.02, 0.12), 0.0, 0.0]))
    position = trial.origins[0, THORAX] - rng.uniform(2.0, 2.5) * away - [0.0, 0.0, rng.uniform(0.0, 0.3)]
    return rotation, position


def _draw_camera_noise(rng: np.random.Generator, count: int, joints: int) -> FloatArray:
    """Return autocorrelated noise (K, J, 3)."""
    fades = float(np.exp(-1 / (SKELETON_RATE * _MEMORY)))
    steps = rng.normal(0, 1, (count, joints, 3))
    slow = np.empty_like(steps)
    slow[0] = steps[0]
    for k in range(1, count):
        slow[k] = fades * slow[k - 1] + np.sqrt(1 - fades**2) * steps[k]
    total = np.sqrt(1 - _WHITE) * slow + np.sqrt(_WHITE) * rng.normal(0, 1, steps.shape)
    return np.asarray(_NOISE_SD * total * [1.0, 1.0, _DEPTH_NOISE])


def _infer(rng: np.random.Generator, points: FloatArray, state: IntArray, share: float, *, is_hand: bool) -> None:
    """Add inferred intervals and jumps to a joint's ``points`` and ``state``, in place; remove samples of a hand."""
    count = len(points)
    for _ in range(rng.poisson(share * count / 10)):
        start, length = int(rng.integers(count)), int(rng.integers(3, 18))
        state[start : start + length] = 1
        points[start : start + length] += rng.normal(0, _INFERRED_SD, 3)
    inferred: BoolArray = state == 1
    points[inferred] += rng.normal(0, _INFERRED_SD / 2, (int(inferred.sum()), 3))
    jumps = np.flatnonzero(rng.random(count) < (0.004 if share else 0.0))
    points[jumps] += rng.normal(0, _JUMP_SD, (len(jumps), 3))
    if is_hand and share:
        state[rng.random(count) < _LOST] = 0


_ERROR_FACTOR = {"clean": 0.0, "default": 1.0, "hard": 2.0}
_POSITION = {"thorax": (0.04, -0.06, 0.0), "upper_arm": (0.0, -0.19, 0.05), "forearm": (-0.01, -0.21, 0.03)}
_ON_HAND = (-0.03, -0.06, 0.0)
_LOSS = {"upper_arm": 0.25, "forearm": 0.12}  # fraction of the axial rotation that the skin does not follow


def simulate_sensors(trial: SimulatedSpaceTrial, options: ArmOptions) -> dict[str, SimulatedSensor]:
    """Return one sensor for each segment of a simulated arm that was generated with these options, by segment name.

    The preset scales the errors of the sensors. The preset and the factor of soft tissue scale the rotation of the skin
    under the sensors.

    Examples
    --------
    >>> from mocap_id_simulation.arm import generate_arm
    >>> options = ArmOptions(seed=1, preset="clean", cycles=1)
    >>> sorted(simulate_sensors(generate_arm(options), options))
    ['forearm', 'hand', 'thorax', 'upper_arm']
    """
    upper_arm = np.unwrap(np.asarray(trial.angles["shoulder_axial"] + trial.angles["shoulder_plane"]))
    axial = {"upper_arm": upper_arm, "forearm": trial.arrays["q_pron"][:, 0]}
    factor = _ERROR_FACTOR[options.preset]
    loss = min(options.soft_tissue, 1.0) * PRESETS[options.preset].twist_loss
    sensors = {}
    for s, name in enumerate(trial.segments):
        rng = np.random.default_rng([options.seed, IMU_SEED, s])
        share = loss * _LOSS.get(name, 0.0)
        angle = axial.get(name, np.zeros(len(trial.time)))
        position = np.array(_POSITION.get(name, _ON_HAND)) * np.where(np.arange(3) == 1, rng.uniform(0.9, 1.1), 1.0)
        rotations = trial.rotations[:, s] @ so3.exp(-share * (angle - angle[0])[:, None] * Y)
        points = trial.origins[:, s] + np.einsum("fij,j->fi", rotations, position)
        truth = {"position_in_segment_m": position.tolist(), "twist_loss": share}
        sensors[name] = measure_motion(rng, trial.time, rotations, points, error_factor=factor, truth=truth)
    if options.side == "right":
        return sensors
    turn, pull = np.array([-1.0, -1.0, 1.0]), np.array([1.0, 1.0, -1.0])  # the mirrored sensor on a left arm
    return {name: replace(each, gyro=each.gyro * turn, acc=each.acc * pull) for name, each in sensors.items()}
