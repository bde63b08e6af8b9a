"""A depth camera that sees a simulated arm: the skeleton of a Kinect v2 with its usual errors, as a CSV log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.simulation.arm.body import FOREARM, HAND, THORAX, UPPER_ARM, ArmBody
from mocap_id.simulation.arm.options import ArmOptions
from mocap_id.simulation.arm.trial import SpatialTrial

RATE = 30.0  # Hz
_TRUNK = {
    "SpineBase": (-0.030, -0.270, 0.0),
    "SpineMid": (-0.028, -0.128, 0.0),
    "SpineShoulder": (-0.029, -0.002, 0.0),
    "Neck": (-0.018, 0.031, 0.0),
    "Head": (0.010, 0.112, 0.0),
    "HipLeft": (-0.012, -0.285, -0.048),
    "HipRight": (-0.012, -0.285, 0.048),
}
"""Places in the thorax, in statures."""
_HAND = {"Hand": (0.0, -0.045, 0.0), "HandTip": (0.0, -0.095, 0.0), "Thumb": (0.0, -0.045, 0.03)}
"""Places in the hand, in statures."""
_GUESSED = {"Elbow": 0.02, "Wrist": 0.06, "Hand": 0.11, "HandTip": 0.07, "Thumb": 0.16}
"""Share of the frames in which the position is inferred."""
_BIAS = {"HandTip": 2.0, "Thumb": 2.5, "Hand": 1.3}
"""Constant error of a joint, relative to that of the others."""
_BIAS_SD, _NOISE_SD, _SURFACE = 0.012, 0.0075, -0.012  # m; the camera sees the near side of the body
_DEPTH = 1.35  # noise along the line of sight, relative to that across it
_WHITE, _MEMORY = 0.12, 0.22  # share of the noise's variance that is white; s
_GUESS_SD, _JUMP_SD = 0.025, 0.06  # m
_HARD = 1.5
_LOST, _DROPPED, _JITTER = 0.01, 0.025, 0.0012  # shares of a hand's frames and of rows; s


@dataclass(frozen=True)
class Skeleton:
    """What the camera recorded, on its own clock.

    Parameters
    ----------
    joints : tuple of str, length J
    time : (K,) array
        s; a row was taken at ``offset + time`` of the trial.
    positions : (K, J, 3) array
        In camera axes (x to the camera's left, y up, z away from it), m; NaN where lost.
    state : (K, J) int array
        2 tracked, 1 inferred, 0 lost.
    offset : float
        s.
    rotation, place : (3, 3) and (3,) arrays
        Camera to laboratory, m.
    """

    joints: tuple[str, ...]
    time: FloatArray
    positions: FloatArray
    state: IntArray
    offset: float
    rotation: FloatArray
    place: FloatArray

    def document(self) -> dict[str, Any]:
        """Return JSON values for ``truth.json``."""
        return {
            "offset_s": self.offset,
            "camera_R_to_lab": self.rotation.tolist(),
            "camera_p_lab_m": self.place.tolist(),
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


def film_skeleton(trial: SpatialTrial, options: ArmOptions) -> Skeleton:
    """Return the skeleton of a depth camera in front of the person.

    Parameters
    ----------
    trial : SpatialTrial
        For a left arm, it holds the mirror image.
    options : ArmOptions
        Those of the trial; with the preset ``clean`` the only error is the offset of the clock.
    """
    rng = np.random.default_rng([options.seed, 30])
    size = {"clean": 0.0, "default": 1.0, "hard": _HARD}[options.preset]
    offset = float(rng.uniform(-0.1, 0.1))
    count = int((trial.time[-1] - 0.2) * RATE)
    ticks = 0.1 + np.arange(count) / RATE + rng.uniform(-1, 1, count) * _JITTER
    at = ticks[rng.random(count) > _DROPPED]
    joints, lab = _true_joints(trial, at, options.side == "left")
    rotation, place = _camera(rng, trial)
    seen = (lab - place) @ rotation
    state = np.full(seen.shape[:2], 2, dtype=np.int64)
    if size:
        kinds = [joint.removesuffix("Right").removesuffix("Left") for joint in joints]
        bias = rng.normal(0, _BIAS_SD, (len(joints), 3)) * np.array([_BIAS.get(kind, 1.0) for kind in kinds])[:, None]
        bias[:, 2] += _SURFACE
        seen = seen + size * (bias + _noise(rng, len(at), len(joints)))
        for k, kind in enumerate(kinds):
            _guess(rng, seen[:, k], state[:, k], size * _GUESSED.get(kind, 0.0), lost=kind == "Hand")
    seen[state == 0] = np.nan
    return Skeleton(joints, at - offset, seen, state, offset, rotation, place)


def _true_joints(trial: SpatialTrial, at: FloatArray, left: bool) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and true positions (K, J, 3) of the joints in the laboratory."""
    body: ArmBody = trial.document["body"]
    height = body.subject.height
    arm, other = ("Left", "Right") if left else ("Right", "Left")
    places = {name: (THORAX, height * np.array(place)) for name, place in _TRUNK.items()}
    places[f"Shoulder{other}"] = (THORAX, body.shoulder * [1, 1, -1])
    places |= {f"{name}{arm}": (HAND, height * np.array(place)) for name, place in _HAND.items()}
    points = {
        name: trial.origins[:, s] + trial.rotations[:, s] @ np.asarray(place) for name, (s, place) in places.items()
    }
    points |= {
        f"{name}{arm}": trial.origins[:, s]
        for name, s in (("Shoulder", UPPER_ARM), ("Elbow", FOREARM), ("Wrist", HAND))
    }
    if left:  # the laboratory holds the mirror image
        points = {name: point * [1, -1, 1] for name, point in points.items()}
        swapped = {"HipLeft": "HipRight", "HipRight": "HipLeft"}
        points = {swapped.get(name, name): point for name, point in points.items()}
    places_at = [np.column_stack([np.interp(at, trial.time, c) for c in point.T]) for point in points.values()]
    return tuple(points), np.stack(places_at, axis=1)


def _camera(rng: np.random.Generator, trial: SpatialTrial) -> tuple[FloatArray, FloatArray]:
    """Return the pose of the camera, which looks at the person from the front, tilted by some degrees."""
    forward = trial.rotations[0, THORAX, :, 0] * np.array([1.0, 1.0, 0.0])
    away = -forward / np.linalg.norm(forward)
    away = so3.exp(np.array([0.0, 0.0, rng.uniform(-0.3, 0.3)])) @ away
    up = np.array([0.0, 0.0, 1.0])
    left = np.cross(up, away)
    turned = np.stack([left, up, away], axis=1) @ so3.exp(np.array([rng.uniform(-0.02, 0.12), 0.0, 0.0]))
    place = trial.origins[0, THORAX] - rng.uniform(2.0, 2.5) * away - [0.0, 0.0, rng.uniform(0.0, 0.3)]
    return turned, place


def _noise(rng: np.random.Generator, count: int, joints: int) -> FloatArray:
    """Return autocorrelated noise (K, J, 3)."""
    fades = float(np.exp(-1 / (RATE * _MEMORY)))
    steps = rng.normal(0, 1, (count, joints, 3))
    slow = np.empty_like(steps)
    slow[0] = steps[0]
    for k in range(1, count):
        slow[k] = fades * slow[k - 1] + np.sqrt(1 - fades**2) * steps[k]
    total = np.sqrt(1 - _WHITE) * slow + np.sqrt(_WHITE) * rng.normal(0, 1, steps.shape)
    return np.asarray(_NOISE_SD * total * [1.0, 1.0, _DEPTH])


def _guess(rng: np.random.Generator, points: FloatArray, state: IntArray, share: float, *, lost: bool) -> None:
    """Let a joint be inferred or lost for some stretches, and jump in some frames, in place."""
    count = len(points)
    for _ in range(rng.poisson(share * count / 10)):
        start, length = int(rng.integers(count)), int(rng.integers(3, 18))
        state[start : start + length] = 1
        points[start : start + length] += rng.normal(0, _GUESS_SD, 3)
    guessed: BoolArray = state == 1
    points[guessed] += rng.normal(0, _GUESS_SD / 2, (int(guessed.sum()), 3))
    jumps = np.flatnonzero(rng.random(count) < (0.004 if share else 0.0))
    points[jumps] += rng.normal(0, _JUMP_SD, (len(jumps), 3))
    if lost and share:
        state[rng.random(count) < _LOST] = 0
