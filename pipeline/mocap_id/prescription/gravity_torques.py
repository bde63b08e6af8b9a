"""Joint torques that hold a planar chain still against gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.prescription.one_joint import OneJoint


@dataclass(frozen=True)
class ChainMasses:
    """Masses of a planar chain; ValueError is raised if one is not finite, or if all are zero."""

    centres: FloatArray  # (n, 2) centre of each joint in the frame of the previous segment, m
    # (n, 3) m, mx, my of each moving segment in its own frame, kg and kg·m. Identified parameters are sufficient:
    # only the combinations that they determine affect the torques.
    masses: FloatArray
    gravity: float = 9.81  # m/s², along -y

    def __post_init__(self) -> None:
        if not np.isfinite(self.masses).all():
            raise ValueError("a mass is not finite; expected finite masses and first moments of all segments")
        if not self.masses.any():
            raise ValueError("all masses are zero; expected at least one segment with a mass")

    def torques(self, q: FloatArray) -> FloatArray:
        """Return the joint torques (..., n), N·m, that hold postures (..., n), rad, against gravity.

        Each is the moment g Σ (m (x - x_joint) + mx cos α - my sin α) of the segments distal to the joint, at angles α.
        """
        angle, origin = segment_poses(q, self.centres)
        lever = rotate(angle[..., 1:], self.masses[:, 1:])[..., 0]  # (..., n)
        mass = self.masses[:, 0]
        x = origin[..., 1:, 0]
        moment = np.cumsum((mass * x + lever)[..., ::-1], axis=-1)[..., ::-1]
        beyond = np.cumsum(mass[::-1])[::-1]
        return np.asarray(self.gravity * (moment - beyond * x))

    def one_joint(
        self, joint: int, posture: FloatArray, limits: tuple[float, float], torque: tuple[float, float]
    ) -> OneJoint:
        """Return the model of one joint, counted from 0, while the others are fixed at ``posture`` (n,), rad.

        ValueError is raised as for :class:`OneJoint`.
        """
        postures = np.tile(posture, (2, 1)).astype(np.float64)
        postures[:, joint] = 0.0, np.pi / 2
        cosine, sine = self.torques(postures)[:, joint].tolist()
        return OneJoint(sine, cosine, *limits, *torque)
