"""Landmarks in a fitted chain, also from pointers: they refine joint centres and define the anatomical frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
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
    SEGMENTS,
    LandmarkPosition,
    calibrate_pointer,
    find_landmarks,
    find_pointer_markers,
    find_still_pose,
    locate_landmarks,
    locate_pointed_landmark,
)
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import RecordingError
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.geometry.spatial_chain import SpatialChain, change_frames
from mocap_id.kinematics.space.bodies import rigid_poses
from mocap_id.kinematics.space.chain_fit import SpatialFit, move_centre
from mocap_id.stages.base import Context, Findings
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.skin_motion import correct_axial_rotation, fit_cluster_poses
from mocap_id.stages.trial_keys import TrialKeys, get_landmark_labels
from mocap_id.store.artefacts import Trajectories
from mocap_id.verdict import Reason

_OTHER_CLUSTER = 0.004  # m, largest rms change of a cluster between two recordings; skin and bending: 0.1 to 2.5 mm


def report_unused_pointers(out: Findings, trial: TrialKeys, names: Sequence[str], why: str = "") -> None:
    """Add a caution that names the landmarks under ``pointers:`` that have no effect; ``names`` are the segments."""
    missing = [str(name) for name in trial.pointers if SEGMENTS[str(name)] not in names]
    if missing:
        wanted = " or ".join(dict.fromkeys(SEGMENTS[name] for name in missing))
        why = why or (
            f"no segment is called {wanted}. The segments are called {', '.join(names)}: give their anatomical names, "
            "base first, such as `segment: {names: [thorax, upper_arm, forearm, hand]}`"
        )
        out.say("pointers-unused", f"{', '.join(missing)} under `pointers:` have no effect: {why}.", len(missing))


_ABOVE = (("IJ", "PX"), ("C7", "T8"))
"""Pairs of landmarks of the thorax; the first landmark of a pair is above the second."""
_BELOW = 0.05  # m, limit of the height difference, which is small in a person who lies
_OUT_OF_PLANE = 0.025  # m, largest rms distance of the thorax's landmarks from the plane through them
_BESIDE = 0.05  # m, largest distance of the midpoint of two landmarks from the joint centre found from the motion
_SURE = 0.02  # m; the distance has less weight in directions with a larger standard deviation
_ACROSS = 45.0  # degrees, largest angle between the line through the epicondyles and the axis found from the motion
_LENGTHS = {"upper_arm": (0.15, 0.45), "forearm": (0.12, 0.40)}
"""Shortest and longest segments of children and adults, m."""
_PAIRS = {"forearm": ("EL", "EM"), "hand": ("RS", "US")}
"""Landmarks on both sides of the joint before a segment."""


def _find_contradictions(
    fit: SpatialFit,
    at: Mapping[str, FloatArray],
    frames: AnatomicalFrames,
    where: Mapping[str, int],
    standing: ClusterPoses,
) -> list[str]:
    """Return a text for each contradiction with the anatomy of an arm.

    ``fit`` is the chain before its joint centres are moved to landmarks, ``at`` the landmarks in the axes of their
    segments, m, and ``where`` the number of each segment. In ``standing``, the still pose, the y axis points up.
    """
    doubts = []
    joints = {name: fit.chain.joints[number - 1] for name, number in where.items() if number}
    if (thorax := frames.frames.get("thorax")) is not None:
        own = where["thorax"]
        for upper, lower in _ABOVE:
            below = float(standing.place(at[lower], own)[1] - standing.place(at[upper], own)[1])
            if below > _BELOW:
                doubts.append(f"at rest, {upper} is {1e3 * below:.0f} mm below {lower}")
        landmarks = np.array([at[name] for name in THORAX.up])
        off = float(np.linalg.svd(landmarks - landmarks.mean(axis=0), compute_uv=False)[-1]) / np.sqrt(len(landmarks))
        if off > _OUT_OF_PLANE:
            doubts.append(f"{', '.join(THORAX.up)} are {1e3 * off:.0f} mm out of one plane (rms)")
        shoulder = joints.get("upper_arm")
        if shoulder is not None and shoulder.known and shoulder.parent == own:
            side = float((shoulder.centre - thorax.origin) @ thorax.rotation[:, 2])
            if side < 0:
                doubts.append("the shoulder is on the other side of the thorax, as if IJ and C7 were exchanged")
    for child, pair in _PAIRS.items():  # centres and axes found from the motion
        joint = joints.get(child)
        if joint is None or not all(name in at for name in pair):
            continue
        if not joint.known or not np.isfinite(joint.covariance).all():
            continue
        across = at[pair[0]] - at[pair[1]]
        apart = joint.centre - (at[pair[0]] + at[pair[1]]) / 2
        away = float(np.sqrt(apart @ np.linalg.solve(joint.covariance / _SURE**2 + np.eye(3), apart)))
        if away > _BESIDE:
            doubts.append(
                f"the midpoint of {pair[0]} and {pair[1]} is {1e3 * away:.0f} mm from the centre of their joint"
            )
        if child == "forearm" and joint.kind == "two-axis" and np.isfinite(joint.axes_covariance[0]).all():
            cosine = abs(float(across @ joint.first_axis)) / max(float(np.linalg.norm(across)), 1e-9)
            angle = float(np.degrees(np.arccos(min(cosine, 1.0))))
            if angle > _ACROSS:
                doubts.append(f"the line through EL and EM is {angle:.0f}° from the axis about which the elbow bends")
    lengths = {}
    for name, tip in (("upper_arm", "forearm"), ("forearm", "hand")):
        joint = joints.get(tip)
        if joint is not None and joint.known and joint.parent == where.get(name):
            lengths[name] = float(np.linalg.norm(joint.centre))
    return doubts + check_lengths(lengths)


def check_lengths(lengths: Mapping[str, float]) -> list[str]:
    """Return a text for each impossible length of upper arm or forearm; ``lengths`` are in m, by segment."""
    return [
        f"the {name.replace('_', ' ')} is {length:.3g} m long, expected {shortest:g} to {longest:g} m"
        for name, length in lengths.items()
        for shortest, longest in [_LENGTHS[name]]
        if not shortest <= length <= longest
    ]


def report_implausible_arm(out: Findings, doubts: Sequence[str]) -> None:
    """Add a caution that lists the contradictions ``doubts`` with the anatomy of an arm, if there are any."""
    if doubts:
        text = "Check the names of the landmarks, and the unit and the vertical axis of the recording; the angles are"
        out.say("landmarks-implausible", f"{'; '.join(doubts)}. {text} wrong", float(len(doubts)), 0.0)


MIDDLES = {"upper_arm": ("GH",), "forearm": ("EL", "EM"), "hand": ("RS", "US")}
"""Landmarks whose midpoint is the centre of the joint before a segment, by this segment."""
_GH_SD = 0.01
"""Standard deviation of a marker at the shoulder centre from this centre, along each axis, m."""
_OVERVIEW = 600
"""Largest number of frames, evenly over the recording, in which the poses are computed besides the still pose."""
_JOINTS = {"shoulder": ("thorax", "upper_arm"), "elbow": ("upper_arm", "forearm"), "wrist": ("forearm", "hand")}
"""Segments before and after each joint that has angles by the definitions of the ISB."""


def fit_anatomical_frames(
    out: Findings, context: Context, view: Trajectories, fit: SpatialFit, *, columns: IntArray, names: Sequence[str]
) -> tuple[SpatialFit, SpatialChain, dict[str, Any]]:
    """Refine the joint centres by landmarks and express the chain in the anatomical frames of the ISB.

    The results are the fit with joint centres refined by landmarks, the same chain in anatomical frames (without
    landmarks, in the frames of the fit), and the datasets of the group ``landmarks`` of chain.h5. The facts ``frames``
    ("isb", or "own" without landmarks), ``still_s`` and ``frame_covariance``, and cautions and notes about landmarks
    are added to ``out``. ``columns`` (M,) are the indices of the chain's markers in ``view``, and ``names`` (n + 1) the
    names of the segments; only segments with anatomical names get anatomical frames.
    """
    settings: FitJointsSettings = context.settings
    trial = context.trial
    numbers = {name: k for k, name in enumerate(names)}
    named = find_landmarks(view.labels, get_landmark_labels(trial), trial.side)
    markers = {name: marker for name, marker in named.markers.items() if SEGMENTS[name] in numbers}
    known = {*markers, *(str(name) for name in trial.pointers)}
    segment = {name: numbers[SEGMENTS[name]] for name in known if SEGMENTS[name] in numbers}
    if segment.get("GH"):
        segment["GH"] = fit.chain.joints[segment["GH"] - 1].parent
    if not segment:
        out.fact(frames="own")
        return fit, fit.chain, make_landmark_arrays({}, {}, {})
    tracks = view.read_positions(np.array(list(markers.values()), dtype=np.int64))
    points = view.read_positions(columns)
    given = None
    if isinstance(trial.static, tuple):
        given = (trial.static[0] - float(view.time[0]), trial.static[1] - float(view.time[0]))
    pose = find_still_pose(points, view.rate, given)
    # the still frames, and frames over the whole recording
    overview = np.arange(0, len(points), 1 + len(points) // _OVERVIEW)
    chosen = np.union1d(overview, np.arange(pose.frames.start, pose.frames.stop))
    first = int(np.searchsorted(chosen, pose.frames.start))
    still = slice(first, first + pose.frames.stop - pose.frames.start)
    moving = dict(zip(markers, np.moveaxis(tracks[chosen], 1, 0), strict=True))

    # recordings of the pointer by landmark, and its markers, which are not in the trial
    files = {str(name): path for name, path in trial.pointers.items() if str(name) in segment}
    touches = {name: recording.read(path) for name, path in files.items()}
    rod: tuple[str, ...] = ()
    if files:
        rod = tuple(trial.pointer) or find_pointer_markers(view.labels, [each.labels for each in touches.values()])
        for name, each in touches.items():
            missing = [label for label in rod if label not in each.labels]
            if missing:
                raise RecordingError(
                    f"{files[name]}: the pointer's markers {', '.join(missing)} are missing; the file has "
                    f"{', '.join(each.labels)}"
                )
        if len(rod) < 2:
            raise RecordingError(
                f"{next(iter(files.values()))}: {len(rod)} markers are in all recordings of the pointer but not in "
                "this trial; expected at least two, the markers of the pointer"
            )

    def locate(fit: SpatialFit) -> tuple[dict[str, LandmarkPosition], list[Reason], FloatArray, FloatArray]:
        """Return landmarks in the segments of a fit, cautions, and the poses of all clusters in the chosen frames."""
        chain = fit.chain
        rotations, origins = fit_cluster_poses(correct_axial_rotation(points[chosen], chain), chain)
        sd = settings.palpation_sd_m
        positions, notes = locate_landmarks(moving, segment, rotations, origins, frames=still, palpation=sd)
        reasons, rods = list(notes), {}
        for name, each in touches.items():  # what each recording of the pointer shows of rod and landmark's segment
            there = PlaneFrame(0.0).to_plane(each.positions)
            there = mirror_points(there) if view.planar.facts["side"] == "left" else there
            own = {m: view.labels[columns[m]] for m in np.flatnonzero(chain.segment == segment[name])}
            own = {m: label for m, label in own.items() if label in each.labels}
            if len(own) < 3:
                raise RecordingError(
                    f"{each.files[0]}: the recording has {len(own)} markers of the landmark's segment, expected at "
                    "least 3"
                )
            cluster, local = there[:, [each.labels.index(label) for label in own.values()]], chain.local[list(own)]
            rotation, origin, _ = rigid_poses(cluster, local)
            off = cluster - (np.einsum("fij,kj->fki", rotation, local) + origin[:, None])
            squares = np.sum(off**2, axis=2)[np.isfinite(rotation[:, 0, 0])]
            squares = squares[np.isfinite(squares)]
            away = float(np.sqrt(squares.mean())) if squares.size else 0.0
            if away > _OTHER_CLUSTER:
                text = (
                    f"{name}: in {files[name].name}, the markers of the landmark's segment are {1e3 * away:.1f} mm rms "
                    f"from their places in this trial, expected below {1e3 * _OTHER_CLUSTER:.0f} mm: two labels are "
                    "exchanged in one of the recordings, or the markers were placed again."
                )
                reasons.append(Reason("pointer-cluster", text, away, _OTHER_CLUSTER))
            rods[name] = there[:, [each.labels.index(label) for label in rod]], rotation, origin
        if rods:
            pointer = (
                (np.array(list(trial.pointer.values())), 0.0)
                if trial.pointer
                else calibrate_pointer(list(rods.values()))
            )
        for name, touch in rods.items():
            try:
                positions[name], cautions = locate_pointed_landmark(*touch, pointer, sd)
            except RecordingError as error:
                raise RecordingError(f"{files[name]}: {error}") from error
            reasons += [replace(each, message=f"{name}: {each.message}.") for each in cautions]
        return positions, reasons, rotations, origins

    # The centres of shoulder, elbow and wrist are combined with the midpoints of their landmarks. The landmarks are
    # located again for each centre, because the centre is the origin of its segment.
    refined, located = fit, locate(fit)
    measured = {name: place.local for name, place in located[0].items()}
    for child, beside in MIDDLES.items():
        positions = located[0]
        if numbers.get(child) and all(name in positions for name in beside):  # the base has no joint
            middle = np.mean([positions[name].local for name in beside], axis=0)
            square = np.mean([positions[name].sd ** 2 for name in beside]) / 2
            sd = _GH_SD if beside == ("GH",) else float(np.sqrt(square))
            refined = move_centre(refined, numbers[child], middle, sd**2 * np.eye(3))
            located = locate(refined)
    positions, reasons, rotations, origins = located
    complete = still.start + np.flatnonzero(np.isfinite(rotations[still]).all(axis=(1, 2, 3)))
    moment = int(complete[len(complete) // 2]) if len(complete) else still.start
    standing = ClusterPoses(rotations[moment], origins[moment])

    # The landmarks on both sides of a joint are shifted, so that their middle is the centre, if the motion also
    # determines it; not if whole clusters slide, because the centres then move by centimetres between the clusters.
    joints, where = refined.chain.joints, {**segment, **numbers}
    at = {name: position.local for name, position in positions.items()}
    pairs = {
        child: pair
        for child, pair in _PAIRS.items()
        if not any(joint.slide_sd for joint in joints)
        and where.get(child)  # the base has no joint
        and all(name in at for name in pair)
        and np.isfinite(joints[where[child] - 1].covariance).all()
    }
    for child, pair in pairs.items():
        shift = joints[where[child] - 1].centre - (at[pair[0]] + at[pair[1]]) / 2
        at |= {name: at[name] + shift for name in pair}
    covariances: dict[str, FloatArray | float] = {name: position.sd for name, position in positions.items()}
    number = where.get("upper_arm", 0)
    if number and joints[number - 1].known:  # an upper arm that is the base has no shoulder
        covariance = refined.centre_among_markers(number, number)
        covariances["GH"] = covariance if np.isfinite(covariance).all() else PALPATION**2 * np.eye(3)
        at["GH"], where["GH"] = np.zeros(3), number
    bent = None
    if settings.humerus == 2 and {"GH", "EL", "EM", "US"} <= at.keys():  # the elbow is nearest to a right angle
        track = {
            name: np.einsum("fij,j->fi", rotations[:, where[name]], at[name]) + origins[:, where[name]]
            for name in ("GH", "EL", "EM", "US")
        }
        middle = (track["EL"] + track["EM"]) / 2
        upper, lower = track["GH"] - middle, middle - track["US"]
        cosine = np.sum(upper * lower, axis=1) / np.linalg.norm(upper, axis=1) / np.linalg.norm(lower, axis=1)
        if np.isfinite(cosine).any():
            frame = int(np.nanargmin(np.abs(cosine)))
            bent = ClusterPoses(rotations[frame], origins[frame])
    # the anatomical frames of the ISB, expressed in the segment frames of the fit
    frames = fit_segment_frames(at, where, standing, covariances=covariances, bent=bent)
    for child, pair in pairs.items():
        parent = joints[where[child] - 1].parent
        frames = set_middle_covariance(frames, pair, refined.centre_among_markers(where[child], parent))
    if settings.humerus == 1 and {"upper_arm", "forearm"} <= where.keys() and "upper_arm" in frames.frames:
        elbow = joints[where["forearm"] - 1]
        if where["forearm"] and elbow.kind != "ball" and np.isfinite(elbow.axes_covariance[0]).all():
            frames = rotate_to_elbow_axis(frames, elbow.first_axis, elbow.axes_covariance[0])
    out.reasons += [*named.reasons, *pose.reasons, *reasons]
    report_implausible_arm(out, _find_contradictions(fit, measured, frames, numbers, standing))
    out.reasons += frames.reasons
    out.fact(
        frames="isb" if frames.frames else "own",
        still_s=[float(view.time[pose.frames.start]), float(view.time[pose.frames.stop - 1])],
        frame_covariance={
            joint: frames.covariance(*pair).tolist()
            for joint, pair in _JOINTS.items()
            if all(name in frames.frames for name in pair)
        },
    )
    turns = np.stack([frames.frames[name].rotation if name in frames.frames else np.eye(3) for name in names])
    shifts = np.zeros((len(names), 3))
    shifts[0] = frames.frames[names[0]].origin if names[0] in frames.frames else np.zeros(3)
    local = {name: turns[segment[name]].T @ (each.local - shifts[segment[name]]) for name, each in positions.items()}
    landmarks = make_landmark_arrays(local, segment, positions)
    return refined, change_frames(refined.chain, turns, shifts[0]), landmarks


def make_landmark_arrays(
    local: Mapping[str, FloatArray], segment: Mapping[str, int], positions: Mapping[str, LandmarkPosition]
) -> dict[str, Any]:
    """Return the datasets of the group ``landmarks`` of chain.h5; ``local`` are their positions, m, by name."""
    return {
        "name": np.array(list(local), dtype=object),
        "segment": np.array([segment[name] for name in local], dtype=np.int64),
        "local": np.array(list(local.values()), dtype=np.float64).reshape(-1, 3),
        "sd": np.array([positions[name].sd for name in local], dtype=np.float64),
    }
