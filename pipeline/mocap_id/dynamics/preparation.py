"""Preparation of a trial for identification: regressor, base parameters, filtered signals, usable samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_complete_rows
from mocap_id.dynamics.base_parameters import BaseSet, keep_all_parameters, regroup_columns
from mocap_id.dynamics.body_prior import BodyPrior
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.dynamics.external_wrenches import SEAT, ExternalWrench
from mocap_id.dynamics.lowpass import LowPass, blank_incomplete, choose_cutoff, erode, undo_averaging
from mocap_id.dynamics.motion import PlanarMotion, move_chain
from mocap_id.dynamics.regressor import wrench_regressor

if TYPE_CHECKING:
    from mocap_id.dynamics.space.preparation import SpatialTrial

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
"""No coarse clock offset."""


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
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def seat(self) -> ExternalWrench | None:
        """The chair's wrench if a separate plate measures it, otherwise None."""
        return next((each for each in self.external if each.name == SEAT), None)

    @property
    def plates(self) -> FloatArray:
        """Sum (T, 3) of all wrenches that follow the clock of the plates."""
        return self.wrench + self._sum(each for each in self.external if each.by_plates)

    @property
    def sensors(self) -> FloatArray:
        """Sum (T, 3) of the wrenches that follow the clock of the cameras; zeros if there are none."""
        return self._sum(each for each in self.external if not each.by_plates)

    @property
    def elsewhere(self) -> FloatArray:
        """Sum (T, 3) of all wrenches except the ground's, without correction of the clock offset."""
        return self._sum(self.external)

    @property
    def surroundings(self) -> FloatArray:
        """Sum (T, 3) of all wrenches, without correction of the clock offset."""
        return self.wrench + self.elsewhere

    def _sum(self, external: Iterable[ExternalWrench]) -> FloatArray:
        return sum((each.wrench for each in external), np.zeros_like(self.wrench))


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
    plate_zero: tuple[float, float] = (3.0, 0.5)
    block: float = 1.0  # length of the blocks between which residuals count as independent, s
    gravity: float = 9.81  # gravitational acceleration, m/s²


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
        """The motion from which the regressor is computed."""
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
        return SampledWrench.of(self.recorded.time, blank_incomplete(self.recorded.wrench))

    def external(self, offset: float, filtered: bool = False) -> list[FloatArray]:
        """Return every external wrench (T, 3) at the cameras' times, for a clock offset of the plates, s.

        With ``filtered``, the wrenches are filtered like the regressor.
        """
        time = self.recorded.time
        wrenches = []
        for each in self.recorded.external:
            wrench = blank_incomplete(each.wrench)
            if filtered:
                wrench = _filter_wrench(self.recorded, self.lowpass, wrench) if each.by_plates else self.lowpass(wrench)
            wrenches.append(SampledWrench.of(time, wrench)(time - offset) if each.by_plates else wrench)
        return wrenches

    def elsewhere(self, offset: float) -> FloatArray:
        """Return the sum (T, 3) of the external wrenches at the cameras' times, for a clock offset of the plates, s."""
        return sum(self.external(offset), np.zeros_like(self.recorded.wrench))

    def filtered_measured(self, samples: IntArray, stamped: FloatArray) -> FloatArray:
        """Return the filtered total wrench (..., R, 3) of samples (R,) at times (..., R) on the plates' clock, s."""
        return self.recorded.as_measured(self.filtered_wrench(stamped) + self.filtered_sensors[samples])


def prepare(recorded: TrialData, settings: FitSettings, prior: BodyPrior | None = None) -> PreparedTrial:
    """Build the regressor, find the base parameters, filter regressor and wrench, and mark the usable samples.

    With a prior, all full parameters are fitted instead of the base parameters.
    """
    regressor = wrench_regressor(recorded.motion, settings.gravity)
    moving = find_complete_rows(regressor)
    lowpass = LowPass(_choose_cutoff(recorded, settings), recorded.rate)
    if prior is None:
        selected = regressor[moving][:: lowpass.step, list(settings.components), :]
        base = regroup_columns(selected.reshape(-1, regressor.shape[-1]))
    else:
        base = keep_all_parameters(regressor.shape[-1])
    wrench, sensors = blank_incomplete(recorded.plates), blank_incomplete(recorded.sensors)
    filtered_wrench = _filter_wrench(recorded, lowpass, wrench)
    observed = moving & recorded.observed & find_complete_rows(sensors)
    return PreparedTrial(
        recorded=recorded,
        settings=settings,
        lowpass=lowpass,
        base=base,
        regressor=regressor,
        filtered=lowpass(base.columns(regressor)),
        wrench=SampledWrench.of(recorded.time, wrench),
        filtered_wrench=SampledWrench.of(recorded.time, filtered_wrench),
        sensors=sensors,
        filtered_sensors=lowpass(sensors),
        usable=find_usable(lowpass, observed, filtered_wrench, settings.offset_limit),
        prior=prior,
    )


def _choose_cutoff(recorded: TrialData, settings: FitSettings) -> float:
    """Return the cut-off of regressor and wrench, Hz."""
    if settings.cutoff is not None:
        return settings.cutoff
    if recorded.measured is not None:
        return min(MEASURED_CUTOFF, recorded.rate / 5)
    return choose_cutoff(recorded.dq, recorded.rate)


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
