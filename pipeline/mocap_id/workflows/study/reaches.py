"""Sides and sessions of recordings of reaches, which have markers of an arm without a force plate, or a skeleton."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from mocap_id import recording
from mocap_id.anatomy.landmark_names import Side, find_landmarks
from mocap_id.anatomy.skeleton_joints import ARM, find_roles
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.protocols.kind_of_movement import recognise_movement
from mocap_id.recording.model import Recording
from mocap_id.recording.skeleton_log import read_skeleton

_LANDMARKS = {"EL", "EM", "US", "RS"}
_SIDES: dict[Side, tuple[str, ...]] = {"right": ("right", "r"), "left": ("left", "l")}
_JOINTS = 0.4  # least share of the labels that name joints in a skeleton; MediaPipe adds eyes, ears and fingers
_OF_THE_BODY = ("sit-to-stand", "walking", "jumping")  # movements that are no reach, though the markers name an arm
_SESSION = re.compile(r"(?<![^\W_])(session|ses|visit|day)[\W_]*(\d+)", re.IGNORECASE)


@dataclass(frozen=True)
class Reach:
    """The arms in a recording of reaches."""

    skeleton: bool  # whether the recording contains joint positions instead of markers
    sides: tuple[str, ...]  # ``right``, ``left`` or both; empty if the markers' names have no side

    def choose_sides(self, path: PurePosixPath) -> tuple[str, ...]:
        """Return the sides to analyse: the side that the path names, or else all sides of the recording."""
        words = re.findall(r"[^\W\d_]+", str(path.with_suffix("")).lower())
        named = tuple(side for side, names in _SIDES.items() if set(names) & set(words))
        return named if len(named) == 1 else self.sides or ("right",)


def read_reach(path: Path, forces: Path | None) -> Reach | None:
    """Return the arms in a recording of reaches; None if the recording is not a reach, or cannot be read."""
    if forces is not None:
        return None
    skeleton = read_joints(path)
    if skeleton is not None:
        return Reach(skeleton=True, sides=_find_arms(skeleton.labels))
    try:
        content = recording.read(path)
    except (RecordingError, ConfigError):
        return None
    landmarks = find_landmarks(content.labels)
    if content.plates or not set(landmarks.markers) >= _LANDMARKS:
        return None
    seen = recording.ThinnedFrames.of(content.positions, content.time, content.rate)
    if recognise_movement(content.labels, seen.positions, seen.rate).kind in _OF_THE_BODY:
        return None
    return Reach(skeleton=False, sides=() if landmarks.side is None else (landmarks.side,))


def read_joints(path: Path) -> Recording | None:
    """Return the joint positions in a recording of a skeleton with an arm; None if it has none, or cannot be read."""
    if path.suffix.lower() == ".c3d":
        return None
    try:
        content = read_skeleton(path).recording
    except (RecordingError, ConfigError):
        return None
    return content if _find_arms(content.labels) else None


def _find_arms(labels: Sequence[str]) -> tuple[Side, ...]:
    """Return the sides of the arms among the joints of a skeleton; none if most labels are those of markers."""
    roles = {side: find_roles(labels, side) for side in _SIDES}
    joints = {number for found in roles.values() for number in found.values()}
    if len(joints) < _JOINTS * len(labels):
        return ()
    return tuple(side for side, found in roles.items() if {"near_shoulder", *ARM[:2]} <= found.keys())


def find_session(path: PurePosixPath) -> str:
    """Return the session that a path names, such as ``session1``; empty if the path names no session.

    Examples
    --------
    >>> find_session(PurePosixPath("anna/Visit_02/left.csv"))
    'visit2'
    """
    match = _SESSION.search(str(path))
    return f"{match[1].lower()}{int(match[2])}" if match else ""
