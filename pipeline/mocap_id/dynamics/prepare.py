"""A trial made ready for identification: regressor, base parameters, filtered signals, usable samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base import BaseSet, base_set
from mocap_id.dynamics.clock import SampledWrench
from mocap_id.dynamics.lowpass import LowPass, cutoff_from_velocity, erode, known
from mocap_id.dynamics.regressor import planar_regressor


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
    """

    time: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    ddq_sd: FloatArray
    observed: BoolArray
    wrench: FloatArray
    centres: FloatArray

    @property
    def rate(self) -> float:
        """Samples a second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))


@dataclass(frozen=True)
class FitSettings:
    """How to identify; the defaults are the stage's.

    Parameters
    ----------
    components : tuple of int
        Rows of (Fx, Fy, tauz) to fit.
    cutoff : float or None
        Low-pass of regressor and wrench, Hz; None takes :func:`cutoff_from_velocity`.
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
    plate_zero: tuple[float, float] = (2.0, 0.5)
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
    usable : (T,) bool array
        Samples whose filtered regressor and wrench are known, the wrench at every offset within the limit.
    """

    recorded: Recorded
    settings: FitSettings
    lowpass: LowPass
    base: BaseSet
    regressor: FloatArray
    filtered: FloatArray
    wrench: SampledWrench
    filtered_wrench: SampledWrench
    usable: BoolArray

    @property
    def step(self) -> int:
        """Every how many-th sample holds all that the filtered signals say."""
        return self.lowpass.step

    @property
    def rows(self) -> FloatArray:
        """Minimal regressor Y_b (T, 3, b), unfiltered (eq. 4.7)."""
        return self.regressor[:, :, self.base.kept]


def prepare(recorded: Recorded, settings: FitSettings) -> Prepared:
    """Build the regressor, find the base parameters, filter both sides alike and mark what may be used."""
    regressor = planar_regressor(recorded.centres, recorded.q, recorded.dq, recorded.ddq, settings.gravity)
    moving = known(regressor)
    cutoff = settings.cutoff if settings.cutoff is not None else cutoff_from_velocity(recorded.dq, recorded.rate)
    lowpass = LowPass(cutoff, recorded.rate)
    selected = regressor[moving][:: lowpass.step, list(settings.components), :]
    base = base_set(selected.reshape(-1, regressor.shape[-1]))
    wrench = np.where(known(recorded.wrench)[:, None], recorded.wrench, np.nan)
    filtered_wrench = lowpass(wrench)
    limit = int(np.ceil(settings.offset_limit * recorded.rate)) + 1
    usable = erode(moving & recorded.observed, lowpass.reach_samples)
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
        usable=usable,
    )


def arcs(q: FloatArray, samples: BoolArray) -> FloatArray:
    """Arc of each joint within some samples: its 2.5 to 97.5 % range (n,), rad; 0 without samples."""
    if not samples.any():
        return np.zeros(q.shape[1])
    low, high = np.nanquantile(q[samples], [0.025, 0.975], axis=0)
    return np.asarray(high - low, dtype=np.float64)
