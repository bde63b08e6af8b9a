"""The bodies of a trial with their motion: the segments of the pinned chain, or bodies with measured poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.identification import Cutoffs
from mocap_id.dynamics.measured_motion import close_gaps, filter_motion
from mocap_id.dynamics.parameter_transfer import BodyFrames
from mocap_id.dynamics.regressor import PlanarMotion, torque_regressor, wrench_regressor
from mocap_id.stages.identify_dim.validation import MeasuredBodies, bridge_gaps, read_bodies
from mocap_id.store import Table
from mocap_id.store.views import Skeleton


@dataclass(frozen=True)
class MovingBodies:
    """K bodies and their motion."""

    skeleton: BodyFrames
    motion: PlanarMotion
    gravity: float  # m/s²

    @cached_property
    def regressor(self) -> FloatArray:
        """Unfiltered regressor (T, 3, 4K) of the wrench that the motion requires."""
        return wrench_regressor(self.motion, self.gravity)

    @cached_property
    def torque_regressor(self) -> FloatArray:
        """Unfiltered regressor (T, n, 4K) of the torques of the chain's n joints."""
        return torque_regressor(self.motion, self.regressor)


def read_measured_bodies(
    poses: Table, chain: Skeleton, motion: Mapping[str, Any], bands: Cutoffs, gravity: float
) -> MovingBodies:
    """Return bodies whose motion follows from their measured, low-pass filtered poses.

    Short gaps are filled.

    Parameters
    ----------
    poses : Table
        Content of poses.parquet.
    chain : Skeleton
        Chain of the trial.
    motion : mapping of str to Any
        Fact ``motion`` of dynamics.h5, which names the bodies and the joints that are pinned.
    bands : (x, y, angle)
        Cut-off frequencies, Hz.
    gravity : float
        Gravity, m/s².
    """
    ready = bridge_gaps(read_bodies(poses, chain.centres, motion["used"]))
    pinned = [chain.joint_names.index(name) for name, gap in motion["joints"].items() if gap["pinned"]]
    return MovingBodies(_skeleton(ready), filter_motion(close_gaps(ready.poses, pinned), bands), gravity)


def _skeleton(bodies: MeasuredBodies) -> BodyFrames:
    poses, joints = bodies.poses, bodies.poses.joints
    return BodyFrames(
        segments=bodies.names,
        centres=poses.centres[joints],
        between=np.array([(poses.body[j], poses.body[j + 1]) for j in joints], dtype=np.int64).reshape(-1, 2),
        markers=tuple(label for each in bodies.markers for label in each),
        segment=np.repeat(np.arange(len(bodies.names)), [len(each) for each in bodies.markers]),
        local=np.array([place for each in bodies.markers for place in each.values()]),
    )
