"""Recordings of reaches in a folder: markers of an arm without a force plate, or a skeleton; their side and session."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from mocap_id import recording
from mocap_id.anatomy.landmark_names import Side, find_landmarks
from mocap_id.anatomy.skeleton_joints import ARM, find_roles
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.skeleton_log import read_skeleton

_LANDMARKS = {"EL", "EM", "US", "RS"}
_SIDES: dict[Side, tuple[str, ...]] = {"right": ("right", "r"), "left": ("left", "l")}
_SESSION = re.compile(r"(?<![^\W_])(session|ses|visit|day)[\W_]*(\d+)", re.IGNORECASE)


@dataclass(frozen=True)
class FoundReach:
    """What a recording of reaches shows.

    Parameters
    ----------
    skeleton : bool
        Joint positions, not markers.
    sides : tuple of {"right", "left"}
        Arms that the recording shows; empty if the markers' names have no side.
    """

    skeleton: bool
    sides: tuple[str, ...]

    def of(self, path: PurePosixPath) -> tuple[str, ...]:
        """Return the arms to analyse: the one that the path names, else all of them."""
        words = re.findall(r"[^\W\d_]+", str(path.with_suffix("")).lower())
        named = tuple(side for side, names in _SIDES.items() if set(names) & set(words))
        return named if len(named) == 1 else self.sides or ("right",)


def find_reach(path: Path, forces: Path | None) -> FoundReach | None:
    """Return what a recording of reaches shows; None for another recording, or one that cannot be read."""
    if forces is not None:
        return None
    try:
        if path.suffix.lower() != ".c3d":
            labels = read_skeleton(path).recording.labels
            sides = tuple(side for side in _SIDES if _shows_arm(labels, side))
            if sides:
                return FoundReach(skeleton=True, sides=sides)
        found = recording.read(path)
    except (RecordingError, ConfigError):
        return None
    landmarks = find_landmarks(found.labels)
    if found.plates or not set(landmarks.markers) >= _LANDMARKS:
        return None
    return FoundReach(skeleton=False, sides=() if landmarks.side is None else (landmarks.side,))


def _shows_arm(labels: Sequence[str], side: Side) -> bool:
    return {"near_shoulder", *ARM[:2]} <= find_roles(labels, side).keys()


def find_session(path: PurePosixPath) -> str:
    """Return the session that a path names, such as ``session1``; empty if none.

    Examples
    --------
    >>> find_session(PurePosixPath("anna/Visit_02/left.csv"))
    'visit2'
    """
    match = _SESSION.search(str(path))
    return f"{match[1].lower()}{int(match[2])}" if match else ""
