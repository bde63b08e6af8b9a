"""The offset between the cameras' clock and the plate's, found by profiling the fit over it.

``clock_offset_s`` = δ means that the plate's sample stamped t was taken at t + δ on the markers' clock; the wrench at
marker time t is therefore the plate's at t - δ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.lowpass import known, runs

_COARSE = 5e-3  # s; the cost is smooth over a tenth of the movement's period, some 0.1 s
_FINE = 1e-6  # s
_AT_ONCE = 8  # offsets of the coarse search, to bound the memory
_EDGE = 1e-5  # s: this close to the end of the search, the least residual is beyond it


@dataclass(frozen=True)
class SampledWrench:
    """A wrench in time, between its samples too.

    Parameters
    ----------
    stretches : tuple of (start, end, spline)
        Finite stretches of the signal; cubic between the samples.
    components : int
        Number of columns.
    """

    stretches: tuple[tuple[float, float, Callable[[FloatArray], FloatArray]], ...]
    components: int

    @classmethod
    def of(cls, time: FloatArray, values: FloatArray) -> SampledWrench:
        """Interpolate samples (T, c) taken at ``time`` (T,), s; NaN is missing."""
        pieces = [run for run in runs(known(values)) if run.stop - run.start > 1]
        splines = tuple(
            (float(time[run.start]), float(time[run.stop - 1]), CubicSpline(time[run], values[run])) for run in pieces
        )
        return cls(splines, values.shape[1])

    def __call__(self, time: FloatArray) -> FloatArray:
        """Values (..., c) at times (...), s; NaN outside the stretches."""
        out = np.full((*time.shape, self.components), np.nan)
        for start, end, spline in self.stretches:
            inside = (time >= start) & (time <= end)
            out[inside] = spline(time[inside])
        return out

    def rate_of_change(self, time: FloatArray) -> FloatArray:
        """Time derivative (R, c) at times (R,); NaN outside the stretches."""
        out = np.full((len(time), self.components), np.nan)
        for start, end, spline in self.stretches:
            inside = (time >= start) & (time <= end)
            out[inside] = spline(time[inside], 1)  # type: ignore[call-arg]
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
    """Offset at which the best-fitting parameters leave the least residual.

    For every offset the parameters are solved for anew, at the price of one projection: the regressor does not depend
    on the offset. A coarse search over the whole range guards against a local minimum, a bounded one refines it.

    Parameters
    ----------
    regressor : (R, c, b) array
        Filtered and gated; nuisance columns included.
    wrench : callable
        From plate times (o, R) to the wrench (o, R, c), filtered alike; defined within ``limit`` of every sample.
    time : (R,) array
        Marker times of the samples, s.
    weights : (c,) array
        Weight of each component's residual.
    limit : float
        Offsets up to ± this are tried, s.
    prior : ((p, b) array, (p,) array), optional
        Rows and right-hand side of a prior of the parameters.

    Returns
    -------
    offset : float
        δ in s.
    at_edge : bool
        The least residual lies at an end of the search: there is no minimum inside.
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
    found = minimize_scalar(
        lambda offset: float(costs(np.array([offset]))[0]), bounds=bounds, method="bounded", options={"xatol": _FINE}
    )
    if abs(found.x) > limit - _EDGE:
        return float(np.copysign(limit, found.x)), True
    return float(found.x), False
