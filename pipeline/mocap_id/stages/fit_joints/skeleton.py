"""Function of fit-joints for the skeleton of a camera, which fits an arm of constant lengths on a rigid trunk."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.anatomy.names import ARM, TRUNK, find_roles
from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialJoint
from mocap_id.kinematics.space.skeleton import (
    LASTING_SD,
    Bone,
    SensorNoise,
    Trunk,
    fit_bone,
    fit_sensor_noise,
    fit_trunk,
)
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.fit_joints.anatomy import check_lengths, explain_implausible_arm
from mocap_id.stages.fit_joints.space import make_joint_arrays
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

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
    """Return chain.h5 for the skeleton of a camera."""
    view = Trajectories(context.long("planar.parquet"))
    side = view.planar.facts["side"]
    roles = find_roles(view.labels, side)
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
    noise = fit_sensor_noise(_compute_residuals(trunk, bones, inside, tracks), view.rate)
    facts = {"estimator": context.settings.estimator, **_make_facts(bones, noise)}
    doubts = explain_implausible_arm(check_lengths({"upper_arm": upper.length, "forearm": lower.length}))
    return (Tree(CHAIN, _make_data(view, roles, trunk, bones, inside), facts, (_BIASES, *doubts)),)


def _express_in_trunk(trunk: Trunk, track: FloatArray) -> FloatArray:
    """Return the positions ``track`` (F, 3), m, in the axes of the trunk."""
    return np.asarray(np.einsum("fji,fj->fi", trunk.rotations, track - trunk.origins))


def _make_joints(bones: list[Bone]) -> tuple[SpatialJoint, ...]:
    """Return the joints shoulder and elbow, and the wrist if the skeleton has a hand."""
    upper, lower = bones[:2]
    axes_covariance = np.full((2, 3, 3), np.nan)
    axes_covariance[0] = np.diag([np.sin(_FRAME_SD[4]) ** 2, np.sin(_FRAME_SD[3]) ** 2, 0.0])
    joints = [
        SpatialJoint("ball", 0, upper.centre, upper.covariance[:3, :3] + _CENTRE_SD**2 * np.eye(3)),
        SpatialJoint(
            "hinge",
            1,
            np.array([0.0, -upper.length, 0.0]),
            np.diag([1.0, 0.0, 1.0]) * LASTING_SD**2 + np.diag([0.0, _length_sd(upper) ** 2, 0.0]),
            axes_covariance=axes_covariance,
            offset=so3.exp(np.array([_CARRYING, 0.0, 0.0])),
        ),
    ]
    if len(bones) > 2:
        joints.append(
            SpatialJoint(
                "two-axis",
                2,
                _locate_wrist(lower.length),
                np.eye(3) * LASTING_SD**2,
                second_axis=np.array([1.0, 0.0, 0.0]),
            )
        )
    return tuple(joints)


def _locate_wrist(length: float) -> FloatArray:
    """Return the centre of the wrist (3,) in the axes of a forearm of this length, m."""
    position = np.array([_WRIST[0], -1.0, _WRIST[1]])
    return np.asarray(length * position / np.linalg.norm(position))


def _length_sd(bone: Bone) -> float:
    """Return the standard deviation of the length of a bone, m, including the constant error along the bone."""
    return float(np.hypot(np.sqrt(bone.covariance[3, 3]), LASTING_SD / 2))


def _make_data(
    view: Trajectories, roles: dict[str, int], trunk: Trunk, bones: list[Bone], inside: dict[str, FloatArray]
) -> dict[str, Any]:
    """Return the datasets of chain.h5."""
    joints = _make_joints(bones)
    limbs = ARM[: len(bones)]
    pairs = zip(("", *limbs[:-1]), limbs, strict=True)
    ends = [np.array([0.0, -bones[0].length, 0.0]), _locate_wrist(bones[1].length)]
    ends += [np.array([0.0, -bone.length, 0.0]) for bone in bones[2:]]
    used = [*trunk.roles, *limbs]
    noise = np.array([bone.noise for bone in bones])
    noise[1:] = np.sqrt(np.maximum(noise[1:] ** 2 - noise[:-1] ** 2, 0.5 * noise[1:] ** 2))
    lengths = bones[:2] if len(bones) > 2 else bones[:1]
    count = len(used)
    return {
        "joints": {
            "name": np.array(("shoulder", "elbow", "wrist")[: len(joints)], dtype=object),
            "parent": np.arange(len(joints), dtype=np.int64),
            "arc": np.array([_measure_arc(inside[limb], inside.get(before)) for before, limb in pairs]),
            **make_joint_arrays(joints),
        },
        "segments": {
            "name": np.array(("thorax", "upper_arm", "forearm", "hand")[: len(joints) + 1], dtype=object),
            "length": np.array([bone.length for bone in lengths]),
            "length_sd": np.array([_length_sd(bone) for bone in lengths]),
        },
        "markers": {
            "name": np.array([view.labels[roles[role]] for role in used], dtype=object),
            "segment": np.array([0] * len(trunk.roles) + list(range(1, len(limbs) + 1)), dtype=np.int64),
            "local": np.vstack([trunk.local, ends]),
            "residual": np.concatenate([trunk.residual, noise]),
            "on_glide": np.zeros(count, dtype=np.bool_),
            "skin": np.zeros(count),
            "skin_sd": np.zeros(count),
        },
        "landmarks": {
            "name": np.array([], dtype=object),
            "segment": np.zeros(0, dtype=np.int64),
            "local": np.zeros((0, 3)),
            "sd": np.zeros(0),
        },
    }


def _measure_arc(tip: FloatArray, start: FloatArray | None) -> float:
    """Return the range of a bone's angle to its mean direction, rad; for ``start`` None, the bone is ``tip``."""
    bone = tip if start is None else tip - start
    bone = bone[np.isfinite(bone).all(axis=1)]
    unit = bone / np.linalg.norm(bone, axis=1, keepdims=True)
    _, _, v = np.linalg.svd(unit - unit.mean(axis=0), full_matrices=False)
    return float(np.ptp(np.percentile(np.arcsin(np.clip(unit @ v[0], -1, 1)), [2.5, 97.5])))


def _make_facts(bones: list[Bone], noise: SensorNoise) -> dict[str, Any]:
    """Return the facts of chain.h5."""
    scale = float(np.clip(np.mean([bone.noise for bone in bones[:2]]) / _USUAL_NOISE, *_SCALES))
    frames = np.diag((scale * _FRAME_SD) ** 2)
    return {
        "iterations": 0,
        "reprojection_rms_m": float(np.sqrt(np.mean([bone.noise**2 for bone in bones]))),
        "evidence": {},
        "likely": {},
        "frames": "skeleton",
        "still_s": None,
        "frame_covariance": {"shoulder": frames[:6, :6].tolist(), "elbow": frames[3:, 3:].tolist()},
        "wrist_offset_m": bones[1].centre.tolist(),
        "noise": {"white": noise.white, "memory_s": noise.memory, "length_m": [bone.noise for bone in bones]},
        "lasting_scale": scale,
    }


def _compute_residuals(
    trunk: Trunk, bones: list[Bone], inside: dict[str, FloatArray], tracks: dict[str, FloatArray]
) -> FloatArray:
    """Return the residuals (F, K), m, of the K coordinates on the rigid trunk and lengths of the arm."""
    parts = [
        _express_in_trunk(trunk, tracks[role]) - local for role, local in zip(trunk.roles, trunk.local, strict=True)
    ]
    parts.append((np.linalg.norm(inside["elbow"] - bones[0].centre, axis=1) - bones[0].length)[:, None])
    lower = inside["wrist"] - inside["elbow"] - bones[1].centre
    parts.append((np.linalg.norm(lower, axis=1) - bones[1].length)[:, None])
    return np.hstack(parts)
