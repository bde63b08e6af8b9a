"""Landmarks of the body in a fitted chain: centres refined by them, and the chain in anatomical frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_id.anatomy.frames import PALPATION
from mocap_id.anatomy.landmark_names import SEGMENTS, find_landmarks
from mocap_id.anatomy.segment_frames import (
    AnatomicalFrames,
    ElbowAxis,
    SegmentPoses,
    fit_segment_frames,
    rotate_to_elbow_axis,
    set_middle_covariance,
)
from mocap_id.anatomy.still_pose import LandmarkPosition, find_still_pose, locate_landmarks
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.geometry.spatial_frames import change_frames
from mocap_id.kinematics.space.chain_result import SpatialFit, move_centre
from mocap_id.stages.base import Context
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.fit_joints.landmark_checks import landmark_doubts
from mocap_id.stages.fit_joints.pointed_landmarks import MarkedChain, read_pointed_landmarks
from mocap_id.stages.skin_motion import correct_axial_rotation, fit_cluster_poses
from mocap_id.stages.trial_keys import get_landmark_labels
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_MIDDLES = {"upper_arm": ("GH",), "forearm": ("EL", "EM"), "hand": ("RS", "US")}
"""Landmarks whose middle is the centre of the joint above a segment."""
_PAIRS = {"forearm": ("EL", "EM"), "hand": ("RS", "US")}
"""Those of elbow and wrist."""
_GH_SD = 0.01
"""Standard deviation of a shoulder centre that is given as a marker along each axis, m."""
_OFTEN = 0.5
"""Share of the frames in which landmarks beside a joint must be seen to start the fit."""
_OVERVIEW = 600
"""Number of frames that show how segments turn outside the still pose."""
JOINTS = {"shoulder": ("thorax", "upper_arm"), "elbow": ("upper_arm", "forearm"), "wrist": ("forearm", "hand")}
"""Segments between which the ISB defines angles."""


@dataclass(frozen=True)
class AnatomicalChain:
    """A fitted chain in anatomical frames, or in frames of its own without landmarks.

    Parameters
    ----------
    fit : SpatialFit
        With centres refined by landmarks, in frames of its own.
    chain : SpatialChain
    landmarks : mapping
        Nodes of the group ``landmarks`` of chain.h5.
    facts : mapping
        ``frames`` ("isb" or "own"), ``still_s`` and ``frame_covariance``.
    """

    fit: SpatialFit
    chain: SpatialChain
    landmarks: Mapping[str, Any]
    facts: Mapping[str, Any] = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()


def in_anatomical_frames(
    context: Context, view: Trajectories, fit: SpatialFit, columns: IntArray, names: Sequence[str]
) -> AnatomicalChain:
    """Refine the centres of elbow and wrist by landmarks and express the chain in the frames of the ISB.

    Parameters
    ----------
    context : Context
    view : Trajectories
    fit : SpatialFit
        Of the markers in ``columns``.
    columns : (M,) int array
    names : sequence of str, length n + 1
        Names of the segments; the frames of those with anatomical names are changed.
    """
    settings: FitJointsSettings = context.settings
    numbers = {name: k for k, name in enumerate(names)}
    named = find_landmarks(view.labels, get_landmark_labels(context.trial), context.trial.side)
    wanted = {name: marker for name, marker in named.markers.items() if SEGMENTS[name] in numbers}
    known = {*wanted, *(str(name) for name in context.trial.pointers)}
    segment = {name: numbers[SEGMENTS[name]] for name in known if SEGMENTS[name] in numbers}
    if "GH" in segment:
        segment["GH"] = fit.chain.joints[segment["GH"] - 1].parent
    if not segment:
        return AnatomicalChain(fit, fit.chain, _landmarks({}, {}), {"frames": "own"})
    tracks = view.read_positions(np.array(list(wanted.values()), dtype=np.int64))
    points = view.read_positions(columns)
    static = context.trial.static
    start = None if static is None else (static[0] - float(view.time[0]), static[1] - float(view.time[0]))
    still = find_still_pose(points, view.rate, start)
    some, at_rest = _some_frames(still.frames, len(points))
    moving = dict(zip(wanted, np.moveaxis(tracks[some], 1, 0), strict=True))

    def placed(fit: SpatialFit) -> tuple[dict[str, LandmarkPosition], tuple[Reason, ...], _ClusterPoses]:
        poses = _ClusterPoses.of(points[some], fit.chain, at_rest)
        seen, notes = locate_landmarks(
            moving, segment, poses.rotations, poses.origins, frames=at_rest, palpation=settings.palpation_sd_m
        )
        left = view.planar.facts["side"] == "left"
        marked = MarkedChain(fit.chain, tuple(view.labels[m] for m in columns), left)
        pointed, more = read_pointed_landmarks(context.trial, marked, segment, view.labels, settings.palpation_sd_m)
        return {**seen, **pointed}, (*notes, *more), poses

    moved = _with_middles(fit, lambda fit: placed(fit)[0], numbers)
    places, reasons, poses = placed(moved)
    frames = _frames(moved, places, {**segment, **numbers}, poses, settings.humerus)
    reasons += landmark_doubts(fit, placed(fit)[0], frames, numbers, poses.standing())
    turns = np.stack([frames.frames[name].rotation if name in frames.frames else np.eye(3) for name in names])
    base = frames.frames[names[0]].origin if names[0] in frames.frames else np.zeros(3)
    shifts = np.zeros((len(names), 3))
    shifts[0] = base
    local = {name: turns[segment[name]].T @ (each.local - shifts[segment[name]]) for name, each in places.items()}
    facts = {
        "frames": "isb" if frames.frames else "own",
        "still_s": [float(view.time[still.frames.start]), float(view.time[still.frames.stop - 1])],
        "frame_covariance": _covariances(frames),
    }
    found = _landmarks({name: (segment[name], local[name]) for name in places}, places)
    chain = change_frames(moved.chain, turns, base)
    return AnatomicalChain(moved, chain, found, facts, (*named.reasons, *still.reasons, *reasons, *frames.reasons))


def _some_frames(still: slice, count: int) -> tuple[IntArray, slice]:
    """Return the still frames and others over the whole recording, and where the still ones are among them."""
    rest = np.arange(0, count, 1 + count // _OVERVIEW)
    frames = np.union1d(rest, np.arange(still.start, still.stop))
    first = int(np.searchsorted(frames, still.start))
    return frames, slice(first, first + still.stop - still.start)


@dataclass(frozen=True)
class _ClusterPoses:
    """Poses of all segments in the frames of the chain, (F, S, 3, 3) and (F, S, 3), and the still frames."""

    rotations: FloatArray
    origins: FloatArray
    still: slice

    @classmethod
    def of(cls, points: FloatArray, chain: SpatialChain, still: slice) -> _ClusterPoses:
        return cls(*fit_cluster_poses(correct_axial_rotation(points, chain), chain), still)

    def standing(self) -> SegmentPoses:
        """Return the pose in the middle of the still frames that show all clusters; without any, in the first one."""
        seen = self.still.start + np.flatnonzero(np.isfinite(self.rotations[self.still]).all(axis=(1, 2, 3)))
        middle = int(seen[len(seen) // 2]) if len(seen) else self.still.start
        return SegmentPoses(self.rotations[middle], self.origins[middle])


def points_near_joints(context: Context, view: Trajectories, names: Sequence[str]) -> dict[int, FloatArray]:
    """Return the middles of the landmarks beside the joints of an arm (F, 3), m, by the number of the segment."""
    markers = find_landmarks(view.labels, get_landmark_labels(context.trial), context.trial.side).markers
    found = {}
    for child, pair in _MIDDLES.items():
        if child in names and names.index(child) > 0 and all(name in markers for name in pair):
            tracks = view.read_positions(np.array([markers[name] for name in pair], dtype=np.int64))
            middle = tracks.mean(axis=1)
            if np.isfinite(middle).all(axis=1).mean() > _OFTEN:
                found[names.index(child)] = middle
    return found


def _with_middles(
    fit: SpatialFit, placed: Callable[[SpatialFit], Mapping[str, LandmarkPosition]], numbers: Mapping[str, int]
) -> SpatialFit:
    """Return the fit with the centres of shoulder, elbow and wrist also measured by their landmarks.

    The landmarks are placed anew for each centre, because a centre that moves is the origin of its segment's frame.
    """
    for child, pair in _MIDDLES.items():
        places = placed(fit)
        if child not in numbers or not all(name in places for name in pair):
            continue
        middle = np.mean([places[name].local for name in pair], axis=0)
        sd = _GH_SD if pair == ("GH",) else float(np.sqrt(np.mean([places[name].sd ** 2 for name in pair]) / 2))
        fit = move_centre(fit, numbers[child], middle, sd**2 * np.eye(3))
    return fit


def _frames(
    fit: SpatialFit,
    places: Mapping[str, LandmarkPosition],
    where: Mapping[str, int],
    poses: _ClusterPoses,
    option: int,
) -> AnatomicalFrames:
    """Return the ISB frames in the frames of the chain; ``where`` has the segment of each frame and landmark."""
    at = _about_centres(fit, {name: place.local for name, place in places.items()}, where)
    spread: dict[str, FloatArray | float] = {name: place.sd for name, place in places.items()}
    standing = poses.standing()
    if "upper_arm" in where and fit.chain.joints[where["upper_arm"] - 1].known:
        number = where["upper_arm"]
        at["GH"], spread["GH"] = np.zeros(3), _known_covariance(fit.centre_among_markers(number, number))
        where = {**where, "GH": number}
    bent = _bent_pose(at, where, poses) if option == 2 else None
    found = fit_segment_frames(at, where, standing, covariances=spread, bent=bent)
    for child, pair in _pairs_at_joints(fit, at, where).items():
        parent = fit.chain.joints[where[child] - 1].parent
        found = set_middle_covariance(found, pair, fit.centre_among_markers(where[child], parent))
    if option == 2 or not {"upper_arm", "forearm"} <= where.keys() or "upper_arm" not in found.frames:
        return found
    elbow = fit.chain.joints[where["forearm"] - 1]
    if elbow.kind == "ball" or not np.isfinite(elbow.axes_covariance[0]).all():
        return found
    return rotate_to_elbow_axis(found, ElbowAxis(elbow.first_axis, elbow.axes_covariance[0]))


def _pairs_at_joints(
    fit: SpatialFit, at: Mapping[str, FloatArray], where: Mapping[str, int]
) -> dict[str, tuple[str, str]]:
    """Return the pairs of landmarks whose middle is a centre that the motion shows too, by the child's name.

    There are none if whole clusters slide: the centres then move by centimetres between the clusters.
    """
    if any(joint.slide_sd for joint in fit.chain.joints):
        return {}
    return {
        child: pair
        for child, pair in _PAIRS.items()
        if child in where
        and all(name in at for name in pair)
        and np.isfinite(fit.chain.joints[where[child] - 1].covariance).all()
    }


def _about_centres(fit: SpatialFit, at: Mapping[str, FloatArray], where: Mapping[str, int]) -> dict[str, FloatArray]:
    """Return the landmarks' places, with pairs beside a joint moved so that their middle is its centre."""
    moved = dict(at)
    for child, pair in _pairs_at_joints(fit, at, where).items():
        off = fit.chain.joints[where[child] - 1].centre - (at[pair[0]] + at[pair[1]]) / 2
        moved |= {name: at[name] + off for name in pair}
    return moved


def _known_covariance(covariance: FloatArray) -> FloatArray:
    return covariance if np.isfinite(covariance).all() else PALPATION**2 * np.eye(3)


def _bent_pose(at: Mapping[str, FloatArray], where: Mapping[str, int], poses: _ClusterPoses) -> SegmentPoses | None:
    """Return the pose in which the elbow is nearest to a right angle."""
    if not {"GH", "EL", "EM", "US"} <= at.keys():
        return None
    place = {
        name: np.einsum("fij,j->fi", poses.rotations[:, where[name]], at[name]) + poses.origins[:, where[name]]
        for name in ("GH", "EL", "EM", "US")
    }
    elbow = (place["EL"] + place["EM"]) / 2
    upper, lower = place["GH"] - elbow, elbow - place["US"]
    cosine = np.sum(upper * lower, axis=1) / np.linalg.norm(upper, axis=1) / np.linalg.norm(lower, axis=1)
    if not np.isfinite(cosine).any():
        return None
    frame = int(np.nanargmin(np.abs(cosine)))
    return SegmentPoses(poses.rotations[frame], poses.origins[frame])


def _covariances(frames: AnatomicalFrames) -> dict[str, list[list[float]]]:
    """Return for each joint of the arm the covariance (6, 6) of the errors of its two frames, rad²."""
    return {
        joint: frames.covariance(*pair).tolist()
        for joint, pair in JOINTS.items()
        if all(name in frames.frames for name in pair)
    }


def _landmarks(found: Mapping[str, tuple[int, FloatArray]], places: Mapping[str, LandmarkPosition]) -> dict[str, Any]:
    return {
        "name": np.array(list(found), dtype=object),
        "segment": np.array([k for k, _ in found.values()], dtype=np.int64),
        "local": np.array([local for _, local in found.values()], dtype=np.float64).reshape(-1, 3),
        "sd": np.array([places[name].sd for name in found], dtype=np.float64),
    }
