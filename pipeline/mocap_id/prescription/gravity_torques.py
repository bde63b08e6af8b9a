"""Joint torques that hold a planar chain still against gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.prescription.one_joint import OneJoint


@dataclass(frozen=True)
class ChainMasses:
    """Masses of a planar chain.

    Parameters
    ----------
    centres : (n, 2) array
        Centre of each joint in the segment before it, m.
    masses : (n, 3) array
        m, mx, my of each moving segment in its own frame, kg and kg·m. Identified parameters are sufficient: only the
        combinations that affect the torques matter.
    gravity : float
        m/s², along -y.

    Raises
    ------
    ValueError
        A value is not finite, or all are zero.
    """

    centres: FloatArray
    masses: FloatArray
    gravity: float = 9.81

    def __post_init__(self) -> None:
        if not np.isfinite(self.masses).all():
            raise ValueError("the masses are not known")
        if not self.masses.any():
            raise ValueError("the mass is zero: there is nothing to hold")

    def torques(self, q: FloatArray) -> FloatArray:
        """Return the torques (..., n), N·m, of the segment before each joint that hold postures (..., n), rad.

        Each is the moment g Σ (m (x - x_joint) + mx cos α - my sin α) of the segments beyond the joint, at angles α.
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
        """Return one joint, counted from 0, with the others fixed at ``posture`` (n,), rad.

        Raises
        ------
        ValueError
            As for :class:`~mocap_id.prescription.one_joint.OneJoint`.
        """
        postures = np.tile(posture, (2, 1)).astype(np.float64)
        postures[:, joint] = 0.0, np.pi / 2
        cosine, sine = self.torques(postures)[:, joint].tolist()
        return OneJoint(sine, cosine, *limits, *torque)
