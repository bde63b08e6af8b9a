"""Preparation of a trial for identification: regressor, base parameters, filtered signals, usable samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base_parameters import BaseSet, base_set, every_parameter
from mocap_id.dynamics.body_prior import BodyPrior
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.dynamics.external_wrenches import SEAT, ExternalWrench
from mocap_id.dynamics.lowpass import LowPass, cutoff_from_velocity, erode, known, undo_averaging
from mocap_id.dynamics.motion import PlanarMotion, chain_motion
from mocap_id.dynamics.regressor import wrench_regressor

MEASURED_CUTOFF = 5.0
"""Cut-off of regressor and wrench for measured poses, Hz: people move below it, and the poses are already filtered."""


@dataclass(frozen=True)
class TrialData:
    """Measured states and wrenches of a trial, sample by sample.

    Parameters
    ----------
    time : (T,) array
        Even steps, s.
    q, dq, ddq : (T, n) arrays
        Joint angles and derivatives, rad; NaN where unknown.
    ddq_sd : (T, n) array
        Standard deviation of the accelerations, rad/s².
    observed : (T,) bool array
        Whether every angle is measured by markers.
    wrench : (T, 3) array
        (Fx, Fy, tauz) of the ground on the body in the plane frame, N and N·m, at the times of the plate's clock; NaN
        where unknown.
    centres : (n, 2) array
        Centre of each joint in the frame of the segment before it, m.
    external : tuple of ExternalWrench
        Measured wrenches on the body other than the ground's.
    averaged : float
        Time over which each plate sample is averaged, s; 0 for instantaneous samples.
    measured : PlanarMotion or None
        Motion of the bodies from their own measured poses; None to use that of the pinned chain.
    knee : int
        Number of the knee among the joints, from 0.
    measures : tuple of int
        Components of ``wrench`` that the ground's sensor measures; the others are 0 there.
    surface : float
        Height above the plane's origin at which the centre of pressure is stated, m; 0 for plates.
    position_sd : float or None
        Standard deviation of the sensor's place along the motion, m, if it was found from the trial.
    built_in : tuple of ExternalWrench
        Wrenches measured inside the body, by sensors built into joints, on the segment beyond the joint.
    """

    time: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    ddq_sd: FloatArray
    observed: BoolArray
    wrench: FloatArray
    centres: FloatArray
    external: tuple[ExternalWrench, ...] = ()
    averaged: float = 0.0
    measured: PlanarMotion | None = None
    knee: int = 1
    measures: tuple[int, ...] = (0, 1, 2)
    surface: float = 0.0
    position_sd: float | None = None
    built_in: tuple[ExternalWrench, ...] = ()

    def as_measured(self, wrench: FloatArray) -> FloatArray:
        """Return a wrench (..., 3) with NaN in the components that are not measured."""
        return wrench if len(self.measures) == wrench.shape[-1] else np.where(self._measured, wrench, np.nan)

    @property
    def _measured(self) -> BoolArray:
        return np.isin(np.arange(3), self.measures)

    @property
    def motion(self) -> PlanarMotion:
        """The measured motion if there is one, otherwise that of the pinned chain."""
        return self.measured or chain_motion(self.centres, self.q, self.dq, self.ddq)

    @property
    def rate(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def seat(self) -> ExternalWrench | None:
        """The chair's wrench if a plate of its own measures it."""
        return next((each for each in self.external if each.name == SEAT), None)

    @property
    def plates(self) -> FloatArray:
        """Sum (T, 3) of all wrenches that follow the plates' clock."""
        return self.wrench + self._sum(each for each in self.external if each.by_plates)

    @property
    def sensors(self) -> FloatArray:
        """Sum (T, 3) of the wrenches that follow the cameras' clock; zeros if there are none."""
        return self._sum(each for each in self.external if not each.by_plates)

    @property
    def elsewhere(self) -> FloatArray:
        """Sum (T, 3) of all wrenches but the ground's, without correction of the clock offset."""
        return self._sum(self.external)

    @property
    def surroundings(self) -> FloatArray:
        """Sum (T, 3) of all wrenches, without correction of the clock offset."""
        return self.wrench + self.elsewhere

    def _sum(self, external: Iterable[ExternalWrench]) -> FloatArray:
        return sum((each.wrench for each in external), np.zeros_like(self.wrench))


@dataclass(frozen=True)
class FitSettings:
    """Settings of the identification; the defaults are those of the stage.

    Parameters
    ----------
    components : tuple of int
        Rows of (Fx, Fy, tauz) to fit.
    cutoff : float or None
        Low-pass of regressor and wrench, Hz; None for :func:`cutoff_from_velocity`, or 5 Hz for measured poses.
    offset_limit : float
        Largest clock offset that is searched, in both directions, s.
    apply_offset : bool
        Correct the wrench for the clock offset found.
    plate_bias : bool
        Estimate a constant error of the plate's Fx.
    plate_zero : (float, float)
        Standard deviation of the plate's constant errors in Fy, N, and tauz, N·m. No movement separates these from the
        first two base parameters.
    block : float
        Length of the blocks between which residuals count as independent, s.
    gravity : float
        m/s².
    """

    components: tuple[int, ...] = (0, 1, 2)
    cutoff: float | None = None
    offset_limit: float = 0.15
    apply_offset: bool = True
    plate_bias: bool = True
    plate_zero: tuple[float, float] = (3.0, 0.5)
    block: float = 1.0
    gravity: float = 9.81


@dataclass(frozen=True)
class PreparedTrial:
    """A trial prepared for identification.

    Parameters
    ----------
    recorded : TrialData
    settings : FitSettings
    lowpass : LowPass
    base : BaseSet
        Base parameters that the motion determines.
    regressor : (T, 3, 4(n + 1)) array
        Full regressor without filtering; NaN where a state is.
    filtered : (T, 3, b) array
        Base columns after the low-pass.
    wrench, filtered_wrench : SampledWrench
        Sum of all plates, at the times of their clock; in the filtered one, the averaging of the samples is undone.
    sensors, filtered_sensors : (T, 3) arrays
        Sum of all other sensors, at the times of the cameras' clock.
    usable : (T,) bool array
        Samples with a known filtered regressor and a known filtered wrench at every offset within the limit.
    prior : BodyPrior or None
        Prior of the full parameters. With a prior, all full parameters are fitted and ``base`` keeps every column.
    """

    recorded: TrialData
    settings: FitSettings
    lowpass: LowPass
    base: BaseSet
    regressor: FloatArray
    filtered: FloatArray
    wrench: SampledWrench
    filtered_wrench: SampledWrench
    sensors: FloatArray
    filtered_sensors: FloatArray
    usable: BoolArray
    prior: BodyPrior | None = None

    @property
    def step(self) -> int:
        """Step between samples that preserves the information of the filtered signals."""
        return self.lowpass.step

    @property
    def constants(self) -> tuple[int, ...]:
        """Components whose constant error is estimated: Fx, in which gravity causes no constant."""
        return (0,) if self.settings.plate_bias and 0 in self.settings.components else ()

    @cached_property
    def motion(self) -> PlanarMotion:
        """The motion that the regressor is computed from."""
        return self.recorded.motion

    @cached_property
    def rows(self) -> FloatArray:
        """Minimal regressor Y_b (T, 3, b), unfiltered (eq. 4.7)."""
        return self.base.columns(self.regressor)

    def measured(self, offset: float) -> FloatArray:
        """Return the total wrench (T, 3) at the markers' times, for a clock offset of the plates, s."""
        return self.recorded.as_measured(self.wrench(self.recorded.time - offset) + self.sensors)

    def ground(self, offset: float) -> FloatArray:
        """Return the ground's wrench (T, 3) at the markers' times, for a clock offset of the plates, s."""
        return self.recorded.as_measured(self._ground(self.recorded.time - offset))

    @cached_property
    def _ground(self) -> SampledWrench:
        return SampledWrench.of(self.recorded.time, _whole(self.recorded.wrench))

    def external(self, offset: float, filtered: bool = False) -> list[FloatArray]:
        """Return every external wrench (T, 3) at the markers' times, for a clock offset of the plates, s."""
        time = self.recorded.time
        wrenches = []
        for each in self.recorded.external:
            wrench = _whole(each.wrench)
            if filtered:
                wrench = _filtered(self.recorded, self.lowpass, wrench) if each.by_plates else self.lowpass(wrench)
            wrenches.append(SampledWrench.of(time, wrench)(time - offset) if each.by_plates else wrench)
        return wrenches

    def elsewhere(self, offset: float) -> FloatArray:
        """Return the sum (T, 3) of the external wrenches, as :meth:`external`."""
        return sum(self.external(offset), np.zeros_like(self.recorded.wrench))

    def filtered_measured(self, samples: IntArray, stamped: FloatArray) -> FloatArray:
        """Return the filtered total wrench (..., R, 3) of samples (R,) with times (..., R) on the plates' clock, s."""
        return self.recorded.as_measured(self.filtered_wrench(stamped) + self.filtered_sensors[samples])


def prepare(recorded: TrialData, settings: FitSettings, prior: BodyPrior | None = None) -> PreparedTrial:
    """Build the regressor, find the base parameters, filter regressor and wrench, and mark the usable samples.

    Parameters
    ----------
    recorded : TrialData
    settings : FitSettings
    prior : BodyPrior, optional
        Prior of the full parameters, all of which are then fitted.
    """
    regressor = wrench_regressor(recorded.motion, settings.gravity)
    moving = known(regressor)
    lowpass = LowPass(_cutoff(recorded, settings), recorded.rate)
    if prior is None:
        selected = regressor[moving][:: lowpass.step, list(settings.components), :]
        base = base_set(selected.reshape(-1, regressor.shape[-1]))
    else:
        base = every_parameter(regressor.shape[-1])
    wrench, sensors = _whole(recorded.plates), _whole(recorded.sensors)
    filtered_wrench = _filtered(recorded, lowpass, wrench)
    limit = int(np.ceil(settings.offset_limit * recorded.rate)) + 1
    usable = erode(moving & recorded.observed & known(sensors), lowpass.reach_samples)
    usable &= erode(known(filtered_wrench), lowpass.reach_samples + limit)
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
        usable=usable,
        prior=prior,
    )


def _cutoff(recorded: TrialData, settings: FitSettings) -> float:
    if settings.cutoff is not None:
        return settings.cutoff
    if recorded.measured is not None:
        return min(MEASURED_CUTOFF, recorded.rate / 5)
    return cutoff_from_velocity(recorded.dq, recorded.rate)


def _filtered(recorded: TrialData, lowpass: LowPass, wrench: FloatArray) -> FloatArray:
    """Return the plate wrench (T, 3) filtered like the regressor, with the averaging of its samples undone."""
    return undo_averaging(lowpass(wrench), recorded.averaged * recorded.rate)


def _whole(wrench: FloatArray) -> FloatArray:
    """Return a wrench (T, 3) with NaN in all components of a sample if any is unknown."""
    return np.where(known(wrench)[:, None], wrench, np.nan)


def arcs(q: FloatArray, samples: BoolArray) -> FloatArray:
    """Return the arc (n,) of each joint over some samples, from the 2.5 to the 97.5 % quantile, rad; 0 if empty."""
    if not samples.any():
        return np.zeros(q.shape[1])
    low, high = np.nanquantile(q[samples], [0.025, 0.975], axis=0)
    return np.asarray(high - low, dtype=np.float64)
