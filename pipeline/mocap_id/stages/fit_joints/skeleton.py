"""Function of the stage fit-joints for a skeleton: an arm of constant lengths on a rigid trunk."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.anatomy.skeleton_joints import ARM, TRUNK, find_roles
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
from mocap_id.stages.fit_joints.landmark_checks import implausible, implausible_lengths
from mocap_id.stages.fit_joints.space import joint_arrays
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_CARRYING = float(np.radians(-10))
"""Carrying angle of the elbow, rad, which no skeleton shows."""
_WRIST = (0.08, 0.045)
"""Place of the wrist's centre forward of and beside the axis from the elbow to the ulnar styloid, as shares of the
length of the forearm: a tenth, turned forward by 60° of pronation."""
_FRAME_SD = np.radians([2.7, 4.0, 4.0, 2.2, 8.0, 2.2, 2.7, 9.0, 4.0])
"""Constant errors of the axes of thorax, upper arm and forearm, each about x, y, z, rad, for a usual sensor."""
_USUAL_NOISE = 0.012
"""Noise of a bone's length with a usual sensor, m.

Lasting errors of others are taken as larger or smaller in proportion.
"""
_SCALES = (0.8, 2.5)
_CENTRE_SD = 0.02  # m, of the shoulder's true centre about that of the skeleton


def fit_skeleton_chain(context: Context) -> Outputs:
    """Return chain.h5 of a skeleton."""
    view = Trajectories(context.long("planar.parquet"))
    side = view.planar.facts["side"]
    roles = find_roles(view.labels, side)
    points = view.read_positions(np.arange(len(view.labels)))
    tracks = {role: points[:, number] for role, number in roles.items()}
    trunk = fit_trunk({role: tracks[role] for role in TRUNK if role in roles})
    inside = {role: _inside(trunk, tracks[role]) for role in ARM if role in roles}
    shoulder = trunk.local[trunk.roles.index("near_shoulder")]
    upper = fit_bone(inside["elbow"], shoulder, np.sqrt(2) * LASTING_SD, rate=view.rate)
    lower = fit_bone(inside["wrist"] - inside["elbow"], np.zeros(3), np.sqrt(2) * LASTING_SD, rate=view.rate)
    bones = [upper, lower]
    if "hand" in inside:
        bones.append(fit_bone(inside["hand"] - inside["wrist"], np.zeros(3), LASTING_SD, rate=view.rate))
    memory = fit_sensor_noise(_residuals(trunk, bones, inside, tracks), view.rate)
    facts = {"estimator": context.settings.estimator, **_facts(bones, memory)}
    doubts = implausible(implausible_lengths({"upper_arm": upper.length, "forearm": lower.length}))
    return (Tree(CHAIN, _data(view, roles, trunk, bones, inside), facts, (_biases(), *doubts)),)


def _inside(trunk: Trunk, track: FloatArray) -> FloatArray:
    """Return a track (F, 3) in the axes of the trunk, m."""
    return np.asarray(np.einsum("fji,fj->fi", trunk.rotations, track - trunk.origins))


def _joints(bones: list[Bone]) -> tuple[SpatialJoint, ...]:
    upper, lower = bones[:2]
    spread = np.full((2, 3, 3), np.nan)
    spread[0] = np.diag([np.sin(_FRAME_SD[4]) ** 2, np.sin(_FRAME_SD[3]) ** 2, 0.0])
    joints = [
        SpatialJoint("ball", 0, upper.centre, upper.covariance[:3, :3] + _CENTRE_SD**2 * np.eye(3)),
        SpatialJoint(
            "hinge",
            1,
            np.array([0.0, -upper.length, 0.0]),
            np.diag([1.0, 0.0, 1.0]) * LASTING_SD**2 + np.diag([0.0, _length_sd(upper) ** 2, 0.0]),
            axes_covariance=spread,
            offset=so3.exp(np.array([_CARRYING, 0.0, 0.0])),
        ),
    ]
    if len(bones) > 2:
        joints.append(
            SpatialJoint(
                "two-axis",
                2,
                _wrist(lower.length),
                np.eye(3) * LASTING_SD**2,
                second_axis=np.array([1.0, 0.0, 0.0]),
            )
        )
    return tuple(joints)


def _wrist(length: float) -> FloatArray:
    """Return the centre of the wrist in the forearm, m."""
    place = np.array([_WRIST[0], -1.0, _WRIST[1]])
    return np.asarray(length * place / np.linalg.norm(place))


def _length_sd(bone: Bone) -> float:
    """Return the standard deviation of a length, m; an error along the bone is not seen."""
    return float(np.hypot(np.sqrt(bone.covariance[3, 3]), LASTING_SD / 2))


def _data(
    view: Trajectories, roles: dict[str, int], trunk: Trunk, bones: list[Bone], inside: dict[str, FloatArray]
) -> dict[str, Any]:
    """Return the nodes of chain.h5."""
    joints = _joints(bones)
    limbs = ARM[: len(bones)]
    ends = [np.array([0.0, -bones[0].length, 0.0]), _wrist(bones[1].length)]
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
            "arc": np.array([_arc(inside[limb], inside.get(before)) for before, limb in _pairs(limbs)]),
            **joint_arrays(joints),
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


def _pairs(limbs: tuple[str, ...]) -> list[tuple[str, str]]:
    return list(zip(("", *limbs[:-1]), limbs, strict=True))


def _arc(tip: FloatArray, start: FloatArray | None) -> float:
    """Return the range of the angle of a bone about its mean direction, rad."""
    bone = tip if start is None else tip - start
    bone = bone[np.isfinite(bone).all(axis=1)]
    unit = bone / np.linalg.norm(bone, axis=1, keepdims=True)
    _, _, v = np.linalg.svd(unit - unit.mean(axis=0), full_matrices=False)
    return float(np.ptp(np.percentile(np.arcsin(np.clip(unit @ v[0], -1, 1)), [2.5, 97.5])))


def _facts(bones: list[Bone], memory: SensorNoise) -> dict[str, Any]:
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
        "noise": {"white": memory.white, "memory_s": memory.memory, "length_m": [bone.noise for bone in bones]},
        "lasting_scale": scale,
    }


def _residuals(
    trunk: Trunk, bones: list[Bone], inside: dict[str, FloatArray], tracks: dict[str, FloatArray]
) -> FloatArray:
    """Return residuals (F, K) about the rigid trunk and the constant lengths, m."""
    parts = [_inside(trunk, tracks[role]) - local for role, local in zip(trunk.roles, trunk.local, strict=True)]
    parts.append((np.linalg.norm(inside["elbow"] - bones[0].centre, axis=1) - bones[0].length)[:, None])
    lower = inside["wrist"] - inside["elbow"] - bones[1].centre
    parts.append((np.linalg.norm(lower, axis=1) - bones[1].length)[:, None])
    return np.hstack(parts)


def _biases() -> Reason:
    return Reason(
        "skeleton-biases",
        "the angles come from a skeleton, whose joints lie centimetres from the anatomical ones: expect errors (rms) "
        "of 4–14° of the plane of elevation, 2–6° of the elevation, 6–22° of the axial rotation and 3–10° of the "
        "flexion; recorded arms of a real camera were 6–20° too high on average, which the interval of the elevation "
        "holds. The carrying angle is assumed (-10°), and pronation is not shown. Compare changes rather than values.",
    )
