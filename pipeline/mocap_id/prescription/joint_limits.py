"""Joint limits as a box of postures, given or from an observed motion (thesis 7.2.2, assumptions A1 to A3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class JointLimits:
    """The box of postures, Q of eq. 7.1.

    Parameters
    ----------
    lower, upper : (n,) arrays
        Limits of each joint angle, rad.
    lower_sd, upper_sd : (n,) arrays
        Their standard deviations, rad; 0 for given limits.

    Raises
    ------
    ValueError
        A limit is not finite, or a lower limit is not below the upper one.
    """

    lower: FloatArray
    upper: FloatArray
    lower_sd: FloatArray
    upper_sd: FloatArray

    def __post_init__(self) -> None:
        for j, (low, high) in enumerate(zip(self.lower, self.upper, strict=True), start=1):
            if not (np.isfinite(low) and np.isfinite(high)):
                raise ValueError(f"the limits of joint {j} are not known")
            if low >= high:
                raise ValueError(
                    f"the limits of joint {j} are crossed: {np.degrees(low):.1f}° is not below {np.degrees(high):.1f}°"
                )

    @classmethod
    def given(cls, lower: FloatArray, upper: FloatArray) -> JointLimits:
        """Return limits (n,) without uncertainty, rad."""
        return cls(lower, upper, np.zeros_like(lower), np.zeros_like(upper))

    @property
    def dimension(self) -> int:
        """Number of joints n."""
        return len(self.lower)

    def contains(self, q: FloatArray) -> BoolArray:
        """Return whether postures (..., n) are within the box."""
        return np.asarray(np.all((q >= self.lower) & (q <= self.upper), axis=-1))


def observed_limits(q: FloatArray, sd: FloatArray, measured: BoolArray, quantile: float = 0.0) -> JointLimits:
    """Return the extremes of an observed motion as limits.

    Parameters
    ----------
    q, sd : (T, n) arrays
        Joint angles and their standard deviations, rad.
    measured : (T, n) bool array
        Whether an angle was measured by markers in this frame; other samples are not used.
    quantile : float
        Fraction of each joint's samples, below 0.5, that is left out at either end; 0 for the extremes.

    Returns
    -------
    JointLimits
        The standard deviation of a limit is that of the angle at the extreme sample. With a quantile, it is the root
        mean square over the samples between 0.5 and 1.5 times the quantile.

    Raises
    ------
    ValueError
        A joint was never measured, or did not move.
    """
    if not 0.0 <= quantile < 0.5:
        raise ValueError(f"the quantile is {quantile}; expected at least 0 and below 0.5")
    ends = np.empty((2, q.shape[1]))
    ends_sd = np.empty_like(ends)
    for j in range(q.shape[1]):
        usable = measured[:, j] & np.isfinite(q[:, j])
        if not usable.any():
            raise ValueError(f"joint {j + 1} was not measured in any frame, so its limits are not known")
        order = np.argsort(q[usable, j])
        angle, spread = q[usable, j][order], sd[usable, j][order]
        for side, (values, deviations) in enumerate(((angle, spread), (angle[::-1], spread[::-1]))):
            ends[side, j], ends_sd[side, j] = _end(values, deviations, quantile)
    return JointLimits(ends[0], ends[1], ends_sd[0], ends_sd[1])


def _end(values: FloatArray, deviations: FloatArray, quantile: float) -> tuple[float, float]:
    """Limit at the beginning of sorted values (T,), and its standard deviation."""
    at = quantile * (len(values) - 1)
    below = int(at)
    above = min(below + 1, len(values) - 1)
    limit = values[below] + (at - below) * (values[above] - values[below])
    around = deviations[int(0.5 * at) : int(1.5 * at) + 1]
    return float(limit), float(np.sqrt(np.mean(around**2)))
