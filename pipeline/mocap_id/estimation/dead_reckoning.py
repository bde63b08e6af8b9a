"""Dead reckoning of a planar chain: constants, biases and clocks with which inertial sensors alone agree.

The angular velocities φ' of the segments follow from the gyroscopes; their sums are the angles φ but for a constant.
With v_k the vectors from joint to joint and w_k = 1j φ_k'' − φ_k'², the accelerometer of a segment must measure

    e^(−1j (φ + ψ)) (Σ w_k v_k + 1j g)

where ψ is the turn of the skin under it. Least squares of this difference give the constants, the change of each
gyroscope's bias at knots in time, that of each accelerometer, and the clocks against the first sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, as_complex, as_xy
from mocap_id.estimation.inertial import SegmentMotion, SensorSignals, prepare_sensor
from mocap_id.estimation.inertial.signals import GRAVITY
from mocap_id.estimation.inertial_smoothing import SHARES, CarriedSensor

_KNOT = 10.0  # s between the values of a gyroscope's bias
_MOST_KNOTS = 12
SWITCHED_ON = 0.006  # rad/s, by which a gyroscope's bias changes from one recording to the next
_WALK = 2e-4  # rad/s/√s, of a gyroscope's bias
FORCE_BIAS = 0.05  # m/s², by which an accelerometer's bias changes
_CLOCK = 0.1  # s, between the clocks of two sensors
_SMOOTHED = 0.025  # s, standard deviation of the window on all signals of the fit
_ROUNDS = 8
_STEP = 1e-4  # of a parameter, for derivatives
_FAR = 4.0  # times the rms residual; farther samples count less
_MOST = 3000  # frames of the fit
_SHOWN = 200  # frames in which the standard deviations of the angles are computed


@dataclass(frozen=True)
class KnownChain:
    """A chain and its sensors, as a trial with markers shows them.

    Parameters
    ----------
    centres : (n, 2) array
        Joint centres in the frame of the segment before, m.
    carried : tuple of CarriedSensor, length n
        The sensor on each moving segment.
    rest : (n,) array
        Joint angles at which the skin under the sensors is not turned, rad.
    density : (n,) array
        Spectral density of each joint's snap, rad²/s⁷.
    """

    centres: FloatArray
    carried: tuple[CarriedSensor, ...]
    rest: FloatArray
    density: FloatArray


@dataclass(frozen=True)
class Reckoning:
    """Motion of n segments by their gyroscopes, with what the accelerometers say about them, at F times.

    Parameters
    ----------
    angle, angle_sd : (F, n) arrays
        Angles of the segments, rad, and their standard deviations by the parameters below.
    shift, shift_sd : (n,) arrays
        Stamp of each sensor's clock minus that of the first one at the same time, s.
    gyro_bias, gyro_bias_sd : (F, n) arrays
        Change of each gyroscope's bias since the trial with markers, about the plane's normal, rad/s.
    force_bias, force_bias_sd : (n, 2) arrays
        Change of each accelerometer's bias, m/s².
    residual : (n,) array
        Root mean square of a component's difference of each accelerometer, m/s².
    """

    angle: FloatArray
    angle_sd: FloatArray
    shift: FloatArray
    shift_sd: FloatArray
    gyro_bias: FloatArray
    gyro_bias_sd: FloatArray
    force_bias: FloatArray
    force_bias_sd: FloatArray
    residual: FloatArray


@dataclass(frozen=True)
class _Unknowns:
    """Constants of the angles (n,), rad, changes of the biases (F, n), rad/s, and (n,), m/s², and clocks (n,), s."""

    start: FloatArray
    bias: FloatArray
    force: ComplexArray
    shift: FloatArray


class DeadReckoning:
    """Least squares of the accelerometers, with the motion that the gyroscopes show.

    Parameters
    ----------
    signals : sequence of SensorSignals, length n
        Of the sensor on each moving segment.
    time : (F,) array
        Uniform times on the first sensor's clock, s.
    chain : KnownChain
    """

    def __init__(self, signals: Sequence[SensorSignals], time: FloatArray, chain: KnownChain) -> None:
        self._signals, self._time, self._chain = tuple(signals), time, chain
        self._dt, n = float(time[1] - time[0]), len(signals)
        count = int(np.clip(1 + round((time[-1] - time[0]) / _KNOT), 2, _MOST_KNOTS))
        self._knots = np.linspace(time[0], time[-1], count)
        self._links = as_complex(chain.centres)
        self._place = np.array([complex(*each.found.place[:2]) for each in chain.carried])
        share = np.array([each.share for each in chain.carried])
        self._skin = share @ (np.eye(n) - np.eye(n, k=-1))  # for the angles of the segments, not of the joints
        self._resting = share @ chain.rest
        self._to_segments = np.linalg.inv(np.eye(n) + self._skin)
        self._half = int(np.ceil(3 * _SMOOTHED / self._dt))
        window = np.exp(-0.5 * (np.arange(-self._half, self._half + 1) * self._dt / _SMOOTHED) ** 2)
        self._window = window / window.sum()
        ends = np.cumsum([0, n, n * count, 2 * n, n - 1]).tolist()
        self._at = [slice(a, b) for a, b in pairwise(ends)]
        self._size = ends[-1]
        self._some = np.arange(0, len(time), max(1, -(-len(time) // _MOST)))
        self.sampled = lru_cache(maxsize=2 * n)(self._sampled)

    def _sampled(self, shift: tuple[float, ...]) -> tuple[FloatArray, ComplexArray]:
        """Return angular velocities (F, n) and specific forces (F, n) of the skin under each sensor, in its axes."""
        parts = [self.prepared(k, each) for k, each in enumerate(shift)]
        return np.stack([gyro[:, 2] for gyro, _ in parts], 1), np.stack([as_complex(f[:, :2]) for _, f in parts], 1)

    def prepared(self, k: int, shift: float) -> tuple[FloatArray, FloatArray]:
        """Return the signals (F, 3) of a sensor in the axes of its segment, with the biases of the other trial."""
        still, none = np.zeros(len(self._time)), np.zeros((len(self._time), 3))
        motion = SegmentMotion(none, none, none, still, still, np.array([0.0, 1.0, 0.0]))
        found = self._chain.carried[k].found
        found = replace(found, clock=replace(found.clock, offset=-shift, drift=0.0))
        ready = prepare_sensor(self._signals[k], found, motion, self._time, still == 0.0, SHARES)
        return ready.gyro, ready.force

    def solve(self) -> Reckoning:
        """Return the motion with the parameters that fit best, by Gauss–Newton with weak priors."""
        unknowns, prior = np.zeros(self._size), self._prior()
        unknowns[self._at[0]] = self._upright()
        spread = np.array([each.found.left[1] * np.sqrt(each.found.together[1]) for each in self._chain.carried])
        spread *= len(self._time) ** -0.5 * len(self._some) ** 0.5  # thinned samples are less correlated
        free = np.ones(self._size)
        free[self._at[0]] = 0.0  # the constants of the angles have no prior
        for _ in range(_ROUNDS):
            off = self._residual(unknowns)
            rows = np.stack([(self._residual(unknowns + _STEP * e) - off) / _STEP for e in np.eye(self._size)], 2)
            there = np.isfinite(off) & np.isfinite(rows).all(axis=2)
            usual = np.sqrt(np.mean(np.abs(off[there]) ** 2))
            weight = 1.0 / (spread * np.sqrt(np.fmax(1.0, np.abs(off) / (_FAR * usual))))
            rows, off = (rows * weight[..., None])[there], (off * weight)[there]
            normal = np.real(rows.conj().T @ rows) + prior
            step = -np.linalg.solve(normal, np.real(rows.conj().T @ off) + prior @ (free * unknowns))
            unknowns = unknowns + step
            if np.max(np.abs(step) * np.sqrt(np.diagonal(normal))) < 1e-2:
                break
        return self._described(unknowns, np.linalg.inv(normal))

    def _prior(self) -> FloatArray:
        """Return the inverse covariance of the parameters before the trial."""
        count = len(self._knots)
        walk = np.diff(np.eye(count), axis=0) / (_WALK * np.sqrt(np.diff(self._knots)))[:, None]
        of_bias = walk.T @ walk
        of_bias[0, 0] += 1.0 / SWITCHED_ON**2
        found = np.zeros((self._size, self._size))
        found[self._at[1], self._at[1]] = np.kron(np.eye(len(self._signals)), of_bias)
        for part, sd in ((self._at[2], FORCE_BIAS), (self._at[3], _CLOCK)):
            found[part, part] = np.eye(part.stop - part.start) / sd**2
        return found

    def _parts(self, unknowns: FloatArray) -> _Unknowns:
        start, bias, force, shift = (unknowns[each] for each in self._at)
        knots = bias.reshape(len(self._signals), -1)
        every = np.stack([np.interp(self._time, self._knots, each) for each in knots], axis=1)
        return _Unknowns(start, every, as_complex(force.reshape(-1, 2)), np.concatenate([[0.0], shift]))

    def _smoothed(self, values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        ends = [np.repeat(each, self._half, axis=0) for each in (values[:1], values[-1:])]
        padded = np.concatenate([ends[0], values, ends[1]])
        return np.stack([np.convolve(each, self._window, mode="valid") for each in padded.T], axis=1)

    def _motion(self, given: _Unknowns) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angles, angular velocities and accelerations (F, n) of the segments."""
        speed = (_filled(self.sampled(tuple(given.shift))[0]) - given.bias) @ self._to_segments.T
        turned = np.cumsum((speed[1:] + speed[:-1]) / 2, axis=0) * self._dt
        smooth = self._smoothed(speed)
        angle = given.start + np.concatenate([np.zeros((1, len(given.start))), turned])
        return angle, smooth, np.gradient(smooth, self._dt, axis=0)

    def _expected(self, angle: FloatArray, speed: FloatArray, turning: FloatArray) -> ComplexArray:
        """Return the specific forces (F, n) that the accelerometers should measure."""
        turn, weight = np.exp(1j * angle), 1j * turning - speed**2
        carried = np.cumsum(weight[:, :-1] * self._links[1:] * turn[:, :-1], axis=1)
        carried = np.concatenate([np.zeros((len(angle), 1)), carried], axis=1)
        skin = angle @ self._skin.T - self._resting
        total = carried + weight * self._place * turn + 1j * GRAVITY
        return np.asarray(total * np.exp(-1j * (angle + skin)))

    def _upright(self) -> FloatArray:
        """Return the constants of the angles with which the mean force points upwards."""
        n = len(self._signals)
        given = self._parts(np.zeros(self._size))
        angle, speed, turning = self._motion(given)
        force, start = self.sampled(tuple(given.shift))[1], np.zeros(n)
        for _ in range(3):  # the turn of the skin depends on the angle
            off = np.nansum(self._expected(start + angle, speed, turning) * np.conj(force), axis=0)
            start = start + self._to_segments @ np.angle(off)
        return np.asarray(start)

    def _residual(self, unknowns: FloatArray) -> ComplexArray:
        """Return the differences (f, n) of the forces at the frames of the fit; NaN where not measured."""
        given = self._parts(unknowns)
        measured = self._smoothed(self.sampled(tuple(given.shift))[1]) - given.force
        return np.asarray((measured - self._expected(*self._motion(given)))[self._some])

    def _described(self, unknowns: FloatArray, covariance: FloatArray) -> Reckoning:
        given, sd = self._parts(unknowns), np.sqrt(np.diagonal(covariance))
        angle, off = self._motion(given)[0], self._residual(unknowns)
        some = np.unique(np.linspace(0, len(angle) - 1, _SHOWN).astype(np.int64))
        moved = [self._motion(self._parts(unknowns + _STEP * e))[0][some] for e in np.eye(self._size)]
        rows = (np.stack(moved, axis=2) - angle[some, :, None]) / _STEP
        variance = np.einsum("fkp,pq,fkq->kf", rows, covariance, rows)
        knots = sd[self._at[1]].reshape(len(self._signals), -1)
        return Reckoning(
            angle=angle,
            angle_sd=np.stack([np.interp(self._time, self._time[some], np.sqrt(each)) for each in variance], axis=1),
            shift=given.shift,
            shift_sd=np.concatenate([[0.0], sd[self._at[3]]]),
            gyro_bias=given.bias,
            gyro_bias_sd=np.stack([np.interp(self._time, self._knots, each) for each in knots], axis=1),
            force_bias=as_xy(given.force),
            force_bias_sd=sd[self._at[2]].reshape(-1, 2),
            residual=np.sqrt(np.nanmean(np.abs(off) ** 2, axis=0) / 2),
        )


def _filled(values: FloatArray) -> FloatArray:
    """Return columns (F, n) with missing samples on straight lines."""
    every = np.arange(len(values))
    return np.stack([np.interp(every, every[np.isfinite(each)], each[np.isfinite(each)]) for each in values.T], axis=1)
