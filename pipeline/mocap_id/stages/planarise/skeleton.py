"""Reading of a skeleton for the stage planarise: axes, side of the arm, and joints that the sensor inferred."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.anatomy.landmark_names import Side
from mocap_id.anatomy.skeleton_joints import find_roles
from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.errors import Refused
from mocap_id.recording import Recording
from mocap_id.recording.axes import nearest_axis
from mocap_id.recording.marker_positions import rotate_z_up
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.stages.planarise import PlanariseSettings
from mocap_id.stages.trial_keys import TrialKeys, get_recording
from mocap_id.verdict import Reason

_BEHIND = 0.05  # m; if hands or feet are farther behind the trunk than this, the file is a mirror image


@dataclass(frozen=True)
class UprightSkeleton:
    """A skeleton whose trunk is upright, in lab axes with Z up."""

    recording: Recording
    side: Side
    inferred: BoolArray  # (F, M) joint positions that the sensor inferred
    reasons: tuple[Reason, ...]

    def facts(self, labels: tuple[str, ...], first: int, stop: int) -> dict[str, Any]:
        """Return the fact ``skeleton``: for each joint, first and last time, s, of intervals with inferred positions.

        Only the joints ``labels`` and the frames from ``first`` to ``stop`` - 1 are considered.
        """
        time, stretches = self.recording.time, {}
        for number, label in enumerate(self.recording.labels):
            runs = find_runs(self.inferred[first:stop, number])
            if label in labels and runs:
                stretches[label] = [time[[first + run.start, first + run.stop - 1]].tolist() for run in runs]
        return {"inferred": stretches}


def read_upright(trial: TrialKeys, settings: PlanariseSettings) -> UprightSkeleton:
    """Read the skeleton of a trial, and determine the axis that points up and the arm that moves.

    Raises Refused if the skeleton has no arm with shoulder, elbow and wrist.
    """
    file = get_recording(trial).skeleton
    assert file is not None
    read = read_skeleton(file, units=settings.units, vertical=settings.vertical)
    source, notes = read.recording, []
    side = trial.side or _find_moving_side(source)
    roles = find_roles(source.labels, side)
    missing = [name for name in ("near_shoulder", "elbow", "wrist") if name not in roles]
    if missing:
        raise Refused(
            "skeleton-incomplete",
            f"the skeleton does not contain the {' and '.join(missing).replace('near_', '')} of the {side} arm; its "
            f"joints are {', '.join(source.labels)[:200]}.",
        )
    if trial.side is None:
        notes.append(f"the {side} arm moves more than the other and is used (if it is the wrong one, set `side:`)")
    if settings.vertical is None:
        source = _rotate_upright(source, roles, notes)
    source, mirrored = _undo_mirroring(source, roles, side)
    reasons = tuple(Reason("recording-oddity", f"{note}.", level="ok") for note in notes)
    return UprightSkeleton(source, side, read.inferred, read.reasons + reasons + mirrored)


def _find_moving_side(source: Recording) -> Side:
    """Return the side whose wrist moves more relative to its shoulder."""
    moved: dict[Side, float] = {"right": 0.0, "left": 0.0}
    for side in moved:
        roles = find_roles(source.labels, side)
        if {"near_shoulder", "wrist"} <= roles.keys():
            arm = source.positions[:, roles["wrist"]] - source.positions[:, roles["near_shoulder"]]
            moved[side] = 1e-6 + float(np.nansum(np.nanvar(arm, axis=0))) if np.isfinite(arm).any() else 0.0
    return "left" if moved["left"] > moved["right"] else "right"


def _find_trunk(source: Recording, roles: dict[str, int]) -> tuple[FloatArray, FloatArray]:
    """Return the vectors (F, 3) up along the trunk (NaN if unknown) and from the far to the near shoulder, m."""
    near, far = (source.positions[:, roles.get(f"{part}_shoulder", roles["near_shoulder"])] for part in ("near", "far"))
    low = [source.positions[:, roles[name]] for name in ("pelvis", "near_hip", "far_hip", "spine") if name in roles]
    if not low:
        return np.full(near.shape, np.nan), near - far
    return (near + far) / 2 - np.mean(low[: 1 if "pelvis" in roles else 2], axis=0), near - far


def _rotate_upright(source: Recording, roles: dict[str, int], notes: list[str]) -> Recording:
    """Return the recording, rotated so that the axis nearest to the trunk points up, and add a note to ``notes``."""
    up = np.nanmedian(_find_trunk(source, roles)[0], axis=0) if len(source.time) else np.zeros(3)
    axis = nearest_axis(up, 0.75)
    tilt = float(np.degrees(np.arctan2(np.linalg.norm(up[:2]), up[2]))) if np.isfinite(up).all() else float("nan")
    if axis not in (None, "Z"):
        positions = source.positions.copy()
        rotate_z_up(positions, str(axis))
        notes.append("the upward axis was determined from the trunk (if it is another, set `vertical:`)")
        return replace(source, positions=positions, vertical=f"{source.vertical} ({axis})")
    notes.append(
        f"{source.vertical} of the file is taken as up; the trunk leans {tilt:.0f}° from it, with an unknown tilt of "
        "the camera. Angles of the arm relative to the thorax do not depend on it"
    )
    return source


def _undo_mirroring(source: Recording, roles: dict[str, int], side: Side) -> tuple[Recording, tuple[Reason, ...]]:
    """Return the recording; if hands or feet are behind the trunk, mirror it and return a caution too."""
    up, across = _find_trunk(source, roles)
    forward = np.cross(up, across if side == "right" else -across)
    with np.errstate(invalid="ignore"):
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    ahead = []
    for start, end in (("near_ankle", "near_foot"), ("far_ankle", "far_foot")):
        if start in roles and end in roles:
            ahead.append(source.positions[:, roles[end]] - source.positions[:, roles[start]])
    if not ahead:
        ahead.append(source.positions[:, roles["wrist"]] - source.positions[:, roles["near_shoulder"]])
    along = float(np.nanmedian(np.einsum("fi,fi->f", np.mean(ahead, axis=0), forward)))
    if not along < -_BEHIND:
        return source, ()
    reason = Reason(
        "skeleton-mirrored",
        f"hands or feet are {-100 * along:.0f} cm behind the trunk, so the file is a mirror image or exchanges left "
        "and right. It was mirrored back; check that `side:` names the arm that moved.",
        -along,
        _BEHIND,
    )
    return replace(source, positions=source.positions * [1.0, -1.0, 1.0]), (reason,)
