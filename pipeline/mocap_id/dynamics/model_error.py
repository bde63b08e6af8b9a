"""How far off the model's wrench is, as the plate shows it.

The states' standard deviations hold for a movement that is as restless all the time as the process noise says. Real
movements are smooth, and rest in between, so the accelerations are better than that by a factor that no one knows
beforehand; and angles and geometry have errors too, which do not come and go with those of the accelerations. Off the
chair the plate tells both: what the measured wrench differs from the model's is the model's error and the plate's
noise, and the two part by frequency. The model is smooth; the plate's noise is white.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.lowpass import LowPass

_BAND = 25.0  # Hz: smoothed accelerations of people and robots hold nothing above
_SHARE = 0.25  # of the rate: below a quarter of it there is room above the band to see the noise in
_HIDDEN = 0.1  # of the variance within the band: less cannot be told from the plate's noise


@dataclass(frozen=True)
class ModelError:
    """Variance of the model's error in one component: ``steady + scale · (what the accelerations' noise makes of it)``.

    Parameters
    ----------
    steady : float
        Variance of the part that does not follow the accelerations' noise, N² or (N·m)².
    scale : float
        By which the states' variances are to be multiplied.
    overall : float
        The mean variance of the error by that which the states' variances stand for.
    """

    steady: float
    scale: float
    overall: float


def model_error(residual: FloatArray, noise: FloatArray, samples: BoolArray, rate: float) -> ModelError | None:
    """Size of the model's error in one component of the wrench.

    The squared residual within the band is fitted, with coefficients that are not negative, by a constant and the
    variance that the accelerations' noise would have; white noise of the density that is seen above the band is taken
    off. Noise of the plate that is not white counts as the model's: the result is then too large, not too small.

    Parameters
    ----------
    residual : (T,) array
        Measured less modelled.
    noise : (T,) array
        Variance of the component that the states' standard deviations stand for.
    samples : (T,) bool array
        Where only the ground touches the body.
    rate : float
        Hz.

    Returns
    -------
    ModelError or None
        None where no stretch is long enough, or the component is not modelled.
    """
    lowpass = LowPass(min(_BAND, _SHARE * rate), rate)
    low = lowpass(np.where(samples, residual, np.nan))
    seen = np.isfinite(low) & np.isfinite(noise)
    if seen.sum() < 2:
        return None
    mean, squares = float(np.mean(noise[seen])), (low[seen] - low[seen].mean()) ** 2
    passed, stopped = _white_gains(lowpass)
    plate = passed * float(np.var((residual - low)[seen])) / stopped
    size = max(float(squares.mean()) - plate, _HIDDEN * float(squares.mean()))
    if mean <= 0.0:
        return ModelError(size, 0.0, 1.0)
    (steady, moving), _ = nnls(np.column_stack([np.ones(seen.sum()), noise[seen] / mean]), squares)
    steady = max(steady - plate, 0.0)  # the plate's noise may exceed the constant part
    if steady + moving == 0.0:
        return ModelError(size, 0.0, size / mean)
    share = size / (steady + moving)
    return ModelError(share * steady, share * moving / mean, size / mean)


def _white_gains(lowpass: LowPass) -> tuple[float, float]:
    """Shares of white noise's variance that the filter passes and stops."""
    size = 20 * lowpass.reach_samples + 1
    impulse = np.zeros(size)
    impulse[size // 2] = 1.0
    response = lowpass(impulse)
    return float(np.sum(response**2)), float(np.sum((impulse - response) ** 2))
