"""Function of the stage ukf-smooth for a trial in space: poses of segments, angles of joints, marker residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id.anatomy.angles import (
    SHOULDER,
    JointAngles,
    elbow_angles,
    hinge_elbow_angles,
    joint_coordinates,
    shoulder_angles,
    wrist_angles,
)
from mocap_id.anatomy.coordinates import RelativeMotion, compose_motions
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.space import SpatialSettings, SpatialStates, smooth_in_space
from mocap_id.geometry import so3
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.skin_motion import add_axial_rotation_errors, correct_axial_rotation, correct_cluster_slides
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.stages.ukf_smooth.arm_checks import arm_doubts
from mocap_id.stages.ukf_smooth.gap_reasons import gap_reasons
from mocap_id.stages.ukf_smooth.noise_reasons import bridge_repeated, find_repeated_frames, repeated_reason
from mocap_id.stages.ukf_smooth.skeleton import shown_by_skeleton, smooth_skeleton_states
from mocap_id.stages.ukf_smooth.uniform_times import check_uniform
from mocap_id.store import LongTable, Table, Tree
from mocap_id.store.schemas import ANGLES, ENCODER, MARKERS, POSES, SKIN, STATES
from mocap_id.store.spatial_views import SpatialSkeleton, is_skeleton
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_COMMON_WITH_IMUS = 0.1
"""Share of the twist that the skin under all markers and the sensor of a segment may miss together."""
_ANATOMICAL = {
    "shoulder": ("thorax", "upper_arm", shoulder_angles),
    "elbow": ("upper_arm", "forearm", elbow_angles),
    "wrist": ("forearm", "hand", wrist_angles),
}
"""Angles of the ISB, with the two segments of each."""


def smooth_rotations(context: Context) -> Outputs:
    """Return states.parquet, markers.parquet, poses.parquet, angles.parquet and what else the plane has, empty."""
    settings: UkfSmoothSettings = context.settings
    tree, bad = context.tree("chain.h5"), context.table("segments.parquet").facts.get("bad_stretches", ())
    view = Trajectories(context.long("planar.parquet"), bad)
    check_uniform(view, context.trial.trial)
    skeleton = SpatialSkeleton.from_tree(tree)
    columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    points = view.read_positions(columns)
    repeated = find_repeated_frames(points)
    points[repeated] = np.nan
    points = correct_cluster_slides(correct_axial_rotation(points, skeleton.chain), skeleton.chain, view.rate)
    given = SpatialSettings(
        settings.marker_sd, settings.sigma_v, settings.marker_sd_floor, settings.gate, settings.angle_sd_limit
    )
    by_skeleton = is_skeleton(view.planar.facts)
    imus: dict[str, dict[str, Any]] = {}
    sensed: tuple[Reason, ...] = ()
    if by_skeleton:
        states = smooth_skeleton_states(tree, view, points, skeleton.chain, settings.gate)
    elif context.trial.imus:
        from mocap_id.stages.ukf_smooth.inertial import smooth_with_imus  # noqa: PLC0415  only for trials with sensors

        mirrored = view.planar.facts.get("side") == "left"
        files = context.trial.imus
        states, imus, sensed = smooth_with_imus(points, view.time, skeleton, files, given, mirrored=mirrored)
        missed = {skeleton.segments.index(s): abs(each["skin_share"]) for s, each in imus.items() if each["used"]}
        states = add_axial_rotation_errors(states, skeleton.chain, common=_COMMON_WITH_IMUS, missed=missed)
    else:
        states = add_axial_rotation_errors(smooth_in_space(points, view.rate, skeleton.chain, given), skeleton.chain)
    observed = bridge_repeated(states.observed, repeated, view.rate)
    angles = _angles(states, skeleton, tree.facts)
    angles = [shown_by_skeleton(each) for each in angles] if by_skeleton else angles
    segments = [name.replace("_", " ") for name in skeleton.segments]
    missing = np.isnan(states.omega[:, :, 0])
    reasons = gap_reasons(missing, view.time, segments, "pose", settings) + repeated_reason(repeated) + sensed
    reasons += arm_doubts(angles, _thorax_axis(states, skeleton, tree.facts["frames"]))
    facts = _facts(states, points, settings) | ({"imus": imus} if imus else {})
    return (
        Table(STATES, _state_columns(states, skeleton, view.time, observed), facts, reasons),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, _markers(states, points)),
        _no_skin(),
        Table(ENCODER, {column.name: np.zeros(0) for column in ENCODER.columns}, {"why": "a trial in space has none"}),
        Table(POSES, _pose_columns(states, skeleton, view.time, observed)),
        Table(ANGLES, _angle_columns(angles, view.time)),
    )


def _angles(states: SpatialStates, skeleton: SpatialSkeleton, facts: Mapping[str, Any]) -> list[JointAngles]:
    """Return the angles of the ISB between anatomical frames, and the own coordinates of all other joints."""
    found: list[JointAngles] = []
    done: set[int] = set()
    frames = facts.get("frame_covariance", {})
    for name, (parent, child, angles) in _ANATOMICAL.items():
        if name not in frames:
            continue
        path = _path(skeleton, skeleton.segments.index(parent), skeleton.segments.index(child))
        motion = _relative(states, path[0])
        for k in path[1:]:
            motion = compose_motions(motion, _relative(states, k))
        shown = hinge_elbow_angles if name == "elbow" and facts["frames"] == "skeleton" else angles
        found.append(shown(motion, np.array(frames[name])))
        done |= set(path) if len(path) == 1 else set()
    for k, joint in enumerate(skeleton.chain.joints):
        if k not in done:
            names = tuple(f"joint_{k + 1}_{d}" for d in range(1, joint.dimension + 1))
            found.append(joint_coordinates(_relative(states, k), joint, names))
    return found


def _thorax_axis(states: SpatialStates, skeleton: SpatialSkeleton, frames: str) -> FloatArray:
    """Return the long axis (F, 3) of the thorax in the trial, y up; no rows if its frame is not anatomical."""
    if frames == "own" or "thorax" not in skeleton.segments:
        return np.zeros((0, 3))
    return np.asarray(states.rotations[:, skeleton.segments.index("thorax"), :, 1])


def _path(skeleton: SpatialSkeleton, parent: int, child: int) -> list[int]:
    """Return the joints from one segment to a later one, from 0."""
    path: list[int] = []
    while child != parent:
        path.insert(0, child - 1)
        child = skeleton.chain.joints[child - 1].parent
    return path


def _relative(states: SpatialStates, k: int) -> RelativeMotion:
    return RelativeMotion(
        states.joint_rotations[:, k], states.velocity[:, k], states.acceleration[:, k], states.joint_covariance[:, k]
    )


def _angle_columns(found: Sequence[JointAngles], time: FloatArray) -> dict[str, FloatArray]:
    columns: dict[str, FloatArray] = {"time": time}
    for angles in found:
        for k, name in enumerate(angles.names):
            columns |= {
                name: angles.angle[:, k],
                f"d{name}": angles.rate[:, k],
                f"dd{name}": angles.acceleration[:, k],
                f"sd_{name}": angles.sd.angle[:, k],
                f"sd_d{name}": angles.sd.rate[:, k],
                f"sd_dd{name}": angles.sd.acceleration[:, k],
                f"constant_sd_{name}": np.where(np.isfinite(angles.angle[:, k]), angles.constant_sd[k], np.nan),
            }
        if angles.names == SHOULDER:
            columns["isb_condition"] = angles.condition
    return columns


def _pose_columns(
    states: SpatialStates, skeleton: SpatialSkeleton, time: FloatArray, observed: BoolArray
) -> dict[str, FloatArray | BoolArray]:
    """Return the poses; the origin of the thorax is IJ, those of other segments are the centres of their joints."""
    columns: dict[str, FloatArray | BoolArray] = {"time": time}
    for k, name in enumerate(skeleton.segments):
        origin = states.origins[:, k]
        if name == "thorax" and "IJ" in skeleton.landmarks:
            origin = origin + states.rotations[:, k] @ skeleton.landmark_local[skeleton.landmarks.index("IJ")]
        quaternion = _continuous(so3.quaternion(states.rotations[:, k]))
        columns |= {f"{name}_q{axis}": quaternion[:, i].copy() for i, axis in enumerate("wxyz")}
        for i, axis in enumerate("xyz"):
            columns |= {
                f"{name}_{axis}": origin[:, i].copy(),
                f"{name}_omega_{axis}": states.omega[:, k, i].copy(),
                f"{name}_alpha_{axis}": states.alpha[:, k, i].copy(),
            }
        columns |= {
            f"sd_{name}_rotation": states.sd_rotation[:, k].copy(),
            f"sd_{name}_omega": states.sd_omega[:, k].copy(),
            f"sd_{name}_alpha": states.sd_alpha[:, k].copy(),
            f"{name}_observed": observed[:, k].copy(),
        }
    return columns


def _continuous(quaternion: FloatArray) -> FloatArray:
    """Return quaternions (F, 4) with signs that change nowhere between known samples; the first scalar is positive."""
    known = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
    found = quaternion.copy()
    if len(known):
        same = np.sum(quaternion[known[1:]] * quaternion[known[:-1]], axis=1) >= 0
        first = 1.0 if quaternion[known[0], 0] >= 0 else -1.0
        found[known] *= (first * np.cumprod(np.concatenate([[1.0], np.where(same, 1.0, -1.0)])))[:, None]
    return found


def _state_columns(
    states: SpatialStates, skeleton: SpatialSkeleton, time: FloatArray, observed: BoolArray
) -> dict[str, FloatArray | BoolArray]:
    """Return the states of the hinges, by the number of their joint."""
    columns: dict[str, FloatArray | BoolArray] = {"time": time}
    for k, joint in enumerate(skeleton.chain.joints):
        if joint.kind != "hinge":
            continue
        for d, name in enumerate(("theta", "dtheta", "ddtheta")):
            columns[f"{name}_{k + 1}"] = states.coordinates[:, k, d, 0].copy()
            columns[f"sd_{name}_{k + 1}"] = states.sd_coordinates[:, k, d, 0].copy()
        columns[f"dddtheta_{k + 1}"] = states.jerk[:, k] @ (joint.offset.T @ joint.first_axis)
        columns[f"observed_{k + 1}"] = observed[:, k + 1].copy()
    return columns


def _markers(states: SpatialStates, points: FloatArray) -> dict[str, FloatArray | BoolArray]:
    off = np.linalg.norm(points - states.predicted, axis=2)
    place = {axis: np.ascontiguousarray(states.predicted[..., i]) for i, axis in enumerate("xyz")}
    return {**place, "residual": off, "used": states.used}


def _facts(states: SpatialStates, points: FloatArray, settings: UkfSmoothSettings) -> dict[str, Any]:
    """Return facts for the report, as in the plane."""
    off = np.sum((points - states.predicted) ** 2, axis=2)
    there, used = np.isfinite(off), np.isfinite(off) & states.used
    return {
        "marker_sd_m": float(states.noise.camera_sd),
        "marker_sds_m": states.noise.marker_sd.tolist(),
        "sigma_v": states.noise.snap.tolist(),
        "reprojection_rms_m": float(np.sqrt(off[used].mean())) if used.any() else None,
        "outlier_fraction": float(1 - used.sum() / there.sum()) if there.any() else None,
        "bridged_fraction": np.mean(~states.observed[:, 1:], axis=0).tolist(),
        "method": settings.method,
        "engine": settings.engine,
    }


def _no_skin() -> Tree:
    """Return skin.h5 without markers: the skin's errors are in the standard deviations of the states."""
    shapes = {
        "joints/centre": (0, 2),
        "markers/local": (0, 2),
        "response/slides": (0, 2, 2, 0),
        "response/noise": (0, 0),
    }
    data: dict[str, dict[str, Any]] = {}
    for node in SKIN.nodes:
        group, name = node.name.split("/")
        kind = {"float64": np.float64, "int64": np.int64, "str": object}[node.dtype]
        data.setdefault(group, {})[name] = np.zeros(shapes.get(node.name, (0,)), dtype=kind)
    return Tree(SKIN, data, {"camera_sd_m": None, "basis": "not estimated for trials in space"})
