"""States of one joint from its encoder: third-order filter and smoother of position and velocity (ch. 5.4.1).

The state is angle, velocity and acceleration, driven by white jerk. Position and velocity are measured, so the problem
is linear and the smoother exact. Samples may be uneven. The cameras' frames enter as steps of the same process without
a measurement, so nothing is interpolated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.compilation import compiled

SIZE = 3
"""Derivatives in the state: angle, velocity, acceleration."""
START_SD = (1.0, 30.0, 1e3)
"""Standard deviations before the first sample, relative to its position: rad, rad/s, rad/s^2.

Not larger than needed, because the first update subtracts two nearly equal variances.
"""
POSITION_SD_FLOOR, VELOCITY_SD_FLOOR = 1e-7, 1e-6
"""Least noise, rad and rad/s, also for rounded or simulated records, which have less."""

_ENOUGH = 6000  # samples for the likelihood; more would hardly improve the noise
_SETTLE = 5  # samples that determine the unknown start, not counted in the likelihood
_DENSITY_BOUNDS = (1e-6, 1e12)


@dataclass(frozen=True)
class EncoderNoise:
    """Measurement and process noise.

    Parameters
    ----------
    position_sd, velocity_sd : float
        Standard deviations of a sample, rad and rad/s.
    density : float
        Spectral density of the jerk, rad^2/s^5.
    """

    position_sd: float
    velocity_sd: float
    density: float


@dataclass(frozen=True)
class EncoderStates:
    """States of the joint by the encoder's sign convention and clock.

    Parameters
    ----------
    time : (K,) array
        Time on the encoder's clock, s.
    mean, sd : (K, 3) arrays
        Angle, velocity and acceleration, rad, rad/s, rad/s^2, and their standard deviations.
    noise : EncoderNoise
    log_likelihood : float
        Log-likelihood of the innovations.
    """

    time: FloatArray
    mean: FloatArray
    sd: FloatArray
    noise: EncoderNoise
    log_likelihood: float


def smooth_encoder(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    noise: EncoderNoise,
    *,
    at: FloatArray | None = None,
) -> EncoderStates:
    """Return the smoothed states at the times of the samples, or at other times.

    Parameters
    ----------
    time : (K,) array
        Times of the samples, increasing, s.
    position, velocity : (K,) arrays
        Measurements, rad and rad/s.
    noise : EncoderNoise
    at : (N,) array, optional
        Increasing times of the wanted states, s.

    Returns
    -------
    EncoderStates
        States at ``at`` if given, otherwise at ``time``. The likelihood is always that of the samples.
    """
    wanted = time[:0] if at is None else at
    every = np.concatenate([time, wanted])
    order = np.argsort(every, kind="stable")
    measured = order < len(time)
    values = np.zeros((len(every), 2))
    values[measured] = np.column_stack([position - position[0], velocity])
    mean, sd, likelihood = _smooth(
        every[order],
        measured,
        values,
        np.array([noise.position_sd, noise.velocity_sd]) ** 2,
        noise.density,
        np.square(START_SD),
    )
    mean[:, 0] += position[0]
    kept = measured if at is None else ~measured
    return EncoderStates(every[order][kept], mean[kept], sd[kept], noise, float(likelihood))


def estimate_noise(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    *,
    position_sd: float | None = None,
    velocity_sd: float | None = None,
) -> EncoderNoise:
    """Estimate the noise by maximum likelihood of the innovations; given values are kept.

    Of a long record only the part with the most movement is used.

    Parameters
    ----------
    time, position, velocity : (K,) arrays
        s, rad, rad/s.
    position_sd, velocity_sd : float, optional
        Known noise of a sample, rad and rad/s.
    """
    part = _most_active(velocity)
    time, position, velocity = time[part], position[part], velocity[part]
    given = np.array([position_sd or math.nan, velocity_sd or math.nan, math.nan])
    floor = np.array([POSITION_SD_FLOOR, VELOCITY_SD_FLOOR, _DENSITY_BOUNDS[0]])
    ceiling = np.array([10.0, 100.0, _DENSITY_BOUNDS[1]])
    start = np.clip(_rough(time, position, velocity), 2 * floor, 0.5 * ceiling)
    open_ = np.isnan(given)
    measured, values = np.ones(len(time), dtype=np.bool_), np.column_stack([position - position[0], velocity])

    def noise(logs: FloatArray) -> FloatArray:
        full = given.copy()
        full[open_] = np.clip(np.exp(logs), floor[open_], ceiling[open_])
        return full

    def cost(logs: FloatArray) -> float:
        sizes = noise(logs)
        return -float(_filter(time, measured, values, sizes[:2] ** 2, float(sizes[2]), np.square(START_SD))[-1])

    first = np.log(start[open_])
    simplex = np.vstack([first, first + 1.5 * np.eye(len(first))])
    options: Any = {"initial_simplex": simplex, "xatol": 0.005, "fatol": 0.01, "maxfev": 400}
    found = noise(minimize(cost, first, method="Nelder-Mead", options=options).x)
    return EncoderNoise(float(found[0]), float(found[1]), float(found[2]))


def _most_active(velocity: FloatArray) -> slice:
    """Return the :data:`_ENOUGH` successive samples with the most movement."""
    if len(velocity) <= _ENOUGH:
        return slice(None)
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(velocity))])
    start = int(np.argmax(travelled[_ENOUGH:] - travelled[:-_ENOUGH]))
    return slice(start, start + _ENOUGH)


def _rough(time: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return initial values: noise from third differences, jerk density from steps of the smoothed velocity."""
    step = float(np.median(np.diff(time)))
    sds = [float(np.std(np.diff(each, 3))) / math.sqrt(20.0) for each in (position, velocity)]
    wide = max(1, round(0.05 / step))
    smooth = np.convolve(velocity, np.full(wide, 1.0 / wide), "valid")[::wide]
    jerk = float(np.std(np.diff(smooth, 2))) / (wide * step) ** 2 if len(smooth) > 2 else 1.0
    return np.array([*sds, max(jerk, 1e-2) ** 2 * 0.1])


def _smooth(  # noqa: PLR0917
    time: FloatArray, measured: BoolArray, values: FloatArray, variance: FloatArray, density: float, start: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Run the Rauch–Tung–Striebel smoother: states (K, 3), standard deviations, and the log-likelihood."""
    ahead, ahead_p, mean, covariance, total = _filter(time, measured, values, variance, density, start)
    dt = np.diff(time)
    transition = np.broadcast_to(np.eye(SIZE), (len(dt), SIZE, SIZE)).copy()
    transition[:, 0, 1] = transition[:, 1, 2] = dt
    transition[:, 0, 2] = 0.5 * dt**2
    gain = np.swapaxes(np.linalg.solve(ahead_p[1:], transition @ covariance[:-1]), 1, 2)
    # P + G (P' - A) G' = (P - G A G') + G P' G'; only the last term needs the next frame
    alone = covariance[:-1] - gain @ ahead_p[1:] @ np.swapaxes(gain, 1, 2)
    for k in range(len(dt) - 1, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1] - ahead[k + 1])
        covariance[k] = alone[k] + gain[k] @ covariance[k + 1] @ gain[k].T
    return mean, np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)), total


@compiled
def _filter(  # noqa: PLR0917
    time: FloatArray, measured: BoolArray, values: FloatArray, variance: FloatArray, density: float, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Run the Kalman filter: predicted and updated states (K, 3), covariances (K, 3, 3), and the log-likelihood."""
    count = len(time)
    ahead, ahead_p = np.empty((count, SIZE)), np.empty((count, SIZE, SIZE))
    found, found_p = np.empty((count, SIZE)), np.empty((count, SIZE, SIZE))
    x, p, gain = np.zeros(SIZE), np.zeros((SIZE, SIZE)), np.empty(SIZE)
    for i in range(SIZE):
        p[i, i] = start[i]
    seen, total = 0, 0.0
    for k in range(count):
        if k > 0:
            dt = time[k] - time[k - 1]
            x[0] += dt * x[1] + 0.5 * dt * dt * x[2]
            x[1] += dt * x[2]
            for c in range(SIZE):  # F P
                p[0, c] += dt * p[1, c] + 0.5 * dt * dt * p[2, c]
                p[1, c] += dt * p[2, c]
            for r in range(SIZE):  # (F P) F'
                p[r, 0] += dt * p[r, 1] + 0.5 * dt * dt * p[r, 2]
                p[r, 1] += dt * p[r, 2]
            p[0, 0] += density * dt**5 / 20.0
            p[0, 1] += density * dt**4 / 8.0
            p[0, 2] += density * dt**3 / 6.0
            p[1, 1] += density * dt**3 / 3.0
            p[1, 2] += density * dt**2 / 2.0
            p[2, 2] += density * dt
            p[1, 0], p[2, 0], p[2, 1] = p[0, 1], p[0, 2], p[1, 2]
        ahead[k], ahead_p[k] = x, p
        if measured[k]:
            seen += 1
            for d in range(2):
                s, y = p[d, d] + variance[d], values[k, d] - x[d]
                if seen > _SETTLE:
                    total -= 0.5 * (math.log(2.0 * math.pi * s) + y * y / s)
                for i in range(SIZE):
                    gain[i] = p[i, d] / s
                for i in range(SIZE):
                    x[i] += gain[i] * y
                    for j in range(SIZE):
                        p[i, j] -= gain[i] * gain[j] * s
        found[k], found_p[k] = x, p
    return ahead, ahead_p, found, found_p, total
