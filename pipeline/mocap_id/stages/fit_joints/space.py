"""Function of the stage fit-joints in space, which fits kinds, centres and axes of the joints, and landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.anatomy.names import find_landmarks
from mocap_id.errors import ConfigError
from mocap_id.geometry.spatial_chain import JointKind, SpatialJoint
from mocap_id.kinematics.space.chain_fit import fit_spatial_chain, has_known_axes, refine_axes
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.calibration_trial import read_chain
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.fit_joints.anatomy import (
    find_points_near_joints,
    fit_anatomical_frames,
    report_unused_pointers,
)
from mocap_id.stages.fit_joints.plane import report_estimator, report_uncertain_centre
from mocap_id.stages.skin_motion import correct_axial_rotation, fit_cluster_poses
from mocap_id.stages.trial_keys import Calibration, get_landmark_labels
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.store.views import SpatialSkeleton, Trajectories, is_skeleton

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
        from mocap_id.stages.fit_joints.skeleton import fit_skeleton_chain  # noqa: PLC0415  only skeletons need it

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
    acromion = find_landmarks(view.labels, get_landmark_labels(trial), trial.side).markers.get("AC")
    fit = fit_spatial_chain(
        view.read_positions(columns),
        segment,
        segments.facts["parents"],
        kinds,
        estimator=settings.estimator,
        near=find_points_near_joints(context, view, names),
        firm=[k for k, name in enumerate(names) if name == _GIRDLE],
        girdle=np.flatnonzero(columns == (-1 if acromion is None else acromion)).tolist(),
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
    skeleton = SpatialSkeleton.from_tree(Tree(CHAIN, data, tree.facts))
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
