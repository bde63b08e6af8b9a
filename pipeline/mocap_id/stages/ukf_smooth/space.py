"""Function of the stage ukf-smooth in space, from markers or from a skeleton."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from mocap_id.anatomy.angles import (
    ELBOW,
    SHOULDER,
    WRIST,
    JointAngles,
    RelativeMotion,
    compose_motions,
    elbow_angles,
    joint_coordinates,
    shoulder_angles,
)
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.smoothing import find_rejected_segments
from mocap_id.estimation.space import SpatialSettings, SpatialStates, smooth_in_space
from mocap_id.estimation.space.skeleton_smoothing import bridge_short_gaps, remove_jumps, smooth_skeleton
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.kinematics.space.bodies import rigid_poses
from mocap_id.kinematics.space.skeleton import sensor_noise_power
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.skin_motion import add_axial_rotation_errors, correct_axial_rotation, correct_cluster_slides
from mocap_id.stages.trial_keys import list_sensors
from mocap_id.stages.ukf_smooth import UkfSmoothSettings, checks
from mocap_id.stages.ukf_smooth.plane import empty_encoder_table
from mocap_id.store import LongTable, Table, Tree
from mocap_id.store.artefacts import SpatialSkeleton, Trajectories, is_skeleton
from mocap_id.store.provenance import ANGLES, MARKERS, POSES, SKIN, STATES

_COMMON_WITH_IMUS = 0.1
"""Fraction of the axial rotation by which the skin under all markers and the sensor of a segment may lag together."""
_ANATOMICAL: Mapping[str, tuple[str, str, Callable[..., JointAngles]]] = {
    "shoulder": ("thorax", "upper_arm", shoulder_angles),
    "elbow": ("upper_arm", "forearm", elbow_angles),
    "wrist": ("forearm", "hand", partial(elbow_angles, names=WRIST)),
}
"""Joints with angles of the ISB: the two segments of each, and the function of the angles."""


def smooth_trial_in_space(context: Context) -> Outputs:
    """Return the artefacts of the stage for a trial in space; skin.h5 and encoder.parquet are empty."""
    settings: UkfSmoothSettings = context.settings
    tree, bad = context.tree("chain.h5"), context.table("segments.parquet").facts.get("bad_stretches", ())
    view = Trajectories(context.long("planar.parquet"), bad)
    checks.check_uniform_times(view, context.trial.trial)
    skeleton = SpatialSkeleton(tree)
    columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    points = view.read_positions(columns)
    repeated = checks.find_repeated_frames(points)
    points[repeated] = np.nan
    points = correct_cluster_slides(correct_axial_rotation(points, skeleton.chain), skeleton.chain, view.rate)
    given = SpatialSettings(
        settings.marker_sd, settings.sigma_v, settings.marker_sd_floor, settings.gate, settings.angle_sd_limit
    )
    from_skeleton = is_skeleton(view.planar.facts)
    sensors = Findings()
    if from_skeleton:
        states = _smooth_skeleton_states(tree, view, points, skeleton.chain, settings.gate)
    elif context.trial.imus:
        from mocap_id.estimation.space.skeleton_smoothing import fuse_in_space  # noqa: PLC0415  only with sensors
        from mocap_id.stages.ukf_smooth.inertial import describe_sensors, read_sensors  # noqa: PLC0415

        names, worn = list(skeleton.segments), list_sensors(context.trial.imus)
        signals = read_sensors(names, worn, mirrored=view.planar.facts.get("side") == "left")
        states, results = fuse_in_space(points, view.time, skeleton.chain, signals, given)
        sensors = describe_sensors(names, worn, signals, results)
        missed = {names.index(s): abs(each["skin_share"]) for s, each in sensors.facts.items() if each["used"]}
        states = add_axial_rotation_errors(states, skeleton.chain, common=_COMMON_WITH_IMUS, missed=missed)
    else:
        states = add_axial_rotation_errors(smooth_in_space(points, view.rate, skeleton.chain, given), skeleton.chain)
    visible: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    rejected = find_rejected_segments(skeleton.chain.segment, len(skeleton.segments), visible, states.used)
    observed = states.observed if from_skeleton else states.observed & ~rejected
    observed = checks.bridge_repeated(observed, repeated, view.rate)
    angles = _compute_angles(states, skeleton, tree.facts)
    if from_skeleton:
        angles = [_limit_to_skeleton(each) for each in angles]
    stretches = [] if from_skeleton else checks.list_rejected(rejected, view.time, skeleton.segments)
    lost = {"rejected": stretches} if stretches else {}
    off = np.linalg.norm(points - states.predicted, axis=2)
    square = np.sum((points - states.predicted) ** 2, axis=2)
    there, used = np.isfinite(square), np.isfinite(square) & states.used
    out = Findings()
    out.fact(  # the same as in the plane
        marker_sd_m=float(states.noise.camera_sd),
        marker_sds_m=states.noise.marker_sd.tolist(),
        sigma_v=states.noise.snap.tolist(),
        reprojection_rms_m=float(np.sqrt(square[used].mean())) if used.any() else None,
        outlier_fraction=float(1 - used.sum() / there.sum()) if there.any() else None,
        bridged_fraction=np.mean(~observed[:, 1:], axis=0).tolist(),
        method=settings.method,
        engine=settings.engine,
    )
    if sensors.facts:
        out.fact(imus=sensors.facts)
    out.fact(**lost)
    segments = [name.replace("_", " ") for name in skeleton.segments]
    checks.report_gaps(out, np.isnan(states.omega[:, :, 0]), view.time, segments, quantity="pose", settings=settings)
    checks.report_repeated_frames(out, repeated)
    out.reasons += sensors.reasons
    checks.report_rejected(out, stretches, view.time)
    thorax = np.zeros((0, 3))  # no rows if the frame of the thorax is not anatomical
    if tree.facts["frames"] != "own" and "thorax" in skeleton.segments:
        thorax = states.rotations[:, skeleton.segments.index("thorax"), :, 1]
    checks.check_arm_motion(out, angles, thorax)

    # the states of the hinges, numbered by joint
    hinges: dict[str, FloatArray | BoolArray] = {"time": view.time}
    for k, joint in enumerate(skeleton.chain.joints):
        if joint.kind == "hinge":
            for d, name in enumerate(("theta", "dtheta", "ddtheta")):
                hinges[f"{name}_{k + 1}"] = states.coordinates[:, k, d, 0].copy()
                hinges[f"sd_{name}_{k + 1}"] = states.sd_coordinates[:, k, d, 0].copy()
            hinges[f"dddtheta_{k + 1}"] = states.jerk[:, k] @ (joint.offset.T @ joint.first_axis)
            hinges[f"observed_{k + 1}"] = observed[:, k + 1].copy()

    # the poses: the origin of the thorax is IJ (if it has this landmark), that of any other segment its joint's centre
    poses: dict[str, FloatArray | BoolArray] = {"time": view.time}
    for k, name in enumerate(skeleton.segments):
        origin = states.origins[:, k]
        if name == "thorax" and "IJ" in skeleton.landmarks:
            origin = origin + states.rotations[:, k] @ skeleton.landmark_local[skeleton.landmarks.index("IJ")]
        quaternion = so3.quaternion(states.rotations[:, k])
        known = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
        if len(known):  # the sign does not jump between known samples; the first scalar part is positive
            same = np.sum(quaternion[known[1:]] * quaternion[known[:-1]], axis=1) >= 0
            first = 1.0 if quaternion[known[0], 0] >= 0 else -1.0
            quaternion[known] *= (first * np.cumprod(np.concatenate([[1.0], np.where(same, 1.0, -1.0)])))[:, None]
        poses |= {f"{name}_q{axis}": quaternion[:, i].copy() for i, axis in enumerate("wxyz")}
        for i, axis in enumerate("xyz"):
            poses |= {
                f"{name}_{axis}": origin[:, i].copy(),
                f"{name}_omega_{axis}": states.omega[:, k, i].copy(),
                f"{name}_alpha_{axis}": states.alpha[:, k, i].copy(),
            }
        poses |= {
            f"sd_{name}_rotation": states.sd_rotation[:, k].copy(),
            f"sd_{name}_omega": states.sd_omega[:, k].copy(),
            f"sd_{name}_alpha": states.sd_alpha[:, k].copy(),
            f"{name}_observed": observed[:, k].copy(),
        }

    of_joints: dict[str, FloatArray] = {"time": view.time}
    for each in angles:
        for k, name in enumerate(each.names):
            of_joints |= {
                name: each.angle[:, k],
                f"d{name}": each.rate[:, k],
                f"dd{name}": each.acceleration[:, k],
                f"sd_{name}": each.sd[:, k],
                f"sd_d{name}": each.sd_rate[:, k],
                f"sd_dd{name}": each.sd_acceleration[:, k],
                f"constant_sd_{name}": np.where(np.isfinite(each.angle[:, k]), each.constant_sd[k], np.nan),
            }
        if each.names == SHOULDER:
            of_joints["isb_condition"] = each.condition

    markers = {axis: np.ascontiguousarray(states.predicted[..., i]) for i, axis in enumerate("xyz")}
    # skin.h5 has no markers: the standard deviations of the states include the errors from skin
    shapes = {
        "joints/centre": (0, 2),
        "markers/local": (0, 2),
        "response/slides": (0, 2, 2, 0),
        "response/noise": (0, 0),
    }
    skin: dict[str, dict[str, Any]] = {}
    for node in SKIN.nodes:
        group, name = node.name.split("/")
        kind = {"float64": np.float64, "int64": np.int64, "str": object}[node.dtype]
        skin.setdefault(group, {})[name] = np.zeros(shapes.get(node.name, (0,)), dtype=kind)
    return (
        Table(STATES, hinges, out.facts, tuple(out.reasons)),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, {**markers, "residual": off, "used": states.used}),
        Tree(SKIN, skin, {"camera_sd_m": None, "basis": "not estimated for trials in space"}),
        empty_encoder_table("a trial in space has no encoder"),
        Table(POSES, poses, lost),
        Table(ANGLES, of_joints),
    )


def _compute_angles(states: SpatialStates, skeleton: SpatialSkeleton, facts: Mapping[str, Any]) -> list[JointAngles]:
    """Return the angles of the ISB for joints with known anatomical frames, and the coordinates of all other joints."""
    found: list[JointAngles] = []
    done: set[int] = set()
    frames = facts.get("frame_covariance", {})
    for name, (parent, child, angles) in _ANATOMICAL.items():
        if name not in frames:
            continue
        first, k = skeleton.segments.index(parent), skeleton.segments.index(child)
        path: list[int] = []  # the joints from the first segment to the later one, in order
        while k != first:
            path.insert(0, k - 1)
            k = skeleton.chain.joints[k - 1].parent
        motion = _relative_motion(states, path[0])
        for k in path[1:]:
            motion = compose_motions(motion, _relative_motion(states, k))
        hinge = name == "elbow" and facts["frames"] == "skeleton"
        compute = partial(elbow_angles, names=ELBOW[:2]) if hinge else angles
        found.append(compute(motion, np.array(frames[name])))
        done |= set(path) if len(path) == 1 else set()
    for k, joint in enumerate(skeleton.chain.joints):
        if k not in done:
            names = tuple(f"joint_{k + 1}_{d}" for d in range(1, joint.dimension + 1))
            found.append(joint_coordinates(_relative_motion(states, k), joint, names))
    return found


def _relative_motion(states: SpatialStates, k: int) -> RelativeMotion:
    return RelativeMotion(
        states.joint_rotations[:, k], states.velocity[:, k], states.acceleration[:, k], states.joint_covariance[:, k]
    )


_BRIDGED = 0.3  # s, longest gap that is filled to estimate the noise of the movement
_GUESSED_SD = 0.03  # m, standard deviation of a joint whose position the sensor guessed
_LASTING_SD = 0.009  # m, standard deviation of the part of a joint's lasting error that changes with the posture
_WRONG_LENGTH = 3.0  # standard deviations: with this error of a bone's length, a sample has a quarter of its weight
_ELEVATION_BIAS = float(np.radians(13.0))
"""Root mean square of the mean elevation errors of five recorded arms, rad (Kinect v2; Keraal, UI-PRMD)."""
_LARGEST_SD = 0.6  # rad; a more uncertain axial rotation is left out, because a straight elbow does not determine it


def _smooth_skeleton_states(
    tree: Tree, view: Trajectories, points: FloatArray, chain: SpatialChain, gate: float
) -> SpatialStates:
    """Return the smoothed states of the chain from the joints ``points`` (F, M, 3) of a skeleton recording, m."""
    residual = tree.numbers("markers/residual")
    sd, trunk, facts = np.maximum(residual, 1e-3), chain.segment == 0, tree.facts["noise"]
    points = remove_jumps(points, gate * sd)
    missing = np.isnan(points[..., 0])
    points = bridge_short_gaps(points, round(_BRIDGED * view.rate))
    rotations, origins, _ = rigid_poses(points[:, trunk], chain.local[trunk], 1 / sd[trunk] ** 2)
    shift = np.einsum("fij,j->fi", rotations, np.array(tree.facts["wrist_offset_m"]))
    points[:, np.flatnonzero(chain.segment >= 2)] -= shift[:, None]
    # weights of the samples: guessed joints and bones of a wrong length count less
    weight = np.ones(points.shape[:2])
    inferred = view.planar.facts["skeleton"]["inferred"]
    for m, name in enumerate(tree.texts("markers/name")):
        for first, last in inferred.get(name, ()):
            weight[(view.time >= first) & (view.time <= last), m] = min((residual[m] / _GUESSED_SD) ** 2, 1.0)
    start = origins + np.einsum("fij,j->fi", rotations, chain.joints[0].centre)
    for length, segment in zip(facts["length_m"], range(1, 4), strict=False):
        m = int(np.flatnonzero(chain.segment == segment)[0])
        bone = float(np.linalg.norm(chain.local[m]))
        off = (np.linalg.norm(points[:, m] - start, axis=1) - bone) / (_WRONG_LENGTH * length)
        weight[:, m] /= np.where(np.isfinite(off), 1 + off**2, 1.0) ** 2
        start = points[:, m]
    weight[missing] = 0.0
    return smooth_skeleton(
        points,
        view.rate,
        chain,
        (rotations, origins),
        sd=sd,
        weight=weight,
        colour=lambda frequency: sensor_noise_power(facts["white"], facts["memory_s"], frequency, 1 / view.rate),
        lasting=tree.facts["lasting_scale"] * np.where(trunk, 0.5 * _LASTING_SD, _LASTING_SD),
        gate=gate,
    )


def _limit_to_skeleton(angles: JointAngles) -> JointAngles:
    """Return the angles of a joint of a skeleton; only those of the shoulder change.

    The axial rotation of the shoulder becomes NaN where it is too uncertain, because the elbow is nearly straight. The
    constant error of the elevation is increased by its value in other recordings, because a skeleton recording contains
    only a part of it.
    """
    if angles.names != SHOULDER:
        return angles
    hidden = np.zeros(angles.angle.shape, dtype=np.bool_)
    hidden[:, 2] = ~(angles.sd[:, 2] < _LARGEST_SD)

    def hide(values: FloatArray) -> FloatArray:
        return np.where(hidden, np.nan, values)

    return replace(
        angles,
        angle=hide(angles.angle),
        rate=hide(angles.rate),
        acceleration=hide(angles.acceleration),
        sd=hide(angles.sd),
        sd_rate=hide(angles.sd_rate),
        sd_acceleration=hide(angles.sd_acceleration),
        constant_sd=np.hypot(angles.constant_sd, [0.0, _ELEVATION_BIAS, 0.0]),
    )
