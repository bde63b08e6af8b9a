"""Joint limits as a box of postures, given or from an observed motion (thesis 7.2.2, assumptions A1 to A3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class JointLimits:
    """The box of postures, Q of eq. 7.1; standard deviations are 0 for given limits.

    ValueError is raised if a limit is not finite, or a lower limit is not below the upper one.
    """

    lower: FloatArray  # (n,) rad
    upper: FloatArray  # (n,) rad
    lower_sd: FloatArray  # (n,) standard deviations of the lower limits, rad
    upper_sd: FloatArray  # (n,) standard deviations of the upper limits, rad

    def __post_init__(self) -> None:
        for j, (low, high) in enumerate(zip(self.lower, self.upper, strict=True), start=1):
            if not (np.isfinite(low) and np.isfinite(high)):
                raise ValueError(f"a limit of joint {j} is not finite; expected a lower and an upper limit")
            if low >= high:
                raise ValueError(
                    f"the limits of joint {j} are crossed: {np.degrees(low):.1f}° is not below {np.degrees(high):.1f}°"
                )

    @classmethod
    def given(cls, lower: FloatArray, upper: FloatArray) -> JointLimits:
        """Return joint limits (n,) without uncertainty, rad."""
        return cls(lower, upper, np.zeros_like(lower), np.zeros_like(upper))

    @property
    def dimension(self) -> int:
        """Number of joints n."""
        return len(self.lower)

    def contains(self, q: FloatArray) -> BoolArray:
        """Return whether each of the postures (..., n) is within the box."""
        return np.asarray(np.all((q >= self.lower) & (q <= self.upper), axis=-1))


def find_limits(q: FloatArray, sd: FloatArray, measured: BoolArray, quantile: float = 0.0) -> JointLimits:
    """Return the extremes of an observed motion as limits.

    ValueError is raised if a joint was never measured, or did not move.

    Parameters
    ----------
    q, sd : (T, n) arrays
        Joint angles and their standard deviations, rad.
    measured : (T, n) bool array
        Whether markers determine the angle in this frame; other samples are not used.
    quantile : float
        Fraction of each joint's samples, below 0.5, that is left out at either end; 0 for the extremes.

    Returns
    -------
    JointLimits
        The standard deviation of a limit is the standard deviation of the angle at the extreme sample. With a quantile,
        it is the root mean square over the samples between 0.5 and 1.5 times the quantile.
    """
    if not 0.0 <= quantile < 0.5:
        raise ValueError(f"the quantile is {quantile}; expected at least 0 and below 0.5")
    ends = np.empty((2, q.shape[1]))
    ends_sd = np.empty_like(ends)
    for j in range(q.shape[1]):
        usable = measured[:, j] & np.isfinite(q[:, j])
        if not usable.any():
            raise ValueError(f"joint {j + 1} was not measured in any frame, so its limits cannot be determined")
        order = np.argsort(q[usable, j])
        angle, angle_sd = q[usable, j][order], sd[usable, j][order]
        ends[0, j], ends_sd[0, j] = _lower_end(angle, angle_sd, quantile)
        ends[1, j], ends_sd[1, j] = _lower_end(angle[::-1], angle_sd[::-1], quantile)
    return JointLimits(ends[0], ends[1], ends_sd[0], ends_sd[1])


def _lower_end(values: FloatArray, sd: FloatArray, quantile: float) -> tuple[float, float]:
    """Return the limit at the beginning of sorted values (T,), and its standard deviation."""
    at = quantile * (len(values) - 1)
    below = int(at)
    above = min(below + 1, len(values) - 1)
    limit = values[below] + (at - below) * (values[above] - values[below])
    around = sd[int(0.5 * at) : int(1.5 * at) + 1]
    return float(limit), float(np.sqrt(np.mean(around**2)))
