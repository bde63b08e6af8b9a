"""A trial made ready for identification: regressor, base parameters, filtered signals, usable samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base import BaseSet, base_set, every_parameter
from mocap_id.dynamics.clock import SampledWrench
from mocap_id.dynamics.external import SEAT, External
from mocap_id.dynamics.loose_prior import BodyPrior
from mocap_id.dynamics.lowpass import LowPass, cutoff_from_velocity, erode, known, restored
from mocap_id.dynamics.motion import Motion, chain_motion
from mocap_id.dynamics.regressor import wrench_regressor

MEASURED_CUTOFF = 5.0
"""Hz, of regressor and wrench on measured poses: people move below, and the poses were filtered before."""


@dataclass(frozen=True)
class Recorded:
    """What cameras and plate say, sample by sample.

    Parameters
    ----------
    time : (T,) array
        s, even steps.
    q, dq, ddq : (T, n) arrays
        Joint angles and derivatives, rad; NaN where unknown.
    ddq_sd : (T, n) array
        Standard deviation of the accelerations, rad/s².
    observed : (T,) bool array
        Every angle rests on markers.
    wrench : (T, 3) array
        (Fx, Fy, tauz) of the ground on the body, plane frame, N and N·m, as stamped by the plate's clock; NaN where
        unknown.
    centres : (n, 2) array
        Joint centres in the segment before, m.
    external : tuple of External
        Measured wrenches of other surroundings than the ground on the body.
    averaged : float
        Every sample of the plates is a mean over so long, s; 0 where it is a moment's.
    measured : Motion or None
        Motion of the bodies from their own measured poses; None for that of the pinned chain.
    """

    time: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    ddq_sd: FloatArray
    observed: BoolArray
    wrench: FloatArray
    centres: FloatArray
    external: tuple[External, ...] = ()
    averaged: float = 0.0
    measured: Motion | None = None

    @property
    def motion(self) -> Motion:
        """The motion that the wrench belongs to: the measured one where there is one, else the chain's."""
        return self.measured or chain_motion(self.centres, self.q, self.dq, self.ddq)

    @property
    def rate(self) -> float:
        """Samples a second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def seat(self) -> External | None:
        """The chair's wrench, where a plate of its own measures it."""
        return next((each for each in self.external if each.name == SEAT), None)

    @property
    def plates(self) -> FloatArray:
        """(T, 3) wrench of everything that the plates' clock stamps."""
        return self.wrench + self._sum(each for each in self.external if each.by_plates)

    @property
    def sensors(self) -> FloatArray:
        """(T, 3) wrench of everything else: zeros where the plates measure all."""
        return self._sum(each for each in self.external if not each.by_plates)

    @property
    def elsewhere(self) -> FloatArray:
        """(T, 3) wrench of all surroundings but the ground, as stamped."""
        return self._sum(self.external)

    @property
    def surroundings(self) -> FloatArray:
        """(T, 3) wrench of all surroundings together, as stamped."""
        return self.wrench + self.elsewhere

    def _sum(self, external: Iterable[External]) -> FloatArray:
        return sum((each.wrench for each in external), np.zeros_like(self.wrench))


@dataclass(frozen=True)
class FitSettings:
    """How to identify; the defaults are the stage's.

    Parameters
    ----------
    components : tuple of int
        Rows of (Fx, Fy, tauz) to fit.
    cutoff : float or None
        Low-pass of regressor and wrench, Hz; None takes :func:`cutoff_from_velocity`, for measured poses 5 Hz.
    offset_limit : float
        Clock offsets up to ± this are tried, s.
    apply_offset : bool
        Take the offset that was found out of the wrench.
    plate_bias : bool
        Estimate a constant error of the plate's Fx.
    plate_zero : (float, float)
        Standard deviation of the plate's constant errors in Fy, N, and tauz, N·m: a part of the first two base
        parameters that no movement can tell from them.
    block : float
        Length of the blocks that residuals are taken as independent between, s.
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
class Prepared:
    """A trial made ready.

    Parameters
    ----------
    recorded : Recorded
    settings : Settings
    lowpass : LowPass
    base : BaseSet
        Of the samples that are usable.
    regressor : (T, 3, 4(n + 1)) array
        Full and unfiltered; NaN where the states are.
    filtered : (T, 3, b) array
        Base columns after the low-pass.
    wrench, filtered_wrench : SampledWrench
        What the plates read together, on their clock; the filtered one without what averaging took off its peaks.
    sensors, filtered_sensors : (T, 3) arrays
        What other sensors read, on the cameras' clock.
    usable : (T,) bool array
        Samples whose filtered regressor and wrench are known, the wrench at every offset within the limit.
    prior : BodyPrior or None
        Of the full parameters, all of which are then fitted: ``base`` keeps every column.
    """

    recorded: Recorded
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
        """Every how many-th sample holds all that the filtered signals say."""
        return self.lowpass.step

    @cached_property
    def motion(self) -> Motion:
        """The motion that the regressor was built from."""
        return self.recorded.motion

    @cached_property
    def rows(self) -> FloatArray:
        """Minimal regressor Y_b (T, 3, b), unfiltered (eq. 4.7)."""
        return self.regressor[:, :, self.base.kept]

    def measured(self, offset: float) -> FloatArray:
        """Wrench (T, 3) of all surroundings at the markers' times, for a clock offset of the plates, s."""
        return self.wrench(self.recorded.time - offset) + self.sensors

    def ground(self, offset: float) -> FloatArray:
        """Wrench (T, 3) of the ground alone at the markers' times, for a clock offset of the plates, s."""
        return self._ground(self.recorded.time - offset)

    @cached_property
    def _ground(self) -> SampledWrench:
        return SampledWrench.of(self.recorded.time, _whole(self.recorded.wrench))

    def external(self, offset: float, filtered: bool = False) -> list[FloatArray]:
        """Every external wrench (T, 3) at the markers' times, for a clock offset of the plates, s."""
        time = self.recorded.time
        wrenches = []
        for each in self.recorded.external:
            wrench = _whole(each.wrench)
            if filtered:
                wrench = _filtered(self.recorded, self.lowpass, wrench) if each.by_plates else self.lowpass(wrench)
            wrenches.append(SampledWrench.of(time, wrench)(time - offset) if each.by_plates else wrench)
        return wrenches

    def elsewhere(self, offset: float) -> FloatArray:
        """Wrench (T, 3) of all surroundings but the ground, as :meth:`external`."""
        return sum(self.external(offset), np.zeros_like(self.recorded.wrench))

    def filtered_measured(self, samples: IntArray, stamped: FloatArray) -> FloatArray:
        """Filtered wrench (..., R, 3) of all surroundings at samples (R,), by the plates' clock at (..., R), s."""
        return self.filtered_wrench(stamped) + self.filtered_sensors[samples]


def prepare(recorded: Recorded, settings: FitSettings, prior: BodyPrior | None = None) -> Prepared:
    """Build the regressor, find the base parameters, filter both sides alike and mark what may be used.

    Parameters
    ----------
    recorded : Recorded
    settings : FitSettings
    prior : BodyPrior, optional
        Of the full parameters; with it all of them are fitted, not the base parameters alone.
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
    return Prepared(
        recorded=recorded,
        settings=settings,
        lowpass=lowpass,
        base=base,
        regressor=regressor,
        filtered=lowpass(regressor[:, :, base.kept]),
        wrench=SampledWrench.of(recorded.time, wrench),
        filtered_wrench=SampledWrench.of(recorded.time, filtered_wrench),
        sensors=sensors,
        filtered_sensors=lowpass(sensors),
        usable=usable,
        prior=prior,
    )


def _cutoff(recorded: Recorded, settings: FitSettings) -> float:
    """Of the low-pass, Hz."""
    if settings.cutoff is not None:
        return settings.cutoff
    if recorded.measured is not None:
        return min(MEASURED_CUTOFF, recorded.rate / 5)
    return cutoff_from_velocity(recorded.dq, recorded.rate)


def _filtered(recorded: Recorded, lowpass: LowPass, wrench: FloatArray) -> FloatArray:
    """What plates measure (T, 3), filtered as the regressor is, whose samples are no means."""
    return restored(lowpass(wrench), recorded.averaged * recorded.rate)


def _whole(wrench: FloatArray) -> FloatArray:
    """A wrench (T, 3) of which a sample is known as a whole or not at all."""
    return np.where(known(wrench)[:, None], wrench, np.nan)


def arcs(q: FloatArray, samples: BoolArray) -> FloatArray:
    """Arc of each joint within some samples: its 2.5 to 97.5 % range (n,), rad; 0 without samples."""
    if not samples.any():
        return np.zeros(q.shape[1])
    low, high = np.nanquantile(q[samples], [0.025, 0.975], axis=0)
    return np.asarray(high - low, dtype=np.float64)
