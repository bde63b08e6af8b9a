"""Measured pose of every body from its own markers alone, without the joints of the chain: poses.parquet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray, as_complex, as_xy
from mocap_id.dynamics.measured_motion import BodyPoses, Stretch, fill_gaps, measure_stretch
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.kinematics.cluster_poses import ClusterPose, measure_cluster
from mocap_id.kinematics.heel_lift import find_moving_markers
from mocap_id.kinematics.joint_corrections import AnklePosition, HipShift, estimate_hip_shift, locate_ankle
from mocap_id.store import Table
from mocap_id.store.schemas import POSES
from mocap_id.store.views import Skeleton, Trajectories

OTHERS = "others"  # name of the body with all markers that are on no segment, for example on arms and head
_BENT = "hip"  # joint below a trunk that may bend
_BESIDE = 0.02  # m, largest distance in the plane between a left and a right marker at the same height
_ONE_BODY = ("pelvis", "trunk")  # each has few markers, so the pose of both as one body is an alternative


def measure_poses(
    view: Trajectories,
    chain: MarkerChain,
    skeleton: Skeleton,
    *,
    observed: FloatArray,
    angles: FloatArray,
    camera: float,
) -> tuple[Table, HipShift, Stretch | None]:
    """Return poses.parquet, the effect of a trunk that bends, and the stretch of the segment below the hip.

    The table contains the measured poses of all bodies of the dynamics. The stretch is None without the poses of the
    bodies around this segment.

    A body whose markers do not determine a pose has no columns. The facts list the bodies in the order of the columns.
    Pelvis and trunk are included separately and as one body, the torso. ``chain`` includes the markers of the base.
    ``observed`` (F, K, 2) are the markers of the moving segments, m; NaN where they are not used for the states. The
    mean of ``angles`` (F, n), rad, is the posture in which pelvis and trunk are one body. ``camera`` is the standard
    deviation of a coordinate due to camera noise, m.
    """
    columns = {label: column for column, label in enumerate(view.labels)}
    labels = skeleton.markers
    of_chain = np.array([columns[label] for label in labels], dtype=np.int64)
    free = np.setdiff1d(np.arange(len(view.labels)), of_chain)
    moves = np.flatnonzero(chain.segment > 0)
    local = as_complex(chain.local)
    found: list[tuple[str, list[int], list[str], ClusterPose]] = []
    seen: list[ComplexArray] = []
    feet_move = False
    for name, numbers in _list_bodies(skeleton.segments):
        own = np.flatnonzero(np.isin(chain.segment, numbers))
        if numbers == [0]:
            base = view.read_positions(of_chain[own], axes="xy")
            on_feet = find_moving_markers(base, view.rate)
            feet_move = bool(on_feet.any())
            used = on_feet if feet_move else np.ones_like(on_feet)
            own, points = own[used], as_complex(base[:, used])
        else:
            points = as_complex(observed[:, np.searchsorted(moves, own)])
        pose = measure_cluster(points, _express_in_body(chain, local, numbers, angles)[own])
        if pose is not None:
            found.append((name, numbers, [labels[k] for k in own[pose.markers]], pose))
            seen.append(points[:, pose.markers])
    others = measure_cluster(as_complex(view.read_positions(free, axes="xy"))) if len(free) > 1 else None
    if others is not None:
        found.append((OTHERS, [], [view.labels[k] for k in free[others.markers]], others))
    facts = [_fact(*each) for each in found]
    bodies = [(each[1], each[3]) for each in found]
    above, shift = _estimate_hip_shift(skeleton, bodies, seen)
    ankle = _estimate_ankle(chain, bodies) if feet_move else None
    for fact in facts:
        if above in fact["segments"]:
            fact["joint_shift_m"] = [shift.place.real, shift.place.imag]
        if ankle is not None and fact["segments"] == [1]:
            fact["joint_m"] = [[place.real, place.imag] for place in (ankle.foot, ankle.shank)]
            fact["joint_sd_m"] = ankle.sd
    table = Table(POSES, _columns(view, [pose for *_, pose in found]), {"bodies": facts})
    return table, shift, _measure_thigh(view, chain, bodies, above - 1, camera)


def _measure_thigh(
    view: Trajectories,
    chain: MarkerChain,
    bodies: Sequence[tuple[list[int], ClusterPose]],
    hip: int,
    camera: float,
) -> Stretch | None:
    """Return the stretch of the segment below the joint ``hip`` (from 0); None without the poses around it."""
    single = {numbers[0]: pose for numbers, pose in bodies if len(numbers) == 1}
    if hip < 1 or not {hip - 1, hip, hip + 1} <= single.keys():
        return None
    three = [single[number] for number in (hip - 1, hip, hip + 1)]
    spread = [float(np.sum(np.abs(pose.local - pose.local.mean()) ** 2)) for pose in three]
    poses = BodyPoses(
        time=view.time,
        position=np.stack([as_xy(pose.position) for pose in three], axis=1),
        angle=np.stack([pose.angle for pose in three], axis=1),
        centroid=np.array([as_xy(pose.local).mean(axis=0) for pose in three]),
        information=np.ones((3, 2)),
        body=np.arange(3),
        centres=chain.centres[[hip - 1, hip]],
        camera=camera**2 * np.array([[1 / len(each.local), 1 / s] for each, s in zip(three, spread, strict=True)]),
    )
    return measure_stretch(fill_gaps(poses)[0], 1)


def _estimate_hip_shift(
    skeleton: Skeleton, bodies: Sequence[tuple[list[int], ClusterPose]], seen: Sequence[ComplexArray]
) -> tuple[int, HipShift]:
    """Return the segment above the hip, and the displacement of the hip due to the bending of the trunk.

    It is zero if the poses are missing. ``seen`` are the positions (F, m) of each body's markers, m.
    """
    hip = skeleton.joints.index(_BENT) if _BENT in skeleton.joints else len(skeleton.segments)
    single = {numbers[0]: k for k, (numbers, _) in enumerate(bodies) if len(numbers) == 1}
    if hip not in single or hip + 1 not in single:
        return hip + 1, HipShift()
    k = single[hip + 1]
    trunk, points = bodies[k][1], seen[k]
    far = np.abs(trunk.local)
    near = points[:, far <= far.min() + _BESIDE]  # left and right
    return hip + 1, estimate_hip_shift(_frame(bodies[single[hip]][1]), _frame(trunk), near.mean(axis=1))


def _estimate_ankle(chain: MarkerChain, bodies: Sequence[tuple[list[int], ClusterPose]]) -> AnklePosition | None:
    """Return the position of the first joint, between moving feet and the segment above; None if it is unknown."""
    single = {numbers[0]: pose for numbers, pose in bodies if len(numbers) == 1}
    if not {0, 1} <= single.keys():
        return None
    return locate_ankle(_frame(single[0]), _frame(single[1]), complex(*chain.centres[0]))


def _frame(pose: ClusterPose) -> tuple[ComplexArray, FloatArray]:
    """Return the origin (F,), m, and the angle (F,), rad, of a body's frame."""
    return pose.position - np.exp(1j * pose.angle) * pose.local.mean(), pose.angle


def _list_bodies(segments: Sequence[str]) -> list[tuple[str, list[int]]]:
    """Return name and segments of each body: every segment, then pelvis and trunk as one body, if both exist."""
    apart = [(name, [k]) for k, name in enumerate(segments)]
    if not set(_ONE_BODY) <= set(segments):
        return apart
    return [*apart, ("torso", [segments.index(name) for name in _ONE_BODY])]


def _express_in_body(chain: MarkerChain, local: ComplexArray, numbers: list[int], angles: FloatArray) -> ComplexArray:
    """Return the markers (M,), m, x + 1j y, in the frame of a body's first segment.

    ``numbers`` are the segments of the body; the later ones have their mean angle.
    """
    found = local.copy()
    for segment in numbers[1:]:
        mean = np.nanmean(np.exp(1j * angles[:, segment - 1]))
        on = chain.segment == segment
        found[on] = complex(*chain.centres[segment - 1]) + mean / abs(mean) * local[on]
    return found


def _columns(view: Trajectories, poses: list[ClusterPose]) -> dict[str, FloatArray | IntArray]:
    columns: dict[str, FloatArray | IntArray] = {"time": view.time}
    for k, pose in enumerate(poses, start=1):
        columns |= {
            f"x_{k}": pose.position.real.copy(),
            f"y_{k}": pose.position.imag.copy(),
            f"angle_{k}": pose.angle,
            f"markers_{k}": pose.count.astype(np.int64),
        }
    return columns


def _fact(name: str, numbers: list[int], labels: list[str], pose: ClusterPose) -> dict[str, Any]:
    local = {label: [float(z.real), float(z.imag)] for label, z in zip(labels, pose.local, strict=True)}
    return {"name": name, "segments": numbers, "markers": local, "residual_m": pose.residual}
