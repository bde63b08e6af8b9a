"""Size of the error of the model's wrench, estimated from the plate.

The standard deviations of the states assume that the process noise acts all the time. Real movements are smooth and
contain pauses, so the errors of the accelerations are smaller by an unknown factor. Angles and geometry also have
errors, which do not vary with the errors of the accelerations. When only the ground touches the body, the difference
between measured and modelled wrench is the error of the model plus the noise of the plate. The two can be separated,
because the error of the model is smooth and the plate's noise is white.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.lowpass import LowPass

_BAND = 25.0  # Hz: smoothed accelerations of people and robots have no power above this frequency
_SHARE = 0.25  # largest band as a fraction of the rate: the noise is measured above it
_HIDDEN = 0.1  # fraction of the variance in the band: a smaller error cannot be separated from the plate's noise


@dataclass(frozen=True)
class ModelError:
    """Variance of the model's error in one component: ``steady + scale · (variance from the accelerations)``."""

    steady: float  # variance of the part that is independent of the accelerations, N² or (N·m)²
    scale: float  # factor on the variances of the states
    overall: float  # mean variance of the error, divided by the mean variance that follows from the states


def estimate_model_error(residual: FloatArray, noise: FloatArray, samples: BoolArray, rate: float) -> ModelError | None:
    """Estimate the model's error in one component of the wrench; return None if no interval is long enough.

    A constant and the variance that follows from the accelerations are fitted, with non-negative coefficients, to the
    squared residual below 25 Hz. White noise with the density measured above this frequency is subtracted. Plate noise
    that is not white counts as an error of the model, which is then overestimated.

    Parameters
    ----------
    residual : (T,) array
        Measured minus modelled component.
    noise : (T,) array
        Variance of the component that follows from the standard deviations of the states.
    samples : (T,) bool array
        True for samples in which only the ground touches the body.
    rate : float
        Samples per second.
    """
    lowpass = LowPass(min(_BAND, _SHARE * rate), rate)
    low = lowpass(np.where(samples, residual, np.nan))
    valid = np.isfinite(low) & np.isfinite(noise)
    if valid.sum() < 2:
        return None
    mean, squares = float(np.mean(noise[valid])), (low[valid] - low[valid].mean()) ** 2
    passed, stopped = _split_white_noise(lowpass)
    plate = passed * float(np.var((residual - low)[valid])) / stopped
    size = max(float(squares.mean()) - plate, _HIDDEN * float(squares.mean()))
    if mean <= 0.0:
        return ModelError(size, 0.0, 1.0)
    (steady, moving), _ = nnls(np.column_stack([np.ones(valid.sum()), noise[valid] / mean]), squares)
    steady = max(steady - plate, 0.0)  # the plate's noise may exceed the constant part
    if steady + moving == 0.0:
        return ModelError(size, 0.0, size / mean)
    share = size / (steady + moving)
    return ModelError(share * steady, share * moving / mean, size / mean)


def _split_white_noise(lowpass: LowPass) -> tuple[float, float]:
    """Return the fractions of the variance of white noise that the filter passes and removes."""
    size = 20 * lowpass.reach_samples + 1
    impulse = np.zeros(size)
    impulse[size // 2] = 1.0
    response = lowpass(impulse)
    return float(np.sum(response**2)), float(np.sum((impulse - response) ** 2))
