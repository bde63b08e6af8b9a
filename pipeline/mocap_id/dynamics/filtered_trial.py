"""The parts of a prepared trial that the fit reads, in the plane or in space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from mocap_id.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from mocap_id.dynamics.body_prior import BodyPrior
    from mocap_id.dynamics.clock_offset import SampledWrench
    from mocap_id.dynamics.lowpass import LowPass
    from mocap_id.dynamics.preparation import FitSettings


class Sampled(Protocol):
    """Times of a trial's samples."""

    @property
    def time(self) -> FloatArray:
        """Sample times (T,) with constant step, s."""

    @property
    def rate(self) -> float:
        """Samples per second."""


class FilteredTrial(Protocol):
    """Filtered regressor and wrench of c components, with the usable samples."""

    @property
    def recorded(self) -> Sampled: ...

    @property
    def settings(self) -> FitSettings: ...

    @property
    def lowpass(self) -> LowPass: ...

    @property
    def filtered(self) -> FloatArray:
        """Columns (T, c, b) of the fitted parameters after the low-pass."""

    @property
    def filtered_wrench(self) -> SampledWrench: ...

    @property
    def usable(self) -> BoolArray: ...

    @property
    def prior(self) -> BodyPrior | None: ...

    @property
    def constants(self) -> tuple[int, ...]:
        """Components whose constant error is estimated: those in which gravity causes no constant."""

    def filtered_measured(self, samples: IntArray, stamped: FloatArray) -> FloatArray:
        """Return the filtered wrench (..., R, c) of samples (R,) at times (..., R) on the plates' clock, s."""
