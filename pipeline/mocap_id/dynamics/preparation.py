"""Preparation of a trial for identification: low-pass, clock offset, regressor, filtered signals, usable samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray, chunks, find_complete_rows, find_runs
from mocap_id.dynamics.priors import BodyPrior
from mocap_id.dynamics.regressor import (
    SEAT,
    BaseSet,
    ExternalWrench,
    PlanarMotion,
    move_chain,
    regroup_columns,
    wrench_regressor,
)

if TYPE_CHECKING:
    from mocap_id.dynamics.space.preparation import SpatialTrial

_SHARE, _MARGIN, _LOWEST, _HIGHEST = 0.999, 2.0, 3.0, 10.0
_OVERSAMPLED = 10
_PASSES_ALL = 0.49  # cut-off as a fraction of the rate; a higher one passes every frequency that the samples contain
_COLUMNS = 8  # number of columns filtered at a time, to limit the memory


@dataclass(frozen=True)
class LowPass:
    """Butterworth filter of order 2, run forwards and backwards, which does not shift the phase.

    Its gain at the frequency f is 1 / (1 + (tan(πf/rate) / tan(π·cutoff/rate))⁴), which multiplies the Fourier
    transform of each interval without gaps. The straight line through the ends of the interval is subtracted first and
    added again at the end. The remainder is extended beyond both ends by its reflection with the opposite sign.
    """

    cutoff: float  # cut-off frequency of a single pass, Hz
    rate: float  # samples per second

    @property
    def reach(self) -> float:
        """Time to either side of a sample, s, beyond which only 3 % of the area of its impulse response lies."""
        return 0.8 / self.cutoff

    @property
    def reach_samples(self) -> int:
        """Number of samples in :attr:`reach`, at least 1."""
        return max(1, round(self.reach * self.rate))

    @property
    def step(self) -> int:
        """Number k such that every k-th filtered sample is sufficient: about ten samples per period of the cut-off."""
        return max(1, int(self.rate / (_OVERSAMPLED * self.cutoff)))

    def gain(self, cycles: FloatArray) -> FloatArray:
        """Return the gain at frequencies in cycles per sample, 0 to 0.5."""
        tangent = np.tan(np.pi * cycles) / np.tan(np.pi * min(self.cutoff / self.rate, _PASSES_ALL))
        return np.asarray(1.0 / (1.0 + tangent**4))

    def __call__(self, signal: FloatArray) -> FloatArray:
        """Return a signal (T, ...), filtered along the first axis in each interval without gaps (samples with any NaN).

        The result is NaN in missing samples, and in intervals of at most twice the filter's reach.
        """
        flat = signal.reshape(len(signal), -1)
        moving = np.flatnonzero(np.any(flat != 0.0, axis=0))  # columns of zeros stay zeros
        out = np.zeros_like(flat)
        out[:] = np.nan
        beyond = 2 * self.reach_samples
        for run in find_runs(find_complete_rows(flat)):
            count = run.stop - run.start
            if count <= beyond:
                continue
            out[run] = 0.0
            place = np.arange(count)[:, None] / (count - 1)
            for columns in (moving[c] for c in chunks(len(moving), _COLUMNS)):
                series = flat[run, columns]
                line: FloatArray = (1.0 - place) * series[0] + place * series[-1]
                rest = np.zeros((next_fast_len(count + 2 * beyond, real=True), series.shape[1]))
                rest[:count] = series - line
                rest[count : count + beyond] = -rest[count - beyond - 1 : count - 1][::-1]
                rest[-beyond:] = -rest[beyond:0:-1]
                gain = self.gain(np.asarray(np.fft.rfftfreq(len(rest)), dtype=np.float64))
                line += irfft(gain[:, None] * rfft(rest, axis=0), len(rest), axis=0)[:count]
                out[run, columns] = line
        return out.reshape(signal.shape)


def choose_cutoff(dq: FloatArray, rate: float) -> float:
    """Return the default cut-off, Hz: twice the frequency below which 99.9 % of the velocity's power lies.

    The joint with the highest frequency and the longest interval without gaps of the joint velocities ``dq`` (T, n),
    rad/s, are used. The result is between 3 and 10 Hz, and at most a fifth of the rate. Noise would dominate the
    spectrum of accelerations.
    """
    longest = max(find_runs(find_complete_rows(dq)), key=lambda run: run.stop - run.start, default=slice(0, 0))
    signal = dq[longest]
    if len(signal) < 2:
        return _LOWEST
    power = np.abs(np.fft.rfft((signal - signal.mean(axis=0)) * np.hanning(len(signal))[:, None], axis=0)) ** 2
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    highest = float(np.max(np.argmax(share >= _SHARE, axis=0))) * rate / len(signal)
    return float(np.clip(_MARGIN * highest, _LOWEST, min(_HIGHEST, rate / 5)))


def undo_averaging(filtered: FloatArray, samples: float) -> FloatArray:
    """Return a filtered signal (T, c), corrected for the averaging of each sample over a time W of ``samples`` samples.

    The mean of a smooth signal w over W is w + W²/24 · w'' plus a term in W⁴. If W is one sample, the correction is
    below 2 % at frequencies below a tenth of the rate. The ends of an interval without gaps do not change.
    """
    bend = np.zeros_like(filtered)
    bend[1:-1] = np.diff(filtered, 2, axis=0)
    return np.asarray(filtered - samples**2 / 24.0 * np.where(np.isfinite(bend), bend, 0.0))


def erode(mask: BoolArray, samples: int) -> BoolArray:
    """Return a copy of a mask (T,) in which the first and last ``samples`` flags of every run of True are False."""
    out = np.zeros_like(mask)
    for run in find_runs(mask):
        out[run.start + samples : max(run.stop - samples, run.start + samples)] = True
    return out


def blank_incomplete(wrench: FloatArray) -> FloatArray:
    """Return a copy of a wrench (T, c), with NaN in all components of a sample if one of them is missing."""
    return np.where(find_complete_rows(wrench)[:, None], wrench, np.nan)


def interpolate_samples(time: FloatArray, samples: IntArray, steps: IntArray, values: FloatArray) -> FloatArray:
    """Interpolate values (t, n) at ``steps`` (t,) to ``samples``; return (T, n), NaN in other samples."""
    out = np.full((len(time), values.shape[1]), np.nan)
    for column, series in enumerate(values.T):
        out[samples, column] = np.interp(time[samples], time[steps], series)
    return out


_COARSE = 10e-3  # s: a tenth of the time over which the cost is smooth
_FINE = 1e-6  # s: tolerance of the refined offset
_AT_ONCE = 8  # number of offsets evaluated together, to limit the memory
_EDGE = 1e-5  # s: a minimum within this distance of an end of the search counts as outside the search


class SampledWrench:
    """A wrench sampled (T, c) at ``time`` (T,), s, interpolated by cubic splines between missing samples (NaN)."""

    def __init__(self, time: FloatArray, values: FloatArray) -> None:
        self._components = values.shape[1]
        pieces = [run for run in find_runs(find_complete_rows(values)) if run.stop - run.start > 1]
        self._stretches = [  # start, end, s, and spline of each interval without missing samples
            (float(time[run.start]), float(time[run.stop - 1]), CubicSpline(time[run], values[run])) for run in pieces
        ]

    def __call__(self, time: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the values, or their time derivative, (..., c) at times (...), s; NaN outside the intervals."""
        out = np.full((*time.shape, self._components), np.nan)
        for start, end, spline in self._stretches:
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
    projection, because the regressor does not depend on the offset. A coarse search over the whole range, ``limit`` s
    in both directions, avoids local minima; a bounded search refines its result.

    ``regressor`` (R, c, b) are the filtered rows of the fit at the camera times ``time`` (R,), s, with the columns of
    the nuisance parameters; ``weights`` (c,) are those of the components. ``wrench`` gives the filtered wrench (o, R,
    c) at plate times (o, R). ``prior`` are rows (p, b) and right-hand side (p,), in standard deviations.
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


AnyTrial: TypeAlias = "PreparedTrial | SpatialTrial"
"""A prepared trial in the plane or in space."""
MEASURED_CUTOFF = 5.0
"""Cut-off of regressor and wrench for measured poses, Hz. Movements are slower, and the poses are already filtered."""


@dataclass(frozen=True)
class CoarseClock:
    """Result of the coarse search for the clock offset of the plates, which precedes the fit."""

    offset: float = 0.0  # clock offset that is already corrected in the wrenches, s; the fit finds the rest
    doubt: str | None = None  # reason why the offset is not known; None if it is, or if there is nothing to see
    search: float = 0.15  # largest remaining offset that the fit searches, in both directions, s


NO_CLOCK = CoarseClock()


@dataclass(frozen=True)
class TrialData:
    """Measured states and wrenches of a trial, sample by sample."""

    time: FloatArray  # (T,) sample times with constant step, s
    # q, dq, ddq: (T, n) joint angles, rad, and their time derivatives; NaN where missing
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    ddq_sd: FloatArray  # (T, n) standard deviation of the accelerations, rad/s²
    observed: BoolArray  # (T,) whether every angle was measured by markers
    # (T, 3) (Fx, Fy, tauz) of the ground on the body in the plane frame, N and N·m, at ``time`` on the plate's clock;
    # NaN where missing
    wrench: FloatArray
    centres: FloatArray  # (n, 2) centre of each joint in the frame of the segment before it, m
    external: tuple[ExternalWrench, ...] = ()  # measured wrenches on the body, except the ground's
    averaged: float = 0.0  # time over which each plate sample is averaged, s; 0 for instantaneous samples
    # motion of the bodies from their measured poses; None to use the motion of the pinned chain
    measured: PlanarMotion | None = None
    knee: int = 1  # number of the knee among the joints, from 0
    # components of `wrench` that the ground's sensor measures; the other components of `wrench` are 0
    measures: tuple[int, ...] = (0, 1, 2)
    # height above the plane's origin of the surface on which the centre of pressure is, m; 0 for plates
    surface: float = 0.0
    # standard deviation of the sensor's position along the motion, m; None if it was not estimated from the trial
    position_sd: float | None = None
    # wrenches measured by sensors built into joints, on the segment beyond the joint
    built_in: tuple[ExternalWrench, ...] = ()
    clock: CoarseClock = NO_CLOCK  # coarse clock offset of the plates

    def as_measured(self, wrench: FloatArray) -> FloatArray:
        """Return a wrench (..., 3) with NaN in the components that are not measured."""
        if len(self.measures) == wrench.shape[-1]:
            return wrench
        return np.where(np.isin(np.arange(3), self.measures), wrench, np.nan)

    @property
    def motion(self) -> PlanarMotion:
        """The measured motion if there is one, otherwise the motion of the pinned chain."""
        return self.measured or move_chain(self.centres, self.q, self.dq, self.ddq)

    @property
    def rate(self) -> float:
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def seat(self) -> ExternalWrench | None:
        """The chair's wrench if a separate plate measures it, otherwise None."""
        return next((each for each in self.external if each.name == SEAT), None)

    @property
    def elsewhere(self) -> FloatArray:
        """Sum (T, 3) of all wrenches except the ground's, without correction of the clock offset."""
        return sum((each.wrench for each in self.external), np.zeros_like(self.wrench))

    @property
    def surroundings(self) -> FloatArray:
        """Sum (T, 3) of all wrenches, without correction of the clock offset."""
        return self.wrench + self.elsewhere


@dataclass(frozen=True)
class FitSettings:
    """Settings of the identification; the defaults are those of the stage."""

    components: tuple[int, ...] = (0, 1, 2)  # components of (Fx, Fy, tauz) to fit
    # low-pass of regressor and wrench, Hz; None for `choose_cutoff`, or 5 Hz for measured poses
    cutoff: float | None = None
    # largest clock offset that the fit searches, in both directions from the coarse one, s
    offset_limit: float = 0.15
    apply_offset: bool = True  # correct the wrench for the clock offset found
    plate_bias: bool = True  # estimate a constant error of the plate's Fx
    # standard deviations of the plate's constant errors in Fy, N, and tauz, N·m. No movement separates them from the
    # first two base parameters.
    plate_zero: tuple[float, float] = (5.0, 0.5)
    block: float = 1.0  # length of the blocks between which residuals count as independent, s
    gravity: float = GRAVITY  # gravitational acceleration, m/s²


@dataclass(frozen=True)
class PreparedTrial:
    """A trial prepared for identification."""

    recorded: TrialData  # measured states and wrenches
    settings: FitSettings  # settings of the identification
    lowpass: LowPass  # filter of regressor and wrench
    base: BaseSet  # base parameters that the motion determines
    regressor: FloatArray  # (T, 3, 4(n + 1)) full regressor without filtering; NaN where a state is
    filtered: FloatArray  # (T, 3, b) base columns after the low-pass
    # wrench, filtered_wrench: sum of all plates, at times of their clock. `filtered_wrench` is corrected for the
    # averaging of the samples.
    wrench: SampledWrench
    filtered_wrench: SampledWrench
    # sensors, filtered_sensors: (T, 3) sum of all other sensors, at times of the cameras' clock
    sensors: FloatArray
    filtered_sensors: FloatArray
    usable: BoolArray  # (T,) samples with filtered regressor, and with filtered wrench at every offset within the limit
    # prior of the full parameters. With a prior, all full parameters are fitted and `base` keeps every column.
    prior: BodyPrior | None = None

    @property
    def constants(self) -> tuple[int, ...]:
        """Components whose constant error is estimated: only Fx, because gravity causes no constant Fx."""
        return (0,) if self.settings.plate_bias and 0 in self.settings.components else ()

    @cached_property
    def motion(self) -> PlanarMotion:
        return self.recorded.motion

    @cached_property
    def rows(self) -> FloatArray:
        """Minimal regressor Y_b (T, 3, b), unfiltered (eq. 4.7)."""
        return self.base.columns(self.regressor)

    def measured(self, offset: float) -> FloatArray:
        """Return the total wrench (T, 3) at the cameras' times, for a clock offset of the plates, s."""
        return self.recorded.as_measured(self.wrench(self.recorded.time - offset) + self.sensors)

    def ground(self, offset: float) -> FloatArray:
        """Return the ground's wrench (T, 3) at the cameras' times, for a clock offset of the plates, s."""
        return self.recorded.as_measured(self._ground(self.recorded.time - offset))

    @cached_property
    def _ground(self) -> SampledWrench:
        return SampledWrench(self.recorded.time, blank_incomplete(self.recorded.wrench))

    def external(self, offset: float, filtered: bool = False) -> list[FloatArray]:
        """Return every external wrench (T, 3) at the cameras' times, if wanted filtered like the regressor."""
        time = self.recorded.time
        wrenches = []
        for each in self.recorded.external:
            wrench = blank_incomplete(each.wrench)
            if filtered:
                wrench = _filter_wrench(self.recorded, self.lowpass, wrench) if each.by_plates else self.lowpass(wrench)
            wrenches.append(SampledWrench(time, wrench)(time - offset) if each.by_plates else wrench)
        return wrenches

    def elsewhere(self, offset: float) -> FloatArray:
        """Return the sum (T, 3) of the external wrenches at the cameras' times, for a clock offset of the plates, s."""
        return sum(self.external(offset), np.zeros_like(self.recorded.wrench))

    def filtered_measured(self, samples: IntArray, stamped: FloatArray) -> FloatArray:
        """Return the filtered total wrench (..., R, 3) of samples (R,) at times (..., R) on the plates' clock, s."""
        return self.recorded.as_measured(self.filtered_wrench(stamped) + self.filtered_sensors[samples])


def prepare(recorded: TrialData, settings: FitSettings, prior: BodyPrior | None = None) -> PreparedTrial:
    """Build regressor, base parameters, filtered signals and usable samples; a prior keeps all full parameters."""
    regressor = wrench_regressor(recorded.motion, settings.gravity)
    moving = find_complete_rows(regressor)
    cutoff = settings.cutoff
    if cutoff is None:
        measured = recorded.measured is not None
        cutoff = min(MEASURED_CUTOFF, recorded.rate / 5) if measured else choose_cutoff(recorded.dq, recorded.rate)
    lowpass = LowPass(cutoff, recorded.rate)
    columns = regressor.shape[-1]
    if prior is None:
        selected = regressor[moving][:: lowpass.step, list(settings.components), :]
        base = regroup_columns(selected.reshape(-1, columns))
    else:
        base = BaseSet(np.arange(columns), np.eye(columns))
    # two sums of wrenches: one has the clock of the plates, the other the clock of the cameras
    nothing = np.zeros_like(recorded.wrench)
    plates = recorded.wrench + sum((each.wrench for each in recorded.external if each.by_plates), nothing)
    sensors = sum((each.wrench for each in recorded.external if not each.by_plates), nothing)
    wrench, sensors = blank_incomplete(plates), blank_incomplete(sensors)
    filtered_wrench = _filter_wrench(recorded, lowpass, wrench)
    observed = moving & recorded.observed & find_complete_rows(sensors)
    return PreparedTrial(
        recorded=recorded,
        settings=settings,
        lowpass=lowpass,
        base=base,
        regressor=regressor,
        filtered=lowpass(base.columns(regressor)),
        wrench=SampledWrench(recorded.time, wrench),
        filtered_wrench=SampledWrench(recorded.time, filtered_wrench),
        sensors=sensors,
        filtered_sensors=lowpass(sensors),
        usable=find_usable(lowpass, observed, filtered_wrench, settings.offset_limit),
        prior=prior,
    )


def _filter_wrench(recorded: TrialData, lowpass: LowPass, wrench: FloatArray) -> FloatArray:
    """Return the plate wrench (T, 3), filtered like the regressor and corrected for the averaging of its samples."""
    return undo_averaging(lowpass(wrench), recorded.averaged * recorded.rate)


def find_usable(lowpass: LowPass, observed: BoolArray, filtered_wrench: FloatArray, offset_limit: float) -> BoolArray:
    """Return a mask (T,) of samples with filtered regressor, and filtered wrench at every offset up to the limit, s."""
    limit = int(np.ceil(offset_limit * lowpass.rate)) + 1
    usable = erode(observed, lowpass.reach_samples)
    return usable & erode(find_complete_rows(filtered_wrench), lowpass.reach_samples + limit)


def measure_arcs(q: FloatArray, samples: BoolArray) -> FloatArray:
    """Return the range (n,) of each joint angle over marked samples, from 2.5 to 97.5 % quantile, rad; 0 if none."""
    if not samples.any():
        return np.zeros(q.shape[1])
    low, high = np.nanquantile(q[samples], [0.025, 0.975], axis=0)
    return np.asarray(high - low, dtype=np.float64)
