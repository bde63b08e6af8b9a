"""Function of fit-joints for the skeleton of a camera, which fits an arm of constant lengths on a rigid trunk."""

from __future__ import annotations

import numpy as np

from mocap_id.anatomy.names import ARM, TRUNK, find_roles
from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialJoint
from mocap_id.kinematics.space.skeleton import LASTING_SD, Trunk, fit_bone, fit_sensor_noise, fit_trunk
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.fit_joints.anatomy import check_lengths, report_implausible_arm, report_unused_pointers
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
    sensor = fit_sensor_noise(np.hstack(off), view.rate)

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
        "landmarks": {
            "name": np.array([], dtype=object),
            "segment": np.zeros(0, dtype=np.int64),
            "local": np.zeros((0, 3)),
            "sd": np.zeros(0),
        },
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
        "noise": {"white": sensor.white, "memory_s": sensor.memory, "length_m": [bone.noise for bone in bones]},
        "lasting_scale": scale,
    }
    out = Findings([_BIASES])
    report_implausible_arm(out, check_lengths({"upper_arm": upper.length, "forearm": lower.length}))
    report_unused_pointers(out, context.trial, (), "a skeleton has no markers on its segments")
    return (Tree(CHAIN, data, facts, tuple(out.reasons)),)


def _express_in_trunk(trunk: Trunk, track: FloatArray) -> FloatArray:
    """Return the positions ``track`` (F, 3), m, in the axes of the trunk."""
    return np.asarray(np.einsum("fji,fj->fi", trunk.rotations, track - trunk.origins))
