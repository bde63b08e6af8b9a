"""Landmarks from recordings in which a pointer touches them (`pointers:` in the configuration)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id import recording
from mocap_id.anatomy.frames import mirror_points
from mocap_id.anatomy.landmark_names import SEGMENTS
from mocap_id.anatomy.pointer import Pointer, calibrate_pointer, find_pointer_markers, locate_pointed_landmark
from mocap_id.anatomy.still_pose import LandmarkPosition
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.kinematics.space.rigid_body import rigid_poses
from mocap_id.recording import Recording
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class MarkedChain:
    """Chain with the labels of its markers; ``left`` is True if the recordings must be mirrored."""

    chain: SpatialChain
    labels: tuple[str, ...]
    left: bool


def read_pointed_landmarks(
    trial: TrialKeys, marked: MarkedChain, segment: Mapping[str, int], labels: tuple[str, ...], palpation: float
) -> tuple[dict[str, LandmarkPosition], tuple[Reason, ...]]:
    """Return the positions of the pointed landmarks in the axes of their segments, by name, and cautions about them.

    Parameters
    ----------
    segment : mapping
        Number of the segment of each landmark.
    labels : tuple of str
        Labels of all markers of the trial, which does not contain the pointer.
    palpation : float
        Standard deviation of a landmark along each axis, m.

    Raises
    ------
    RecordingError
        A recording of the pointer cannot be used; the message names the file.
    """
    files = {str(name): path for name, path in trial.pointers.items() if str(name) in segment}
    if not files:
        return {}, ()
    recordings = {name: recording.read(path) for name, path in files.items()}
    rod = tuple(trial.pointer) or find_pointer_markers(labels, [each.labels for each in recordings.values()])
    for name, each in recordings.items():
        missing = [label for label in rod if label not in each.labels]
        if missing:
            raise RecordingError(
                f"{files[name]}: the pointer's markers {', '.join(missing)} are missing; the file has "
                f"{', '.join(each.labels)}"
            )
    if len(rod) < 2:
        raise RecordingError(
            f"{next(iter(files.values()))}: {len(rod)} markers are in all recordings of the pointer but not in this "
            "trial; expected at least two, the markers of the pointer"
        )
    touches = {name: _read_touch(each, rod, marked, segment[name]) for name, each in recordings.items()}
    pointer = (
        Pointer(np.array(list(trial.pointer.values()))) if trial.pointer else calibrate_pointer(list(touches.values()))
    )
    positions: dict[str, LandmarkPosition] = {}
    reasons: list[Reason] = []
    for name, touch in touches.items():
        try:
            landmark = locate_pointed_landmark(*touch, pointer, palpation)
        except RecordingError as error:
            raise RecordingError(f"{files[name]}: {error}") from error
        positions[name] = landmark.position
        reasons += [Reason(each.code, f"{name}: {each.message}.", each.value, each.limit) for each in landmark.reasons]
    return positions, tuple(reasons)


def explain_unused_pointers(trial: TrialKeys, names: Sequence[str], why: str = "") -> tuple[Reason, ...]:
    """Return a caution that names the landmarks under ``pointers:`` that have no effect; ``names`` are the segments."""
    missing = [str(name) for name in trial.pointers if SEGMENTS[str(name)] not in names]
    if not missing:
        return ()
    wanted = " or ".join(dict.fromkeys(SEGMENTS[name] for name in missing))
    why = why or (
        f"no segment is called {wanted}. The segments are called {', '.join(names)}: give their anatomical names, base "
        "first, such as `segment: {names: [thorax, upper_arm, forearm, hand]}`"
    )
    return (Reason("pointers-unused", f"{', '.join(missing)} under `pointers:` have no effect: {why}.", len(missing)),)


def _read_touch(
    trial: Recording, rod: tuple[str, ...], marked: MarkedChain, segment: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pointer markers (F, P, 3), m, rotations (F, 3, 3) and origins (F, 3), m, of a segment in a recording."""
    points = PlaneFrame(0.0).to_plane(trial.positions)
    points = mirror_points(points) if marked.left else points
    own = [m for m in np.flatnonzero(marked.chain.segment == segment) if marked.labels[m] in trial.labels]
    if len(own) < 3:
        raise RecordingError(
            f"{trial.files[0]}: the recording has {len(own)} markers of the landmark's segment, expected at least 3"
        )
    cluster = points[:, [trial.labels.index(marked.labels[m]) for m in own]]
    rotation, origin, _ = rigid_poses(cluster, marked.chain.local[own])
    return points[:, [trial.labels.index(label) for label in rod]], rotation, origin
