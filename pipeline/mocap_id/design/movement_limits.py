"""Limits of a movement: joint angles, speeds, accelerations, and balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.trajectory import Trajectory
from mocap_id.geometry import planar

_TINY = 1e-9
_FASTER = 1.5  # allowed speed, relative to the largest observed speed
_UPRIGHT = 0.9  # quantile of the highest joint's height
_INSIDE = 0.01  # m: least distance of the resting posture's centre of pressure from the edge of the support


@dataclass(frozen=True)
class MovementLimits:
    """Bounds of a movement.

    Parameters
    ----------
    low, high : (n,) arrays
        Joint angles, rad.
    speed, acceleration : (n,) arrays
        Limits of each joint, rad/s and rad/s².
    support : (float, float) or None
        Range that the centre of pressure must not leave, m; None for a base that is bolted down.
    """

    low: FloatArray
    high: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    support: tuple[float, float] | None

    def inside(self, posture: FloatArray) -> FloatArray:
        """Return the allowed posture (n,) nearest to the given one, rad."""
        room = np.minimum(_TINY, (self.high - self.low) / 2)
        return np.asarray(np.clip(posture, self.low + room, self.high - room))

    def usage(self, movement: Trajectory, wrench: FloatArray, moment_sd: FloatArray | None = None) -> float:
        """Return the largest fraction of any limit that a movement uses; above 1 it is not allowed, inf if unknown.

        Parameters
        ----------
        movement : Trajectory
            Only its fitted samples count, if they are given.
        wrench : (T, 3) array
            Wrench of the ground, N and N·m.
        moment_sd : (T,) array, optional
            Standard deviation of the predicted moment, N·m: a margin for the centre of pressure.
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
        return max(worst, _support_usage(wrench[counted], sd[counted], self.support))


def _support_usage(wrench: FloatArray, moment_sd: FloatArray, support: tuple[float, float]) -> float:
    """Return the largest distance of the centre of pressure from the support's middle, in half widths of it."""
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
    """Derive limits from a recorded movement.

    Parameters
    ----------
    movement : Trajectory
        The trial's movement, with its fitted samples.
    wrench : (T, 3) array
        Wrench of the ground, N and N·m.
    rest : (n,) array
        Posture that is always allowed, rad.
    widened : float
        Angle by which every joint may exceed its observed range at either end, rad.
    speed, acceleration : (float, float)
        The allowed value is 1.5 (speed) or 2.25 (acceleration) times the largest observed one, but at least the first
        and at most the second number, rad/s and rad/s²; observed values are always allowed.
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
        speed=_allowed(movement.dq[known], _FASTER, *speed),
        acceleration=_allowed(movement.ddq[known], _FASTER**2, *acceleration),
        support=support,
    )


def _allowed(values: FloatArray, factor: float, least: float, most: float) -> FloatArray:
    """Return limits (n,): a multiple, clipped to least and most, of the largest values (T, n), but at least these."""
    largest = np.abs(values).max(axis=0)
    return np.asarray(np.maximum(largest, np.clip(factor * largest, least, most)))


def resting_posture(movement: Trajectory, centres: FloatArray, upright: bool) -> FloatArray:
    """Return the posture (n,) to start from, rad: the median one; if ``upright``, of the most upright tenth.

    Parameters
    ----------
    movement : Trajectory
        The trial's movement, with its fitted samples.
    centres : (n, 2) array
        Centre of each joint in the frame of the segment before it, m.
    upright : bool
        Use the tenth of the samples in which the highest joint is highest.
    """
    q = movement.q[movement.known if movement.fitted is None else movement.known & movement.fitted]
    if upright:
        height = planar.segment_poses(q, centres)[1][:, -1, 1]
        q = q[height >= np.quantile(height, _UPRIGHT)]
    return np.asarray(np.median(q, axis=0))
