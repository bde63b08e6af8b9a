"""The bodies of one trial, followed through another by their markers.

Two trials of a person may have chains of different segments, and a marker may count with the foot in one and with the
shank in the other. What was identified belongs to the markers of the first trial. So the second trial's markers are
grouped as the first one's bodies are: every group keeps its mass, and shows its own pose.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.carry import Skeleton
from mocap_id.dynamics.measured_motion import BodyPoses, bridged, measured_motion
from mocap_id.dynamics.motion import Motion
from mocap_id.errors import ConfigError
from mocap_id.geometry import planar
from mocap_id.kinematics.cluster_poses import ClusterPose, measure_cluster
from mocap_id.workflows.finished import Finished
from mocap_id.workflows.moving_bodies import MovingBodies


def followed(source: Finished, target: Finished) -> MovingBodies:
    """The bodies of the source's model on their measured poses in the target.

    No joint is pinned. Joint torques are about the target's own joints, NaN about joints that the source lacks.

    Raises
    ------
    ConfigError
        The target does not show the pose of a body, which is named.
    """
    wanted, view = source.skeleton, target.planar
    columns = {label: column for column, label in enumerate(view.labels)}
    own = [
        np.array([i for i in np.flatnonzero(wanted.segment == k) if wanted.markers[i] in columns], dtype=np.int64)
        for k in range(len(wanted.segments))
    ]
    found = [_pose(source, target, k, markers, columns) for k, markers in enumerate(own)]
    centroid = np.array([[pose.local.mean().real, pose.local.mean().imag] for pose in found])
    poses, _ = bridged(
        BodyPoses(
            time=view.time,
            position=np.stack([np.column_stack([pose.position.real, pose.position.imag]) for pose in found], axis=1),
            angle=np.column_stack([pose.angle for pose in found]),
            centroid=centroid,
            information=np.ones((len(found), 2)),
            body=np.zeros(1, dtype=np.int64),
            centres=np.zeros((0, 2)),
        )
    )
    motion, centres = _with_joints(measured_motion(poses, target.bands), wanted, target)
    local = np.concatenate([pose.local for pose in found])
    every = np.concatenate(own)
    skeleton = replace(
        wanted,
        centres=centres,
        markers=tuple(wanted.markers[i] for i in every),
        segment=wanted.segment[every],
        local=np.column_stack([local.real, local.imag]),
    )
    return MovingBodies(skeleton, motion, target.chain.gravity)


def _pose(source: Finished, target: Finished, body: int, markers: IntArray, columns: dict[str, int]) -> ClusterPose:
    """Pose of one body by those of its markers, given by their numbers, that the target has."""
    wanted = source.skeleton
    seen = target.planar.without_bursts(np.array([columns[wanted.markers[i]] for i in markers], dtype=np.int64))
    pose = measure_cluster(np.asarray(seen @ [1.0, 1.0j]), np.asarray(wanted.local[markers] @ [1.0, 1.0j]))
    if pose is None:
        raise ConfigError(
            f"{target.source}: trial {target.name} does not show how the {wanted.segments[body]} of trial "
            f"{source.name} lies: it has {len(markers)} of that body's {int((wanted.segment == body).sum())} markers; "
            "expected at least two, seen together and a few centimetres apart. Markers are matched by label: markers "
            "at the same place need the same label"
        )
    return pose


def _with_joints(motion: Motion, wanted: Skeleton, target: Finished) -> tuple[Motion, FloatArray]:
    """The motion with the target's joints, and where (n, 2) they lie in the body before, m, for each wanted joint."""
    joint = target.bodies.motion.joint  # (T, n', 2)
    beyond = _beyond(wanted, target)
    shared, centres = np.zeros(joint.shape[1], dtype=bool), np.full(wanted.centres.shape, np.nan)
    for row, (below, above) in enumerate(wanted.between):
        for j in np.flatnonzero(~beyond[:, below] & beyond[:, above]):
            place = planar.rotate(-motion.angle[:, below], joint[:, j] - motion.origin[:, below])
            known = place[np.isfinite(place).all(axis=1)]
            if len(known):
                shared[j], centres[row] = True, known.mean(axis=0)
    return replace(motion, joint=np.where(shared[:, None], joint, np.nan), beyond=beyond), centres


def _beyond(wanted: Skeleton, target: Finished) -> BoolArray:
    """(n', K) the wanted bodies beyond each joint of the target, by the segment that holds most of their markers."""
    chain = target.chain.skeleton
    joints = len(chain.centres)
    holds = dict(zip(chain.markers, chain.segment.tolist(), strict=True))
    segment = np.zeros(len(wanted.segments), dtype=np.int64)
    for k in range(1, len(segment)):
        labels = [wanted.markers[i] for i in np.flatnonzero(wanted.segment == k)]
        segment[k] = Counter(holds.get(label, joints) for label in labels).most_common(1)[0][0]
    return np.asarray(segment > np.arange(joints)[:, None])
