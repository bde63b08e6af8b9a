"""Limits of a movement: joint angles, speeds, accelerations, and balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.trajectory import Trajectory
from mocap_id.geometry import planar

_TINY = 1e-9
_FASTER = 1.5  # allowed speed, relative to the largest observed speed
_UPRIGHT = 0.9  # quantile of the highest joint's height above which the body is upright
_INSIDE = 0.01  # m: least distance of the resting posture's centre of pressure from the edge of the support


@dataclass(frozen=True)
class MovementLimits:
    """Bounds of a movement."""

    # low, high: (n,) lowest and highest joint angles, rad
    low: FloatArray
    high: FloatArray
    # speed, acceleration: (n,) largest speed and acceleration of each joint, rad/s and rad/s²
    speed: FloatArray
    acceleration: FloatArray
    # allowed range of the centre of pressure, m; None for a base that is bolted down
    support: tuple[float, float] | None

    def clip(self, posture: FloatArray) -> FloatArray:
        """Return the allowed posture (n,) that is nearest to the given one, rad."""
        room = np.minimum(_TINY, (self.high - self.low) / 2)
        return np.asarray(np.clip(posture, self.low + room, self.high - room))

    def usage(self, movement: Trajectory, wrench: FloatArray, moment_sd: FloatArray | None = None) -> float:
        """Return the largest fraction of any limit that a movement uses; above 1 the movement is not allowed.

        If ``movement.fitted`` is given, only these samples count. ``wrench`` (T, 3) is the wrench of the ground, N and
        N·m. ``moment_sd`` (T,) is the standard deviation of its moment, N·m, by which the centre of pressure is
        uncertain. The result is infinite if the body leaves the ground, if there is no sample to check, or, without
        ``movement.fitted``, if any sample is missing.
        """
        counted = movement.known if movement.fitted is None else movement.fitted & movement.known
        if not counted.any() or (movement.fitted is None and not counted.all()):
            return np.inf
        middle, half = (self.low + self.high) / 2, np.maximum((self.high - self.low) / 2, _TINY)
        parts = [
            np.abs(movement.q[counted] - middle) / half,
            np.abs(movement.dq[counted]) / self.speed,
            np.abs(movement.ddq[counted]) / self.acceleration,
        ]
        worst = max(float(np.max(part)) for part in parts)
        if self.support is None:
            return worst
        sd = np.zeros(len(wrench)) if moment_sd is None else moment_sd
        return max(worst, _compute_support_usage(wrench[counted], sd[counted], self.support))


def _compute_support_usage(wrench: FloatArray, moment_sd: FloatArray, support: tuple[float, float]) -> float:
    """Return the largest distance of the centre of pressure from the support's middle, divided by half its width."""
    if np.any(wrench[:, 1] <= 0.0):
        return np.inf
    low, high = support
    off = np.abs(wrench[:, 2] / wrench[:, 1] - (low + high) / 2) + moment_sd / wrench[:, 1]
    return float(np.max(off)) / max((high - low) / 2, _TINY)


def derive_limits(
    movement: Trajectory,
    wrench: FloatArray,
    rest: FloatArray,
    *,
    widened: float,
    speed: tuple[float, float],
    acceleration: tuple[float, float],
    slack: float | None,
    at_rest: float,
) -> MovementLimits:
    """Return limits that are derived from a recorded movement.

    Parameters
    ----------
    movement : Trajectory
        The trial's movement, with its fitted samples.
    wrench : (T, 3) array
        Wrench of the ground, N and N·m.
    rest : (n,) array
        Posture that is always allowed, rad.
    widened : float
        Angle by which every joint may exceed its observed range at both ends, rad.
    speed, acceleration : (float, float)
        Lower and upper bound of the limits, rad/s and rad/s². Between these bounds, the limit is 1.5 (speed) or 2.25
        (acceleration) times the largest observed value. Observed values are always allowed.
    slack : float or None
        Distance by which the centre of pressure may exceed its observed range, m; None for a base that is bolted down.
    at_rest : float
        Centre of pressure in the resting posture, m.
    """
    known = movement.known
    loaded = (known if movement.fitted is None else known & movement.fitted) & (wrench[:, 1] > 0.0)
    pressure = wrench[loaded, 2] / wrench[loaded, 1]
    support = None
    if slack is not None:
        support = (
            float(min(pressure.min() - slack, at_rest - _INSIDE)),
            float(max(pressure.max() + slack, at_rest + _INSIDE)),
        )
    return MovementLimits(
        low=np.minimum(movement.q[known].min(axis=0) - widened, rest),
        high=np.maximum(movement.q[known].max(axis=0) + widened, rest),
        speed=_compute_limits(movement.dq[known], _FASTER, *speed),
        acceleration=_compute_limits(movement.ddq[known], _FASTER**2, *acceleration),
        support=support,
    )


def _compute_limits(values: FloatArray, factor: float, least: float, most: float) -> FloatArray:
    """Return limits (n,): ``factor`` times the largest values (T, n), clipped, but at least the largest values."""
    largest = np.abs(values).max(axis=0)
    return np.asarray(np.maximum(largest, np.clip(factor * largest, least, most)))


def find_resting_posture(movement: Trajectory, centres: FloatArray, upright: bool) -> FloatArray:
    """Return the posture (n,) in which a movement starts, rad: the median of the trial's fitted samples.

    With ``upright``, it is the median of only the tenth of these samples in which the highest joint is highest.
    """
    q = movement.q[movement.known if movement.fitted is None else movement.known & movement.fitted]
    if upright:
        height = planar.segment_poses(q, centres)[1][:, -1, 1]
        q = q[height >= np.quantile(height, _UPRIGHT)]
    return np.asarray(np.median(q, axis=0))
