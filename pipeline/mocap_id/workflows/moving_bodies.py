"""The bodies that carry a trial's mass, with their motion: segments of the pinned chain, or measured clusters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.bands import Bands
from mocap_id.dynamics.carry import Skeleton
from mocap_id.dynamics.measured_motion import measured_motion
from mocap_id.dynamics.motion import Motion
from mocap_id.dynamics.regressor import torque_regressor, wrench_regressor
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies, made_ready, read_bodies
from mocap_id.store import Table


@dataclass(frozen=True)
class MovingBodies:
    """K bodies and their motion.

    Parameters
    ----------
    skeleton : Skeleton
    motion : Motion
    gravity : float
        m/s².
    """

    skeleton: Skeleton
    motion: Motion
    gravity: float

    @cached_property
    def regressor(self) -> FloatArray:
        """Of the wrench that the motion needs, (T, 3, 4K), unfiltered."""
        return wrench_regressor(self.motion, self.gravity)

    @cached_property
    def torque_regressor(self) -> FloatArray:
        """Of the joint torques, (T, n, 4K), unfiltered; n counts the chain's joints."""
        return torque_regressor(self.motion, self.regressor)


def on_measured_poses(
    poses: Table, centres: FloatArray, used: Sequence[int], bands: Bands, gravity: float
) -> MovingBodies:
    """Bodies on their own measured poses: short gaps bridged, joints that hold pinned, low-passed.

    Parameters
    ----------
    poses : Table
        poses.parquet.
    centres : (n, 2) array
        Joint centres in the segment before, m.
    used : sequence of int
        Places of the bodies in poses.parquet, from 0.
    bands : (x, y, angle)
        Cut-offs, Hz.
    gravity : float
        m/s².
    """
    ready = made_ready(read_bodies(poses, centres, used))
    return MovingBodies(_skeleton(ready), measured_motion(ready.poses, bands), gravity)


def _skeleton(bodies: MeasuredBodies) -> Skeleton:
    poses, joints = bodies.poses, bodies.poses.joints
    return Skeleton(
        segments=bodies.names,
        centres=poses.centres[joints],
        between=np.array([(poses.body[j], poses.body[j + 1]) for j in joints], dtype=np.int64).reshape(-1, 2),
        markers=tuple(label for each in bodies.markers for label in each),
        segment=np.repeat(np.arange(len(bodies.names)), [len(each) for each in bodies.markers]),
        local=np.array([place for each in bodies.markers for place in each.values()]),
    )
