"""Landmarks in a fitted chain, also from pointers: they refine joint centres and define the anatomical frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.anatomy.frames import (
    PALPATION,
    THORAX,
    AnatomicalFrames,
    ClusterPoses,
    fit_segment_frames,
    mirror_points,
    rotate_to_elbow_axis,
    set_middle_covariance,
)
from mocap_id.anatomy.landmarks import (
    LandmarkPosition,
    Pointer,
    calibrate_pointer,
    find_pointer_markers,
    find_still_pose,
    locate_landmarks,
    locate_pointed_landmark,
)
from mocap_id.anatomy.names import SEGMENTS, find_landmarks
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import RecordingError
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.geometry.spatial_chain import SpatialChain, change_frames
from mocap_id.kinematics.space.chain_result import SpatialFit, move_centre
from mocap_id.kinematics.space.rigid_body import rigid_poses
from mocap_id.recording import Recording
from mocap_id.stages.base import Context
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.skin_motion import correct_axial_rotation, fit_cluster_poses
from mocap_id.stages.trial_keys import TrialKeys, get_landmark_labels
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class MarkedChain:
    """Chain with the labels of its markers; ``left`` is True if the recordings must be mirrored."""

    chain: SpatialChain
    labels: tuple[str, ...]
    left: bool


_OTHER_CLUSTER = 0.004  # m, largest rms change of a cluster between two recordings; skin and bending: 0.1 to 2.5 mm


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
    touches = {}
    reasons: list[Reason] = []
    for name, each in recordings.items():
        touches[name], off = _read_touch(each, rod, marked, segment[name])
        if off > _OTHER_CLUSTER:
            text = (
                f"{name}: in {files[name].name}, the markers of the landmark's segment are {1e3 * off:.1f} mm rms from "
                f"their places in this trial, expected below {1e3 * _OTHER_CLUSTER:.0f} mm: two labels are exchanged "
                "in one of the recordings, or the markers were placed again."
            )
            reasons.append(Reason("pointer-cluster", text, off, _OTHER_CLUSTER))
    pointer = (
        Pointer(np.array(list(trial.pointer.values()))) if trial.pointer else calibrate_pointer(list(touches.values()))
    )
    positions: dict[str, LandmarkPosition] = {}
    for name, touch in touches.items():
        try:
            positions[name], cautions = locate_pointed_landmark(*touch, pointer, palpation)
        except RecordingError as error:
            raise RecordingError(f"{files[name]}: {error}") from error
        reasons += [Reason(each.code, f"{name}: {each.message}.", each.value, each.limit) for each in cautions]
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
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], float]:
    """Return what a recording shows of a landmark's segment, and the rms distance of its markers from their places, m.

    The first result is the pointer's markers (F, P, 3), m, and the segment's rotations (F, 3, 3) and origins (F, 3), m.
    """
    points = PlaneFrame(0.0).to_plane(trial.positions)
    points = mirror_points(points) if marked.left else points
    own = [m for m in np.flatnonzero(marked.chain.segment == segment) if marked.labels[m] in trial.labels]
    if len(own) < 3:
        raise RecordingError(
            f"{trial.files[0]}: the recording has {len(own)} markers of the landmark's segment, expected at least 3"
        )
    cluster = points[:, [trial.labels.index(marked.labels[m]) for m in own]]
    rotation, origin, _ = rigid_poses(cluster, marked.chain.local[own])
    off = cluster - (np.einsum("fij,kj->fki", rotation, marked.chain.local[own]) + origin[:, None])
    squares = np.sum(off**2, axis=2)[np.isfinite(rotation[:, 0, 0])]
    seen = squares[np.isfinite(squares)]
    away = float(np.sqrt(seen.mean())) if seen.size else 0.0
    return (points[:, [trial.labels.index(label) for label in rod]], rotation, origin), away


_ABOVE = (("IJ", "PX"), ("C7", "T8"))
"""Pairs of landmarks of the thorax; the first landmark of a pair is above the second."""
_BELOW = 0.05  # m, limit of the height difference, which is small in a person who lies
_OUT_OF_PLANE = 0.025  # m, largest rms distance of the thorax's landmarks from the plane through them
_BESIDE = 0.05  # m, largest distance of the midpoint of two landmarks from the joint centre found from the motion
_SURE = 0.02  # m; the distance has less weight in directions with a larger standard deviation
_ACROSS = 45.0  # degrees, largest angle between the line through the epicondyles and the axis found from the motion
_LENGTHS = {"upper_arm": (0.15, 0.45), "forearm": (0.12, 0.40)}
"""Shortest and longest segments of children and adults, m."""
_NEXT = {"upper_arm": "forearm", "forearm": "hand"}
PAIRS = {"forearm": ("EL", "EM"), "hand": ("RS", "US")}
"""Landmarks on both sides of the joint before a segment."""


def check_landmarks(
    fit: SpatialFit,
    places: Mapping[str, LandmarkPosition],
    frames: AnatomicalFrames,
    where: Mapping[str, int],
    standing: ClusterPoses,
) -> tuple[Reason, ...]:
    """Return a caution that lists all contradictions with the anatomy of an arm; an empty tuple if there are none.

    ``standing`` are the poses of the segments in the still pose; their y axis points up.

    Parameters
    ----------
    fit : SpatialFit
        Fitted chain before its joint centres are moved to landmarks.
    places : mapping
        Landmarks in the axes of their segments, by name.
    where : mapping
        Number of each segment, by name.
    """
    at = {name: place.local for name, place in places.items()}
    doubts = [
        *_check_thorax(at, frames, where, standing, fit),
        *_check_joints(fit, at, where),
        *_check_segment_lengths(fit, where),
    ]
    return explain_implausible_arm(doubts)


def _check_thorax(
    at: Mapping[str, FloatArray],
    frames: AnatomicalFrames,
    where: Mapping[str, int],
    standing: ClusterPoses,
    fit: SpatialFit,
) -> Iterator[str]:
    """Yield a text for each contradiction of the landmarks of the thorax with its anatomy."""
    frame = frames.frames.get("thorax")
    if frame is None:
        return
    own = where["thorax"]
    for upper, lower in _ABOVE:
        below = float(standing.place(at[lower], own)[1] - standing.place(at[upper], own)[1])
        if below > _BELOW:
            yield f"at rest, {upper} is {1e3 * below:.0f} mm below {lower}"
    landmarks = np.array([at[name] for name in THORAX.up])
    off = float(np.linalg.svd(landmarks - landmarks.mean(axis=0), compute_uv=False)[-1]) / np.sqrt(len(landmarks))
    if off > _OUT_OF_PLANE:
        yield f"{', '.join(THORAX.up)} are {1e3 * off:.0f} mm out of one plane (rms)"
    joint = fit.chain.joints[where["upper_arm"] - 1] if "upper_arm" in where else None
    if joint is not None and joint.known and joint.parent == own:
        side = float((joint.centre - frame.origin) @ frame.rotation[:, 2])
        if side < 0:
            yield "the shoulder is on the other side of the thorax, as if IJ and C7 were exchanged"


def _check_joints(fit: SpatialFit, at: Mapping[str, FloatArray], where: Mapping[str, int]) -> Iterator[str]:
    """Yield a text for each contradiction of the landmarks with the joint centres and axes found from the motion."""
    for child, pair in PAIRS.items():
        if child not in where or where[child] == 0 or not all(name in at for name in pair):
            continue
        joint = fit.chain.joints[where[child] - 1]
        if not joint.known or not np.isfinite(joint.covariance).all():
            continue
        across = at[pair[0]] - at[pair[1]]
        off = joint.centre - (at[pair[0]] + at[pair[1]]) / 2
        away = float(np.sqrt(off @ np.linalg.solve(joint.covariance / _SURE**2 + np.eye(3), off)))
        if away > _BESIDE:
            yield f"the midpoint of {pair[0]} and {pair[1]} is {1e3 * away:.0f} mm from the centre of their joint"
        if child == "forearm" and joint.kind == "two-axis" and np.isfinite(joint.axes_covariance[0]).all():
            cosine = abs(float(across @ joint.first_axis)) / max(float(np.linalg.norm(across)), 1e-9)
            angle = float(np.degrees(np.arccos(min(cosine, 1.0))))
            if angle > _ACROSS:
                yield f"the line through EL and EM is {angle:.0f}° from the axis about which the elbow bends"


def _check_segment_lengths(fit: SpatialFit, where: Mapping[str, int]) -> list[str]:
    """Return a text for each segment of the fit with an impossible length."""
    lengths = {}
    for name, tip in _NEXT.items():
        joint = fit.chain.joints[where[tip] - 1] if where.get(tip, 0) else None
        if joint is not None and joint.known and joint.parent == where.get(name):
            lengths[name] = float(np.linalg.norm(joint.centre))
    return check_lengths(lengths)


def check_lengths(lengths: Mapping[str, float]) -> list[str]:
    """Return a text for each impossible length of upper arm or forearm; ``lengths`` are in m, by segment."""
    return [
        f"the {name.replace('_', ' ')} is {length:.3g} m long, expected {shortest:g} to {longest:g} m"
        for name, length in lengths.items()
        for shortest, longest in [_LENGTHS[name]]
        if not shortest <= length <= longest
    ]


def explain_implausible_arm(doubts: Sequence[str]) -> tuple[Reason, ...]:
    """Return a caution that lists the contradictions ``doubts`` with the anatomy of an arm; () if there are none."""
    if not doubts:
        return ()
    text = "Check the names of the landmarks, and the unit and the vertical axis of the recording; the angles are wrong"
    return (Reason("landmarks-implausible", f"{'; '.join(doubts)}. {text}", float(len(doubts)), 0.0),)


_MIDDLES = {"upper_arm": ("GH",), "forearm": ("EL", "EM"), "hand": ("RS", "US")}
"""Landmarks whose midpoint is the centre of the joint before a segment, by this segment."""
_GH_SD = 0.01
"""Standard deviation of a marker at the shoulder centre from this centre, along each axis, m."""
_OFTEN = 0.5
"""Smallest share of frames in which the landmarks beside a joint are visible, so that they help the joint fit."""
_OVERVIEW = 600
"""Largest number of frames, evenly over the recording, in which the poses are computed besides the still pose."""
JOINTS = {"shoulder": ("thorax", "upper_arm"), "elbow": ("upper_arm", "forearm"), "wrist": ("forearm", "hand")}
"""Segments before and after each joint that has angles by the definitions of the ISB."""


@dataclass(frozen=True)
class AnatomicalChain:
    """A fitted chain in the anatomical frames of the ISB, or in the frames of the joint fit without landmarks."""

    fit: SpatialFit  # fit with joint centres refined by landmarks, in the frames of the fit
    chain: SpatialChain  # the same chain in anatomical frames
    landmarks: Mapping[str, Any]  # datasets of the group ``landmarks`` of chain.h5
    # facts of chain.h5: ``frames`` ("isb" or "own"), ``still_s`` and ``frame_covariance``
    facts: Mapping[str, Any] = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()  # cautions and notes about landmarks


def fit_anatomical_frames(
    context: Context, view: Trajectories, fit: SpatialFit, columns: IntArray, names: Sequence[str]
) -> AnatomicalChain:
    """Refine the joint centres by landmarks and express the chain in the anatomical frames of the ISB.

    Parameters
    ----------
    columns : (M,) int array
        Indices of the markers of the chain in ``view``.
    names : sequence of str, length n + 1
        Names of the segments; only segments with anatomical names get anatomical frames.
    """
    settings: FitJointsSettings = context.settings
    numbers = {name: k for k, name in enumerate(names)}
    named = find_landmarks(view.labels, get_landmark_labels(context.trial), context.trial.side)
    markers = {name: marker for name, marker in named.markers.items() if SEGMENTS[name] in numbers}
    known = {*markers, *(str(name) for name in context.trial.pointers)}
    segment = {name: numbers[SEGMENTS[name]] for name in known if SEGMENTS[name] in numbers}
    if "GH" in segment:
        segment["GH"] = fit.chain.joints[segment["GH"] - 1].parent
    if not segment:
        return AnatomicalChain(fit, fit.chain, _make_landmark_arrays({}, {}, {}), {"frames": "own"})
    tracks = view.read_positions(np.array(list(markers.values()), dtype=np.int64))
    points = view.read_positions(columns)
    static = context.trial.static
    start = (
        None if not isinstance(static, tuple) else (static[0] - float(view.time[0]), static[1] - float(view.time[0]))
    )
    still = find_still_pose(points, view.rate, start)
    chosen, at_rest = _choose_frames(still.frames, len(points))
    moving = dict(zip(markers, np.moveaxis(tracks[chosen], 1, 0), strict=True))

    def locate(fit: SpatialFit) -> tuple[dict[str, LandmarkPosition], tuple[Reason, ...], _ClusterPoses]:
        poses = _ClusterPoses.fit(points[chosen], fit.chain, at_rest)
        positions, notes = locate_landmarks(
            moving, segment, poses.rotations, poses.origins, frames=at_rest, palpation=settings.palpation_sd_m
        )
        left = view.planar.facts["side"] == "left"
        marked = MarkedChain(fit.chain, tuple(view.labels[m] for m in columns), left)
        pointed, more = read_pointed_landmarks(context.trial, marked, segment, view.labels, settings.palpation_sd_m)
        return {**positions, **pointed}, (*notes, *more), poses

    refined = _move_centres_to_landmarks(fit, lambda fit: locate(fit)[0], numbers)
    positions, reasons, poses = locate(refined)
    frames = _fit_frames(refined, positions, {**segment, **numbers}, poses, settings.humerus)
    reasons += check_landmarks(fit, locate(fit)[0], frames, numbers, poses.find_pose_at_rest())
    rotations = np.stack([frames.frames[name].rotation if name in frames.frames else np.eye(3) for name in names])
    base = frames.frames[names[0]].origin if names[0] in frames.frames else np.zeros(3)
    shifts = np.zeros((len(names), 3))
    shifts[0] = base
    local = {
        name: rotations[segment[name]].T @ (each.local - shifts[segment[name]]) for name, each in positions.items()
    }
    facts = {
        "frames": "isb" if frames.frames else "own",
        "still_s": [float(view.time[still.frames.start]), float(view.time[still.frames.stop - 1])],
        "frame_covariance": _list_covariances(frames),
    }
    landmarks = _make_landmark_arrays(local, segment, positions)
    chain = change_frames(refined.chain, rotations, base)
    reasons = (*named.reasons, *still.reasons, *reasons, *frames.reasons)
    return AnatomicalChain(refined, chain, landmarks, facts, reasons)


def _choose_frames(still: slice, count: int) -> tuple[IntArray, slice]:
    """Return indices of still frames and of frames over the whole recording, and the slice of the still ones in them.

    ``count`` is the number of frames of the recording.
    """
    overview = np.arange(0, count, 1 + count // _OVERVIEW)
    frames = np.union1d(overview, np.arange(still.start, still.stop))
    first = int(np.searchsorted(frames, still.start))
    return frames, slice(first, first + still.stop - still.start)


@dataclass(frozen=True)
class _ClusterPoses:
    """Poses of all segments: rotations (F, S, 3, 3), origins (F, S, 3), m, and the slice of the still frames in F."""

    rotations: FloatArray
    origins: FloatArray
    still: slice

    @classmethod
    def fit(cls, points: FloatArray, chain: SpatialChain, still: slice) -> _ClusterPoses:
        return cls(*fit_cluster_poses(correct_axial_rotation(points, chain), chain), still)

    def find_pose_at_rest(self) -> ClusterPoses:
        """Return the poses in one still frame: the middle one of those with all poses known, or else the first one."""
        complete = self.still.start + np.flatnonzero(np.isfinite(self.rotations[self.still]).all(axis=(1, 2, 3)))
        middle = int(complete[len(complete) // 2]) if len(complete) else self.still.start
        return ClusterPoses(self.rotations[middle], self.origins[middle])


def find_points_near_joints(context: Context, view: Trajectories, names: Sequence[str]) -> dict[int, FloatArray]:
    """Return the midpoint (F, 3) of the landmarks beside each joint of an arm, m, by number of the next segment.

    Joints without landmarks, or with landmarks that are often missing, are left out.
    """
    markers = find_landmarks(view.labels, get_landmark_labels(context.trial), context.trial.side).markers
    middles = {}
    for child, pair in _MIDDLES.items():
        if child in names and names.index(child) > 0 and all(name in markers for name in pair):
            tracks = view.read_positions(np.array([markers[name] for name in pair], dtype=np.int64))
            middle = tracks.mean(axis=1)
            if np.isfinite(middle).all(axis=1).mean() > _OFTEN:
                middles[names.index(child)] = middle
    return middles


def _move_centres_to_landmarks(
    fit: SpatialFit, locate: Callable[[SpatialFit], Mapping[str, LandmarkPosition]], numbers: Mapping[str, int]
) -> SpatialFit:
    """Return the fit with each centre of shoulder, elbow and wrist combined with the midpoint of its landmarks.

    The landmarks are located again for each centre, because the centre is the origin of its segment.
    """
    for child, pair in _MIDDLES.items():
        positions = locate(fit)
        if child not in numbers or not all(name in positions for name in pair):
            continue
        middle = np.mean([positions[name].local for name in pair], axis=0)
        sd = _GH_SD if pair == ("GH",) else float(np.sqrt(np.mean([positions[name].sd ** 2 for name in pair]) / 2))
        fit = move_centre(fit, numbers[child], middle, sd**2 * np.eye(3))
    return fit


def _fit_frames(
    fit: SpatialFit,
    positions: Mapping[str, LandmarkPosition],
    where: Mapping[str, int],
    poses: _ClusterPoses,
    option: int,
) -> AnatomicalFrames:
    """Return the anatomical frames of the ISB, expressed in the segment frames of the fit.

    ``where`` is the number of the segment by name of segment or landmark; ``option`` is the setting `humerus`.
    """
    local = {name: position.local for name, position in positions.items()}
    pairs = _find_pairs_at_joints(fit, local, where)
    for child, pair in pairs.items():
        shift = fit.chain.joints[where[child] - 1].centre - (local[pair[0]] + local[pair[1]]) / 2
        local |= {name: local[name] + shift for name in pair}
    covariances: dict[str, FloatArray | float] = {name: position.sd for name, position in positions.items()}
    if "upper_arm" in where and fit.chain.joints[where["upper_arm"] - 1].known:
        number = where["upper_arm"]
        covariance = fit.centre_among_markers(number, number)
        covariances["GH"] = covariance if np.isfinite(covariance).all() else PALPATION**2 * np.eye(3)
        local["GH"], where = np.zeros(3), {**where, "GH": number}
    bent = _find_bent_pose(local, where, poses) if option == 2 else None
    frames = fit_segment_frames(local, where, poses.find_pose_at_rest(), covariances=covariances, bent=bent)
    for child, pair in pairs.items():
        parent = fit.chain.joints[where[child] - 1].parent
        frames = set_middle_covariance(frames, pair, fit.centre_among_markers(where[child], parent))
    if option == 2 or not {"upper_arm", "forearm"} <= where.keys() or "upper_arm" not in frames.frames:
        return frames
    elbow = fit.chain.joints[where["forearm"] - 1]
    if elbow.kind == "ball" or not np.isfinite(elbow.axes_covariance[0]).all():
        return frames
    return rotate_to_elbow_axis(frames, elbow.first_axis, elbow.axes_covariance[0])


def _find_pairs_at_joints(
    fit: SpatialFit, local: Mapping[str, FloatArray], where: Mapping[str, int]
) -> dict[str, tuple[str, str]]:
    """Return the two landmarks beside each joint centre that the motion also determines, by name of the next segment.

    The result is empty if whole clusters slide, because the centres then move by centimetres between the clusters.
    """
    if any(joint.slide_sd for joint in fit.chain.joints):
        return {}
    return {
        child: pair
        for child, pair in PAIRS.items()
        if child in where
        and all(name in local for name in pair)
        and np.isfinite(fit.chain.joints[where[child] - 1].covariance).all()
    }


def _find_bent_pose(
    local: Mapping[str, FloatArray], where: Mapping[str, int], poses: _ClusterPoses
) -> ClusterPoses | None:
    """Return the poses in the frame in which the elbow is nearest to a right angle; None if its angle is unknown."""
    if not {"GH", "EL", "EM", "US"} <= local.keys():
        return None
    track = {
        name: np.einsum("fij,j->fi", poses.rotations[:, where[name]], local[name]) + poses.origins[:, where[name]]
        for name in ("GH", "EL", "EM", "US")
    }
    elbow = (track["EL"] + track["EM"]) / 2
    upper, lower = track["GH"] - elbow, elbow - track["US"]
    cosine = np.sum(upper * lower, axis=1) / np.linalg.norm(upper, axis=1) / np.linalg.norm(lower, axis=1)
    if not np.isfinite(cosine).any():
        return None
    frame = int(np.nanargmin(np.abs(cosine)))
    return ClusterPoses(poses.rotations[frame], poses.origins[frame])


def _list_covariances(frames: AnatomicalFrames) -> dict[str, list[list[float]]]:
    """Return the covariance (6, 6) of the rotation errors of the two frames at each joint, rad², by joint."""
    return {
        joint: frames.covariance(*pair).tolist()
        for joint, pair in JOINTS.items()
        if all(name in frames.frames for name in pair)
    }


def _make_landmark_arrays(
    local: Mapping[str, FloatArray], segment: Mapping[str, int], positions: Mapping[str, LandmarkPosition]
) -> dict[str, Any]:
    """Return the datasets of the group ``landmarks`` of chain.h5; ``local`` are their positions, m, by name."""
    return {
        "name": np.array(list(local), dtype=object),
        "segment": np.array([segment[name] for name in local], dtype=np.int64),
        "local": np.array(list(local.values()), dtype=np.float64).reshape(-1, 3),
        "sd": np.array([positions[name].sd for name in local], dtype=np.float64),
    }
