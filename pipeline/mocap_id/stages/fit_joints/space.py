"""Function of the stage fit-joints for a trial in space: kinds, centres and axes of the joints, and landmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id.anatomy.landmark_names import find_landmarks
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.geometry.spatial_chain import JointKind, SpatialJoint
from mocap_id.kinematics.space.axis_refinement import has_known_axes, refine_axes
from mocap_id.kinematics.space.chain_fit import fit_spatial_chain
from mocap_id.kinematics.space.chain_result import SpatialFit
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration import read_chain
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.fit_joints.anatomy import AnatomicalChain, in_anatomical_frames, points_near_joints
from mocap_id.stages.skin_motion import correct_axial_rotation, fit_cluster_poses
from mocap_id.stages.trial_keys import get_landmark_labels
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.store.spatial_views import SpatialSkeleton, is_skeleton
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason


def fit_chain_in_space(context: Context) -> Outputs:
    """Return chain.h5 of a trial in space."""
    if context.trial.calibration is not None:
        return (_calibrated(context),)
    settings: FitJointsSettings = context.settings
    segments = context.table("segments.parquet")
    if is_skeleton(context.long("planar.parquet").facts):
        from mocap_id.stages.fit_joints.skeleton import fit_skeleton_chain  # noqa: PLC0415  only skeletons need it

        return fit_skeleton_chain(context)
    view = Trajectories(context.long("planar.parquet"), segments.facts.get("bad_stretches", ()))
    assigned = np.flatnonzero(segments["segment"] >= 0)
    labels, segment = [str(label) for label in segments["marker"][assigned]], segments["segment"][assigned]
    columns = np.array([view.labels.index(label) for label in labels], dtype=np.int64)
    points = view.read_positions(columns)
    names, joint_names = segments.facts["names"], segments.facts["joint_names"]
    kinds = _known_kinds(joint_names) | _given_kinds(settings.kinds, joint_names)
    assert settings.estimator != "rigid-body"
    assert settings.estimator != "circle"
    near = points_near_joints(context, view, names)
    firm = [k for k, name in enumerate(names) if name == _GIRDLE]
    acromion = find_landmarks(view.labels, get_landmark_labels(context.trial), context.trial.side).markers.get("AC")
    fit = fit_spatial_chain(
        points,
        segment,
        segments.facts["parents"],
        kinds,
        estimator=settings.estimator,
        near=near,
        firm=firm,
        girdle=np.flatnonzero(columns == (-1 if acromion is None else acromion)).tolist(),
    )
    framed = in_anatomical_frames(context, view, fit, columns, names)
    facts = {
        "estimator": settings.estimator,
        "iterations": framed.fit.iterations,
        "reprojection_rms_m": float(np.sqrt(np.mean(framed.fit.residual[segment > 0] ** 2))),
        "evidence": {name: dict(each.ratio) for name, each in zip(joint_names, fit.evidence, strict=True)},
        "likely": {name: each.likely for name, each in zip(joint_names, fit.evidence, strict=True)},
        **framed.facts,
    }
    reasons = _for_comparison(settings) + _weak_joints(fit, joint_names, settings) + framed.reasons
    reasons += _parallel(fit, joint_names, kinds)
    return (Tree(CHAIN, _data(framed, labels, names, joint_names), facts, reasons),)


_ANATOMICAL: Mapping[str, JointKind] = {"clavicle": "ball", "shoulder": "ball", "elbow": "two-axis", "wrist": "ball"}
"""Kinds of joints that landmarks name; the motion alone may be too simple to show them."""


_GIRDLE = "girdle"
"""The thorax is not a limb: its markers slide over the shoulder blade."""


def _known_kinds(joint_names: Sequence[str]) -> dict[int, JointKind]:
    return {k: _ANATOMICAL[name] for k, name in enumerate(joint_names, start=1) if name in _ANATOMICAL}


def _given_kinds(given: Mapping[str, JointKind], joint_names: Sequence[str]) -> dict[int, JointKind]:
    unknown = [name for name in given if name not in joint_names]
    if unknown:
        raise ConfigError(
            f"fit-joints: kinds: there is no joint {', '.join(unknown)}; expected one of {', '.join(joint_names)}"
        )
    return {joint_names.index(name) + 1: kind for name, kind in given.items()}


def _data(framed: AnatomicalChain, labels: list[str], names: list[str], joint_names: list[str]) -> dict[str, Any]:
    """Return the nodes of chain.h5."""
    chain, fit = framed.chain, framed.fit
    inner = len(chain.joints) - 1
    return {
        "joints": {
            "name": np.array(joint_names, dtype=object),
            "parent": np.array(chain.parents, dtype=np.int64),
            "arc": fit.arcs,
            **joint_arrays(chain.joints),
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
        "landmarks": framed.landmarks,
    }


def joint_arrays(joints: tuple[SpatialJoint, ...]) -> dict[str, Any]:
    """Return the joints as arrays, one row a joint."""

    def stacked(*names: str) -> FloatArray:
        rows = [[getattr(joint, name) for name in names] for joint in joints]
        return np.array([row if len(names) > 1 else row[0] for row in rows], dtype=np.float64)

    return {
        "kind": np.array([joint.kind for joint in joints], dtype=object),
        "axes": stacked("first_axis", "second_axis"),
        "slide_sd": np.array([joint.slide_sd for joint in joints], dtype=np.float64),
        "known": np.array([joint.known for joint in joints], dtype=np.bool_),
        **{
            name: stacked(name)
            for name in (
                *("centre", "covariance", "axes_covariance", "offset"),
                *("glide", "glide_covariance", "rest", "long_axis", "untwisted"),
            )
        },
    }


_REFINED_BY = 600
"""Largest number of frames that correct the axes of a calibration."""


def _calibrated(context: Context) -> Tree:
    """Return the calibration's chain, with the markers that this trial has and axes that its motion corrects."""
    assert context.trial.calibration is not None
    tree = read_chain(context.trial.calibration)
    segments = context.table("segments.parquet")
    there = {str(label) for label, k in zip(segments["marker"], segments["segment"], strict=True) if k >= 0}
    keep = np.array([name in there for name in tree.texts("markers/name")], dtype=np.bool_)
    markers: Mapping[str, Any] = tree.data["markers"]  # type: ignore[assignment]
    data = {**tree.data, "markers": {name: np.asarray(values)[keep] for name, values in markers.items()}}
    name = context.trial.calibration.trial.name
    data["joints"], refined = _refined_joints(context, Tree(CHAIN, data, tree.facts))
    better = f"; this trial corrects the axes of the {' and '.join(refined)}" if refined else ""
    message = f"centres, axes and landmark frames of the joints are those of {name}{better}."
    note = Reason("calibrated", message, level="ok")
    kept = tuple(reason for reason in tree.reasons if reason.level != "ok")
    return Tree(CHAIN, data, {**tree.facts, "calibration": name}, (note, *kept))


def _refined_joints(context: Context, tree: Tree) -> tuple[Mapping[str, Any], list[str]]:
    """Return the group ``joints`` of chain.h5 with corrected axes, and the names of the joints that have them."""
    skeleton, planar = SpatialSkeleton.from_tree(tree), context.long("planar.parquet")
    joints: Mapping[str, Any] = tree.data["joints"]  # type: ignore[assignment]
    if is_skeleton(planar.facts) or tree.facts["frames"] == "skeleton":
        return joints, []
    if not any(has_known_axes(joint) for joint in skeleton.chain.joints):
        return joints, []
    view = Trajectories(planar, context.table("segments.parquet").facts.get("bad_stretches", ()))
    columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    points = view.read_positions(columns)[:: 1 + len(view.time) // _REFINED_BY]
    rotations, _ = fit_cluster_poses(correct_axial_rotation(points, skeleton.chain), skeleton.chain)
    chain, refined = refine_axes(skeleton.chain, rotations)
    return {**joints, **joint_arrays(chain.joints)}, [skeleton.joints[k] for k in refined]


def _for_comparison(settings: FitJointsSettings) -> tuple[Reason, ...]:
    """Return a caution if the estimator is not the default."""
    if settings.estimator == "bundle":
        return ()
    return (
        Reason(
            "estimator",
            f"the joints are fitted by `{settings.estimator}`, which is only for comparison; its joints and lengths "
            "have no standard deviations. Remove `fit-joints: {estimator: …}` to fit the whole chain.",
        ),
    )


def _parallel(fit: SpatialFit, names: Sequence[str], kinds: Mapping[int, JointKind]) -> tuple[Reason, ...]:
    """Return a note for every joint that should have two axes and is fitted as a ball."""
    return tuple(
        Reason(
            "axes-parallel",
            f"the two axes of the {name} are nearly parallel in this motion, so it is fitted as a ball.",
            level="ok",
        )
        for k, (name, joint) in enumerate(zip(names, fit.chain.joints, strict=True), start=1)
        if kinds.get(k) == "two-axis" and joint.kind == "ball"
    )


_WIDE = 60.0
"""Rotation of a joint beyond which more of it would not show the centre either, degrees."""
_MORE_MOTION = "Name a trial of the same person with a larger motion as `calibration:`."
_RIGID_MARKERS = (
    "It turns far enough, but about one axis only, or the markers of its segments move too much against each other: "
    "each segment needs three markers that are rigid with each other, also thorax and shoulder blade apart."
)


def _weak_joints(fit: SpatialFit, names: Sequence[str], settings: FitJointsSettings) -> tuple[Reason, ...]:
    """Return a caution for every joint whose centre the motion does not show, or shows poorly."""
    reasons = []
    for name, arc, joint in zip(names, np.degrees(fit.arcs), fit.chain.joints, strict=True):
        if not joint.known:
            reasons.append(
                Reason(
                    "centre-unknown",
                    f"the motion does not show the centre of the {name}, which turns by {arc:.0f}°: no lengths and "
                    f"angles depend on it. {_MORE_MOTION if arc < _WIDE else _RIGID_MARKERS}",
                    float(arc),
                )
            )
        elif joint.kind != "hinge" and (sd := _largest_sd(joint)) > settings.large_sd_m:
            reasons.append(
                Reason(
                    "joint-uncertain",
                    f"the centre of the {name} has a standard deviation of {1e3 * sd:.0f} mm.",
                    sd,
                    settings.large_sd_m,
                )
            )
    return tuple(reasons)


def _largest_sd(joint: SpatialJoint) -> float:
    if not np.isfinite(joint.covariance).all():
        return 0.0
    return float(np.sqrt(np.linalg.eigvalsh(joint.covariance)[-1]))
