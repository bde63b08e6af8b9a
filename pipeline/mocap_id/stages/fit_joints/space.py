"""Function of the stage fit-joints in space, which fits kinds, centres and axes of the joints, and landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.anatomy.landmarks import ARM, TRUNK, find_landmarks, find_roles
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import JointKind, SpatialJoint
from mocap_id.kinematics.space.chain_fit import fit_spatial_chain, has_known_axes, refine_axes
from mocap_id.kinematics.space.skeleton import LASTING_SD, Trunk, fit_bone, fit_sensor_noise, fit_trunk
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.calibration_trial import read_chain
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.fit_joints.anatomy import (
    MIDDLES,
    check_lengths,
    fit_anatomical_frames,
    make_landmark_arrays,
    report_implausible_arm,
    report_unused_pointers,
)
from mocap_id.stages.fit_joints.plane import report_estimator, report_uncertain_centre
from mocap_id.stages.skin_motion import correct_axial_rotation, fit_cluster_poses
from mocap_id.stages.trial_keys import Calibration, get_landmark_labels
from mocap_id.store import Tree
from mocap_id.store.artefacts import SpatialSkeleton, Trajectories, is_skeleton
from mocap_id.store.provenance import CHAIN
from mocap_id.verdict import Reason

_ANATOMICAL_KINDS: Mapping[str, JointKind] = {
    "clavicle": "ball",
    "shoulder": "ball",
    "elbow": "two-axis",
    "wrist": "ball",
}
"""Kinds of joints with anatomical names; the motion alone may be too simple to determine them."""
_GIRDLE = "girdle"
"""Segment of the shoulder girdle, on which the markers slide over the shoulder blade."""
_JOINT_ARRAYS = (
    *("centre", "covariance", "axes_covariance", "offset", "slide_sd"),
    *("glide", "glide_covariance", "rest", "long_axis", "untwisted"),
)
"""Numbers and arrays of a joint that have the same name in chain.h5."""
_OFTEN = 0.5
"""Smallest share of frames in which the landmarks beside a joint are visible, so that they help the joint fit."""
_CORRECTED_BY = 600
"""Largest number of frames used to correct the axes of a calibration."""
_WIDE = 60.0
"""Rotation of a joint, degrees; if it is larger and the centre is unknown, more rotation would not help."""
_MORE_MOTION = "Name a trial of the same person with a larger motion as `calibration:`."
_RIGID_MARKERS = (
    "The rotation is large enough, but about one axis only, or the markers of its segments move too much against each "
    "other: each segment needs three markers that do not move against each other, also thorax and shoulder blade."
)


def fit_chain_in_space(context: Context) -> Outputs:
    """Return chain.h5 of a trial in space."""
    trial, out = context.trial, Findings()
    settings: FitJointsSettings = context.settings
    if trial.calibration is not None:
        return (_use_calibration(context, trial.calibration),)
    if is_skeleton(context.long("planar.parquet").facts):
        return fit_skeleton_chain(context)
    segments = context.table("segments.parquet")
    view = Trajectories(context.long("planar.parquet"), segments.facts.get("bad_stretches", ()))
    assigned = np.flatnonzero(segments["segment"] >= 0)
    labels, segment = [str(label) for label in segments["marker"][assigned]], segments["segment"][assigned]
    columns = np.array([view.labels.index(label) for label in labels], dtype=np.int64)
    names, joint_names = segments.facts["names"], segments.facts["joint_names"]
    unknown = [name for name in settings.kinds if name not in joint_names]
    if unknown:
        raise ConfigError(
            f"fit-joints: kinds: there is no joint {', '.join(unknown)}; expected one of {', '.join(joint_names)}"
        )
    of_names: dict[str, JointKind] = {**_ANATOMICAL_KINDS, **settings.kinds}
    kinds = {k: of_names[name] for k, name in enumerate(joint_names, start=1) if name in of_names}
    assert settings.estimator != "rigid-body"
    assert settings.estimator != "circle"
    # landmarks beside the joints of an arm, whose midpoints (F, 3), m, are near the centres
    landmark_columns = find_landmarks(view.labels, get_landmark_labels(trial), trial.side).markers
    near = {}
    for child, pair in MIDDLES.items():
        if child in names and names.index(child) > 0 and all(name in landmark_columns for name in pair):
            tracks = view.read_positions(np.array([landmark_columns[name] for name in pair], dtype=np.int64))
            middle = tracks.mean(axis=1)
            if np.isfinite(middle).all(axis=1).mean() > _OFTEN:
                near[names.index(child)] = middle
    fit = fit_spatial_chain(
        view.read_positions(columns),
        segment,
        segments.facts["parents"],
        kinds,
        estimator=settings.estimator,
        near=near,
        firm=[k for k, name in enumerate(names) if name == _GIRDLE],
        girdle=np.flatnonzero(columns == landmark_columns.get("AC", -1)).tolist(),
    )
    report_estimator(out, settings)
    for name, joint, each in zip(joint_names, fit.chain.joints, fit.evidence, strict=True):
        arc = float(np.degrees(each.arc))
        known = np.isfinite(joint.covariance).all()
        if not joint.known:
            out.say(
                "centre-unknown",
                f"the motion does not determine the centre of the {name}, which rotates by {arc:.0f}°; no length "
                f"or angle depends on it. {_MORE_MOTION if arc < _WIDE else _RIGID_MARKERS}",
                arc,
            )
        elif joint.kind != "hinge" and known:  # the place of a hinge's centre along its axis has no meaning
            sd = float(np.sqrt(np.linalg.eigvalsh(joint.covariance)[-1]))
            if sd > settings.large_sd_m:
                report_uncertain_centre(out, name, sd, settings.large_sd_m)
    refined, chain, landmarks = fit_anatomical_frames(out, context, view, fit, columns=columns, names=names)
    for k, (name, joint) in enumerate(zip(joint_names, fit.chain.joints, strict=True), start=1):
        if kinds.get(k) == "two-axis" and joint.kind == "ball":
            text = f"the two axes of the {name} are nearly parallel in this motion, so it is fitted as a ball joint."
            out.say("axes-parallel", text, level="ok")
    report_unused_pointers(out, trial, names)
    facts = {
        "estimator": settings.estimator,
        "iterations": refined.bundle.iterations,
        "reprojection_rms_m": float(np.sqrt(np.mean(refined.residual[segment > 0] ** 2))),
        "evidence": {name: dict(each.ratio) for name, each in zip(joint_names, fit.evidence, strict=True)},
        "likely": {name: each.likely for name, each in zip(joint_names, fit.evidence, strict=True)},
        **out.facts,
    }
    inner = len(chain.joints) - 1
    data = {
        "joints": {
            "name": np.array(joint_names, dtype=object),
            "parent": np.array(chain.parents, dtype=np.int64),
            "arc": np.array([each.arc for each in fit.evidence]),
            **make_joint_arrays(chain.joints),
        },
        "segments": {
            "name": np.array(names, dtype=object),
            "length": refined.lengths[:inner],
            "length_sd": refined.length_sd[:inner],
        },
        "markers": {
            "name": np.array(labels, dtype=object),
            "segment": chain.segment,
            "local": chain.local,
            "residual": refined.residual,
            "on_glide": chain.on_glide,
            "skin": chain.skin,
            "skin_sd": chain.skin_sd,
        },
        "landmarks": landmarks,
    }
    return (Tree(CHAIN, data, facts, tuple(out.reasons)),)


def make_joint_arrays(joints: tuple[SpatialJoint, ...]) -> dict[str, Any]:
    """Return the datasets of the group ``joints`` of chain.h5 except names, parents and arcs; one row per joint."""
    arrays = {name: np.array([getattr(joint, name) for joint in joints], dtype=np.float64) for name in _JOINT_ARRAYS}
    return {
        "kind": np.array([joint.kind for joint in joints], dtype=object),
        "axes": np.array([[joint.first_axis, joint.second_axis] for joint in joints], dtype=np.float64),
        "known": np.array([joint.known for joint in joints], dtype=np.bool_),
        **arrays,
    }


def _use_calibration(context: Context, calibration: Calibration) -> Tree:
    """Return the chain of the calibration with only the markers of this trial, and axes corrected by its motion."""
    tree, name, out = read_chain(calibration), calibration.trial.name, Findings()
    segments, planar = context.table("segments.parquet"), context.long("planar.parquet")
    assigned = {str(label) for label, k in zip(segments["marker"], segments["segment"], strict=True) if k >= 0}
    keep = np.array([label in assigned for label in tree.texts("markers/name")], dtype=np.bool_)
    markers: Mapping[str, Any] = tree.data["markers"]  # type: ignore[assignment]
    data = {**tree.data, "markers": {key: np.asarray(values)[keep] for key, values in markers.items()}}
    skeleton = SpatialSkeleton(Tree(CHAIN, data, tree.facts))
    addition = ""
    cameras = is_skeleton(planar.facts) or tree.facts["frames"] == "skeleton"
    if not cameras and any(has_known_axes(joint) for joint in skeleton.chain.joints):
        view = Trajectories(planar, segments.facts.get("bad_stretches", ()))
        columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
        points = view.read_positions(columns)[:: 1 + len(view.time) // _CORRECTED_BY]
        rotations, _ = fit_cluster_poses(correct_axial_rotation(points, skeleton.chain), skeleton.chain)
        chain, refined = refine_axes(skeleton.chain, rotations)
        joints: Mapping[str, Any] = tree.data["joints"]  # type: ignore[assignment]
        data["joints"] = {**joints, **make_joint_arrays(chain.joints)}
        if refined:
            corrected = " and ".join(skeleton.joints[k] for k in refined)
            addition = f"; the motion of this trial corrects the axes of the {corrected}"
    message = f"joint centres, joint axes and anatomical frames come from {name}{addition}."
    out.say("calibrated", message, level="ok")
    out.reasons += [reason for reason in tree.reasons if reason.level != "ok"]
    report_unused_pointers(out, context.trial, (), "the chain and its landmarks are from the calibration")
    return Tree(CHAIN, data, {**tree.facts, "calibration": name}, tuple(out.reasons))


_CARRYING = float(np.radians(-10))
"""Assumed carrying angle of the elbow, rad; a skeleton does not contain it."""
_WRIST = (0.08, 0.045)
"""Distances of the wrist's centre from the axis between elbow and ulnar styloid, forward and to the side.

They are shares of the forearm's length, for a wrist that is about a tenth of this length from the axis in 60° of
pronation."""
_FRAME_SD = np.radians([2.7, 4.0, 4.0, 2.2, 8.0, 2.2, 2.7, 9.0, 4.0])
"""Standard deviations of constant errors of thorax, upper arm and forearm about x, y, z, rad, with a usual camera."""
_USUAL_NOISE = 0.012
"""Noise of a bone's length with a usual camera, m; constant errors are scaled in proportion to this noise."""
_SCALES = (0.8, 2.5)
"""Smallest and largest factor by which the constant errors are scaled."""
_CENTRE_SD = 0.02  # m, standard deviation of the shoulder's centre from the skeleton's shoulder, along each axis
_BIASES = Reason(
    "skeleton-biases",
    "the angles come from the skeleton of a camera, whose joints are centimetres from the anatomical joints. Expected "
    "rms errors: plane of elevation 4–14°, elevation 2–6°, axial rotation 6–22°, flexion 3–10°. In recordings of a "
    "real camera, the elevation was 6–20° too high on average; its interval contains this error. The carrying angle is "
    "assumed (-10°), and pronation is unknown. Compare changes rather than values.",
)


def fit_skeleton_chain(context: Context) -> Outputs:
    """Return chain.h5 for the skeleton of a camera: trunk, bones, joints, and the facts about their errors."""
    view = Trajectories(context.long("planar.parquet"))
    roles = find_roles(view.labels, view.planar.facts["side"])
    points = view.read_positions(np.arange(len(view.labels)))
    tracks = {role: points[:, number] for role, number in roles.items()}
    trunk = fit_trunk({role: tracks[role] for role in TRUNK if role in roles})
    inside = {role: _express_in_trunk(trunk, tracks[role]) for role in ARM if role in roles}
    shoulder = trunk.local[trunk.roles.index("near_shoulder")]
    upper = fit_bone(inside["elbow"], shoulder, np.sqrt(2) * LASTING_SD, rate=view.rate)
    lower = fit_bone(inside["wrist"] - inside["elbow"], np.zeros(3), np.sqrt(2) * LASTING_SD, rate=view.rate)
    bones = [upper, lower]
    if "hand" in inside:
        bones.append(fit_bone(inside["hand"] - inside["wrist"], np.zeros(3), LASTING_SD, rate=view.rate))
    # the standard deviations of the lengths include the constant error along the bone
    length_sds = [float(np.hypot(np.sqrt(bone.covariance[3, 3]), LASTING_SD / 2)) for bone in bones]

    # residuals (F, K) of the coordinates on the rigid trunk, and of the lengths of the arm, m
    off = [_express_in_trunk(trunk, tracks[role]) - at for role, at in zip(trunk.roles, trunk.local, strict=True)]
    for arm, bone in ((inside["elbow"], upper), (inside["wrist"] - inside["elbow"], lower)):
        off.append((np.linalg.norm(arm - bone.centre, axis=1) - bone.length)[:, None])
    white, memory = fit_sensor_noise(np.hstack(off), view.rate)

    # joints: shoulder and elbow, and the wrist if the skeleton has a hand
    axes_covariance = np.full((2, 3, 3), np.nan)
    axes_covariance[0] = np.diag([np.sin(_FRAME_SD[4]) ** 2, np.sin(_FRAME_SD[3]) ** 2, 0.0])
    end = np.array([_WRIST[0], -1.0, _WRIST[1]])
    wrist = np.asarray(lower.length * end / np.linalg.norm(end))  # centre of the wrist in the axes of the forearm
    joints = [
        SpatialJoint("ball", 0, upper.centre, upper.covariance[:3, :3] + _CENTRE_SD**2 * np.eye(3)),
        SpatialJoint(
            "hinge",
            1,
            np.array([0.0, -upper.length, 0.0]),
            np.diag([1.0, 0.0, 1.0]) * LASTING_SD**2 + np.diag([0.0, length_sds[0] ** 2, 0.0]),
            axes_covariance=axes_covariance,
            offset=so3.exp(np.array([_CARRYING, 0.0, 0.0])),
        ),
    ]
    if len(bones) > 2:
        across = np.array([1.0, 0.0, 0.0])
        joints.append(SpatialJoint("two-axis", 2, wrist, np.eye(3) * LASTING_SD**2, second_axis=across))

    arcs = []  # range of each bone's angle to its mean direction, rad
    limbs = ARM[: len(bones)]
    for before, limb in zip(("", *limbs[:-1]), limbs, strict=True):
        arm = inside[limb] - inside[before] if before else inside[limb]
        arm = arm[np.isfinite(arm).all(axis=1)]
        unit = arm / np.linalg.norm(arm, axis=1, keepdims=True)
        _, _, v = np.linalg.svd(unit - unit.mean(axis=0), full_matrices=False)
        arcs.append(float(np.ptp(np.percentile(np.arcsin(np.clip(unit @ v[0], -1, 1)), [2.5, 97.5]))))
    noise = np.array([bone.noise for bone in bones])
    noise[1:] = np.sqrt(np.maximum(noise[1:] ** 2 - noise[:-1] ** 2, 0.5 * noise[1:] ** 2))
    ends = [np.array([0.0, -upper.length, 0.0]), wrist, *(np.array([0.0, -bone.length, 0.0]) for bone in bones[2:])]
    used, inner = [*trunk.roles, *limbs], len(bones) - 1
    data = {
        "joints": {
            "name": np.array(("shoulder", "elbow", "wrist")[: len(joints)], dtype=object),
            "parent": np.arange(len(joints), dtype=np.int64),
            "arc": np.array(arcs),
            **make_joint_arrays(tuple(joints)),
        },
        "segments": {
            "name": np.array(("thorax", "upper_arm", "forearm", "hand")[: len(joints) + 1], dtype=object),
            "length": np.array([bone.length for bone in bones[:inner]]),
            "length_sd": np.array(length_sds[:inner]),
        },
        "markers": {
            "name": np.array([view.labels[roles[role]] for role in used], dtype=object),
            "segment": np.array([0] * len(trunk.roles) + list(range(1, len(limbs) + 1)), dtype=np.int64),
            "local": np.vstack([trunk.local, ends]),
            "residual": np.concatenate([trunk.residual, noise]),
            "on_glide": np.zeros(len(used), dtype=np.bool_),
            "skin": np.zeros(len(used)),
            "skin_sd": np.zeros(len(used)),
        },
        "landmarks": make_landmark_arrays({}, {}, {}),
    }
    scale = float(np.clip(np.mean([bone.noise for bone in bones[:2]]) / _USUAL_NOISE, *_SCALES))
    frames = np.diag((scale * _FRAME_SD) ** 2)
    facts = {
        "estimator": context.settings.estimator,
        "iterations": 0,
        "reprojection_rms_m": float(np.sqrt(np.mean([bone.noise**2 for bone in bones]))),
        "evidence": {},
        "likely": {},
        "frames": "skeleton",
        "still_s": None,
        "frame_covariance": {"shoulder": frames[:6, :6].tolist(), "elbow": frames[3:, 3:].tolist()},
        "wrist_offset_m": lower.centre.tolist(),
        "noise": {"white": white, "memory_s": memory, "length_m": [bone.noise for bone in bones]},
        "lasting_scale": scale,
    }
    out = Findings([_BIASES])
    report_implausible_arm(out, check_lengths({"upper_arm": upper.length, "forearm": lower.length}))
    report_unused_pointers(out, context.trial, (), "a skeleton has no markers on its segments")
    return (Tree(CHAIN, data, facts, tuple(out.reasons)),)


def _express_in_trunk(trunk: Trunk, track: FloatArray) -> FloatArray:
    """Return the positions ``track`` (F, 3), m, in the axes of the trunk."""
    return np.asarray(np.einsum("fji,fj->fi", trunk.rotations, track - trunk.origins))
