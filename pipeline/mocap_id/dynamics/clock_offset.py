"""Clock offset between cameras and plate, estimated as the offset with the best fit.

``clock_offset_s`` = δ means that the plate's sample with the time stamp t was taken at t + δ on the cameras' clock. The
wrench at camera time t is therefore the plate's wrench at t - δ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from mocap_id.arrays import FloatArray, find_complete_rows, find_runs

_COARSE = 10e-3  # s: a tenth of the time over which the cost is smooth
_FINE = 1e-6  # s: tolerance of the refined offset
_AT_ONCE = 8  # number of offsets evaluated together, to limit the memory
_EDGE = 1e-5  # s: a minimum within this distance of an end of the search counts as outside the search


@dataclass(frozen=True)
class SampledWrench:
    """A sampled wrench, interpolated by cubic splines."""

    stretches: tuple[tuple[float, float, CubicSpline], ...]  # intervals without missing samples, s
    components: int  # number of columns

    @classmethod
    def of(cls, time: FloatArray, values: FloatArray) -> SampledWrench:
        """Build the interpolation from samples (T, c) at ``time`` (T,), s; NaN marks missing values."""
        pieces = [run for run in find_runs(find_complete_rows(values)) if run.stop - run.start > 1]
        splines = tuple(
            (float(time[run.start]), float(time[run.stop - 1]), CubicSpline(time[run], values[run])) for run in pieces
        )
        return cls(splines, values.shape[1])

    def __call__(self, time: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the values, or their time derivative, (..., c) at times (...), s; NaN outside the intervals."""
        out = np.full((*time.shape, self.components), np.nan)
        for start, end, spline in self.stretches:
            inside = (time >= start) & (time <= end)
            out[inside] = spline(time[inside], derivative)
        return out


def profile_offset(
    regressor: FloatArray,
    wrench: Callable[[FloatArray], FloatArray],
    time: FloatArray,
    weights: FloatArray,
    limit: float,
    *,
    prior: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[float, bool]:
    """Return the clock offset δ, s, with the least residual of the fit, and whether it is at an end of the search.

    An offset at an end is not a minimum. The parameters are fitted again for every offset. This needs only one
    projection, because the regressor does not depend on the offset. A coarse search over the whole range avoids local
    minima; a bounded search refines its result.

    Parameters
    ----------
    regressor : (R, c, b) array
        Filtered rows of the fit, with the columns of the nuisance parameters.
    wrench : callable
        Function from plate times (o, R) to the filtered wrench (o, R, c); defined within ``limit`` of every sample.
    time : (R,) array
        Camera times of the samples, s.
    weights : (c,) array
        Weight of each component's residual.
    limit : float
        Largest offset in both directions, s.
    prior : ((p, b) array, (p,) array), optional
        Rows and right-hand side of a prior of the parameters, both in standard deviations.
    """
    weighted = (regressor * weights[:, None]).reshape(-1, regressor.shape[-1])
    more, aim = (np.zeros((0, weighted.shape[1])), np.zeros(0)) if prior is None else prior
    basis, _ = np.linalg.qr(np.concatenate([weighted, more]))

    def costs(offsets: FloatArray) -> FloatArray:
        targets = (wrench(time - offsets[:, None]) * weights).reshape(len(offsets), -1)
        targets = np.concatenate([targets, np.broadcast_to(aim, (len(offsets), len(aim)))], axis=1)
        rest = targets - (targets @ basis) @ basis.T
        return np.asarray(np.einsum("or,or->o", rest, rest))

    grid = np.linspace(-limit, limit, 2 * int(np.ceil(limit / _COARSE)) + 1)
    best = int(np.argmin(np.concatenate([costs(grid[k : k + _AT_ONCE]) for k in range(0, len(grid), _AT_ONCE)])))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    minimum = minimize_scalar(
        lambda offset: float(costs(np.array([offset]))[0]), bounds=bounds, method="bounded", options={"xatol": _FINE}
    )
    if abs(minimum.x) > limit - _EDGE:
        return float(np.copysign(limit, minimum.x)), True
    return float(minimum.x), False
