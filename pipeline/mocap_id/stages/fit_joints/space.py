"""Function of the stage fit-joints in space, which fits kinds, centres and axes of the joints, and landmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.anatomy.names import find_landmarks
from mocap_id.errors import ConfigError
from mocap_id.geometry.spatial_chain import JointKind, SpatialJoint
from mocap_id.kinematics.space.chain_fit import fit_spatial_chain, has_known_axes, refine_axes
from mocap_id.kinematics.space.chain_result import SpatialFit
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration_trial import read_chain
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.fit_joints.anatomy import (
    AnatomicalChain,
    explain_unused_pointers,
    find_points_near_joints,
    fit_anatomical_frames,
)
from mocap_id.stages.fit_joints.plane import explain_estimator, explain_uncertain_centre
from mocap_id.stages.skin_motion import correct_axial_rotation, fit_cluster_poses
from mocap_id.stages.trial_keys import get_landmark_labels
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.store.views import SpatialSkeleton, Trajectories, is_skeleton
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
    if context.trial.calibration is not None:
        tree = _use_calibration(context)
        unused = explain_unused_pointers(context.trial, (), "the chain and its landmarks are from the calibration")
        return (replace(tree, reasons=(*tree.reasons, *unused)),)
    settings: FitJointsSettings = context.settings
    segments = context.table("segments.parquet")
    if is_skeleton(context.long("planar.parquet").facts):
        from mocap_id.stages.fit_joints.skeleton import fit_skeleton_chain  # noqa: PLC0415  only skeletons need it

        (skeleton,) = fit_skeleton_chain(context)
        assert isinstance(skeleton, Tree)
        unused = explain_unused_pointers(context.trial, (), "a skeleton has no markers on its segments")
        return (replace(skeleton, reasons=(*skeleton.reasons, *unused)),)
    view = Trajectories(context.long("planar.parquet"), segments.facts.get("bad_stretches", ()))
    assigned = np.flatnonzero(segments["segment"] >= 0)
    labels, segment = [str(label) for label in segments["marker"][assigned]], segments["segment"][assigned]
    columns = np.array([view.labels.index(label) for label in labels], dtype=np.int64)
    points = view.read_positions(columns)
    names, joint_names = segments.facts["names"], segments.facts["joint_names"]
    kinds = _choose_kinds(settings.kinds, joint_names)
    assert settings.estimator != "rigid-body"
    assert settings.estimator != "circle"
    acromion = find_landmarks(view.labels, get_landmark_labels(context.trial), context.trial.side).markers.get("AC")
    fit = fit_spatial_chain(
        points,
        segment,
        segments.facts["parents"],
        kinds,
        estimator=settings.estimator,
        near=find_points_near_joints(context, view, names),
        firm=[k for k, name in enumerate(names) if name == _GIRDLE],
        girdle=np.flatnonzero(columns == (-1 if acromion is None else acromion)).tolist(),
    )
    anatomical = fit_anatomical_frames(context, view, fit, columns, names)
    facts = {
        "estimator": settings.estimator,
        "iterations": anatomical.fit.bundle.iterations,
        "reprojection_rms_m": float(np.sqrt(np.mean(anatomical.fit.residual[segment > 0] ** 2))),
        "evidence": {name: dict(each.ratio) for name, each in zip(joint_names, fit.evidence, strict=True)},
        "likely": {name: each.likely for name, each in zip(joint_names, fit.evidence, strict=True)},
        **anatomical.facts,
    }
    reasons = explain_estimator(settings) + _explain_weak_joints(fit, joint_names, settings) + anatomical.reasons
    reasons += _explain_parallel_axes(fit, joint_names, kinds) + explain_unused_pointers(context.trial, names)
    return (Tree(CHAIN, _make_data(anatomical, labels, names, joint_names), facts, reasons),)


def _choose_kinds(given: Mapping[str, JointKind], joint_names: Sequence[str]) -> dict[int, JointKind]:
    """Return the kinds that the user gives, or else those of anatomical joints, by number of the joint."""
    unknown = [name for name in given if name not in joint_names]
    if unknown:
        raise ConfigError(
            f"fit-joints: kinds: there is no joint {', '.join(unknown)}; expected one of {', '.join(joint_names)}"
        )
    kinds = {**_ANATOMICAL_KINDS, **given}
    return {k: kinds[name] for k, name in enumerate(joint_names, start=1) if name in kinds}


def _make_data(
    anatomical: AnatomicalChain, labels: list[str], names: list[str], joint_names: list[str]
) -> dict[str, Any]:
    """Return the datasets of chain.h5."""
    chain, fit = anatomical.chain, anatomical.fit
    inner = len(chain.joints) - 1
    return {
        "joints": {
            "name": np.array(joint_names, dtype=object),
            "parent": np.array(chain.parents, dtype=np.int64),
            "arc": np.array([each.arc for each in fit.evidence]),
            **make_joint_arrays(chain.joints),
        },
        "segments": {
            "name": np.array(names, dtype=object),
            "length": fit.lengths[:inner],
            "length_sd": fit.length_sd[:inner],
        },
        "markers": {
            "name": np.array(labels, dtype=object),
            "segment": chain.segment,
            "local": chain.local,
            "residual": fit.residual,
            "on_glide": chain.on_glide,
            "skin": chain.skin,
            "skin_sd": chain.skin_sd,
        },
        "landmarks": anatomical.landmarks,
    }


def make_joint_arrays(joints: tuple[SpatialJoint, ...]) -> dict[str, Any]:
    """Return the datasets of the group ``joints`` of chain.h5 except names, parents and arcs; one row per joint."""
    arrays = {name: np.array([getattr(joint, name) for joint in joints], dtype=np.float64) for name in _JOINT_ARRAYS}
    return {
        "kind": np.array([joint.kind for joint in joints], dtype=object),
        "axes": np.array([[joint.first_axis, joint.second_axis] for joint in joints], dtype=np.float64),
        "known": np.array([joint.known for joint in joints], dtype=np.bool_),
        **arrays,
    }


def _use_calibration(context: Context) -> Tree:
    """Return the chain of the calibration with only the markers of this trial, and axes corrected by its motion."""
    assert context.trial.calibration is not None
    tree = read_chain(context.trial.calibration)
    segments = context.table("segments.parquet")
    assigned = {str(label) for label, k in zip(segments["marker"], segments["segment"], strict=True) if k >= 0}
    keep = np.array([name in assigned for name in tree.texts("markers/name")], dtype=np.bool_)
    markers: Mapping[str, Any] = tree.data["markers"]  # type: ignore[assignment]
    data = {**tree.data, "markers": {name: np.asarray(values)[keep] for name, values in markers.items()}}
    name = context.trial.calibration.trial.name
    data["joints"], corrected = _correct_axes(context, Tree(CHAIN, data, tree.facts))
    addition = f"; the motion of this trial corrects the axes of the {' and '.join(corrected)}" if corrected else ""
    message = f"joint centres, joint axes and anatomical frames come from {name}{addition}."
    note = Reason("calibrated", message, level="ok")
    cautions = tuple(reason for reason in tree.reasons if reason.level != "ok")
    return Tree(CHAIN, data, {**tree.facts, "calibration": name}, (note, *cautions))


def _correct_axes(context: Context, tree: Tree) -> tuple[Mapping[str, Any], list[str]]:
    """Return the group ``joints`` of chain.h5 with axes corrected by this trial, and the names of corrected joints."""
    skeleton, planar = SpatialSkeleton.from_tree(tree), context.long("planar.parquet")
    joints: Mapping[str, Any] = tree.data["joints"]  # type: ignore[assignment]
    if is_skeleton(planar.facts) or tree.facts["frames"] == "skeleton":
        return joints, []
    if not any(has_known_axes(joint) for joint in skeleton.chain.joints):
        return joints, []
    view = Trajectories(planar, context.table("segments.parquet").facts.get("bad_stretches", ()))
    columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    points = view.read_positions(columns)[:: 1 + len(view.time) // _CORRECTED_BY]
    rotations, _ = fit_cluster_poses(correct_axial_rotation(points, skeleton.chain), skeleton.chain)
    chain, refined = refine_axes(skeleton.chain, rotations)
    return {**joints, **make_joint_arrays(chain.joints)}, [skeleton.joints[k] for k in refined]


def _explain_parallel_axes(fit: SpatialFit, names: Sequence[str], kinds: Mapping[int, JointKind]) -> tuple[Reason, ...]:
    """Return a note for every joint that should have two axes but is fitted as a ball joint."""
    return tuple(
        Reason(
            "axes-parallel",
            f"the two axes of the {name} are nearly parallel in this motion, so it is fitted as a ball joint.",
            level="ok",
        )
        for k, (name, joint) in enumerate(zip(names, fit.chain.joints, strict=True), start=1)
        if kinds.get(k) == "two-axis" and joint.kind == "ball"
    )


def _explain_weak_joints(fit: SpatialFit, names: Sequence[str], settings: FitJointsSettings) -> tuple[Reason, ...]:
    """Return a caution for every joint whose centre the motion determines poorly or not at all."""
    reasons = []
    for name, each, joint in zip(names, fit.evidence, fit.chain.joints, strict=True):
        arc = np.degrees(each.arc)
        if not joint.known:
            reasons.append(
                Reason(
                    "centre-unknown",
                    f"the motion does not determine the centre of the {name}, which rotates by {arc:.0f}°; no length "
                    f"or angle depends on it. {_MORE_MOTION if arc < _WIDE else _RIGID_MARKERS}",
                    float(arc),
                )
            )
        elif joint.kind != "hinge" and (sd := _largest_sd(joint)) > settings.large_sd_m:
            reasons.append(explain_uncertain_centre(name, sd, settings.large_sd_m))
    return tuple(reasons)


def _largest_sd(joint: SpatialJoint) -> float:
    if not np.isfinite(joint.covariance).all():
        return 0.0
    return float(np.sqrt(np.linalg.eigvalsh(joint.covariance)[-1]))
