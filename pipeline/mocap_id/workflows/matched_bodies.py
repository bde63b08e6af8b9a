"""The bodies of one trial with their motion in another trial, matched by their markers.

Two trials of a person may have chains with different segments, and a marker may belong to the foot in one and to the
shank in the other. Parameters belong to the marker groups of the trial on which they were identified. The second
trial's markers are therefore grouped as in the first: each group keeps its mass and has its own measured pose.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.measured_motion import BodyPoses, fill_gaps, filter_motion
from mocap_id.dynamics.parameter_transfer import BodyFrames
from mocap_id.dynamics.regressor import PlanarMotion
from mocap_id.errors import ConfigError
from mocap_id.geometry import planar
from mocap_id.kinematics.cluster_poses import ClusterPose, measure_cluster
from mocap_id.workflows.identified_trial import IdentifiedTrial
from mocap_id.workflows.moving_bodies import MovingBodies


def match_bodies(source: IdentifiedTrial, target: IdentifiedTrial) -> MovingBodies:
    """Return the bodies of the source's model with their measured motion in the target.

    No joint is pinned. Joint torques are about the target's joints; they are NaN for joints that the source lacks.

    Raises
    ------
    ConfigError
        The target's markers do not determine the pose of a body, which the message names.
    """
    frames, view = source.skeleton, target.planar
    columns = {label: column for column, label in enumerate(view.labels)}
    own = [
        np.array([i for i in np.flatnonzero(frames.segment == k) if frames.markers[i] in columns], dtype=np.int64)
        for k in range(len(frames.segments))
    ]
    clusters = [_measure_pose(source, target, k, markers, columns) for k, markers in enumerate(own)]
    centroid = np.array([[pose.local.mean().real, pose.local.mean().imag] for pose in clusters])
    poses, _ = fill_gaps(
        BodyPoses(
            time=view.time,
            position=np.stack([np.column_stack([pose.position.real, pose.position.imag]) for pose in clusters], axis=1),
            angle=np.column_stack([pose.angle for pose in clusters]),
            centroid=centroid,
            information=np.ones((len(clusters), 2)),
            body=np.zeros(1, dtype=np.int64),
            centres=np.zeros((0, 2)),
        )
    )
    motion, centres = _add_joints(filter_motion(poses, target.bands), frames, target)
    local = np.concatenate([pose.local for pose in clusters])
    every = np.concatenate(own)
    skeleton = replace(
        frames,
        centres=centres,
        markers=tuple(frames.markers[i] for i in every),
        segment=frames.segment[every],
        local=np.column_stack([local.real, local.imag]),
    )
    return MovingBodies(skeleton, motion, target.chain.gravity)


def _measure_pose(
    source: IdentifiedTrial, target: IdentifiedTrial, body: int, markers: IntArray, columns: dict[str, int]
) -> ClusterPose:
    """Return the measured pose of one body in the target.

    ``markers`` are the body's markers (indices in the source); ``columns`` are the target's markers by label.
    ConfigError is raised if the markers do not determine the pose.
    """
    frames = source.skeleton
    own = np.array([columns[frames.markers[i]] for i in markers], dtype=np.int64)
    points = target.planar.read_positions(own, axes="xy")
    pose = measure_cluster(np.asarray(points @ [1.0, 1.0j]), np.asarray(frames.local[markers] @ [1.0, 1.0j]))
    if pose is None:
        raise ConfigError(
            f"{target.source}: trial {target.name} has {len(markers)} of the {int((frames.segment == body).sum())} "
            f"markers on the {frames.segments[body]} of trial {source.name}, too few to measure its pose; expected at "
            "least two, visible together and a few centimetres apart. Markers are matched by label, so markers at the "
            "same position need the same label"
        )
    return pose


def _add_joints(motion: PlanarMotion, frames: BodyFrames, target: IdentifiedTrial) -> tuple[PlanarMotion, FloatArray]:
    """Return the motion with the target's joints, and the centre (n, 2) of each joint in the body before it, m.

    A centre is NaN if the target does not have the joint.
    """
    joint = target.bodies.motion.joint  # (T, n', 2)
    beyond = _find_beyond(frames, target)
    shared, centres = np.zeros(joint.shape[1], dtype=bool), np.full(frames.centres.shape, np.nan)
    for row, (below, above) in enumerate(frames.between):
        for j in np.flatnonzero(~beyond[:, below] & beyond[:, above]):
            centre = planar.rotate(-motion.angle[:, below], joint[:, j] - motion.origin[:, below])
            known = centre[np.isfinite(centre).all(axis=1)]
            if len(known):
                shared[j], centres[row] = True, known.mean(axis=0)
    return replace(motion, joint=np.where(shared[:, None], joint, np.nan), beyond=beyond), centres


def _find_beyond(frames: BodyFrames, target: IdentifiedTrial) -> BoolArray:
    """Return (n', K) for the target's n' joints and the K bodies whether the body is beyond the joint.

    A body is in the target's segment to which most of its markers belong.
    """
    chain = target.chain.skeleton
    joints = len(chain.centres)
    segment_of = dict(zip(chain.markers, chain.segment.tolist(), strict=True))
    segment = np.zeros(len(frames.segments), dtype=np.int64)
    for k in range(1, len(segment)):
        labels = [frames.markers[i] for i in np.flatnonzero(frames.segment == k)]
        segment[k] = Counter(segment_of.get(label, joints) for label in labels).most_common(1)[0][0]
    return np.asarray(segment > np.arange(joints)[:, None])
