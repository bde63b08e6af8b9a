"""Preparation of a trial in space: regressor, base parameters, filtered signals, usable samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_complete_rows
from mocap_id.dynamics.base_parameters import BaseSet
from mocap_id.dynamics.body_prior import BodyPrior
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.dynamics.lowpass import LowPass, blank_incomplete, choose_cutoff, undo_averaging
from mocap_id.dynamics.preparation import NO_CLOCK, CoarseClock, FitSettings, find_usable
from mocap_id.dynamics.space.base_parameters import SpatialBase, structural_base
from mocap_id.dynamics.space.motion import SpatialMotion, move_segments, segment_regressor
from mocap_id.geometry import se3, so3
from mocap_id.geometry.spatial_chain import SpatialChain

COMPONENTS = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")
"""Components of a wrench in space."""
_FAST = 1 / 3  # fraction of the fastest coordinate's velocity above which a coordinate is fast
_FREE = (0, 2, 4)  # gravity along -y causes no constant Fx, Fz and tauy


@dataclass(frozen=True)
class SpatialRecord:
    """Measured motion and wrench of a trial in space, sample by sample, in the trial's frame (y up)."""

    time: FloatArray  # (T,) sample times with constant step, s
    chain: SpatialChain  # chain of n joints
    base: FloatArray  # (4, 4) pose of the base, which is at rest, m
    # (T, n, 3, 3) rotation from the frame of each moving segment to the trial's frame; NaN where missing
    rotation: FloatArray
    # omega, alpha: (T, n, 3) angular velocity and acceleration of the moving segments in the trial's axes, rad/s and
    # rad/s²
    omega: FloatArray
    alpha: FloatArray
    alpha_sd: FloatArray  # (T, n) standard deviation of the acceleration about each axis, rad/s²
    observed: BoolArray  # (T,) whether every segment is measured by markers
    # (T, 6) force and moment of the ground on the body about the origin of the trial's frame, N and N·m, at ``time`` on
    # the plate's clock; NaN where missing
    wrench: FloatArray
    averaged: float = 0.0  # time over which each plate sample is averaged, s; 0 for instantaneous samples
    # (3,) centre of the plate's surface, m; None for the origin of the base. A wrong zero of Fx causes no moment about
    # this centre.
    plate: FloatArray | None = None
    clock: CoarseClock = NO_CLOCK  # coarse clock offset of the plate

    @property
    def rate(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def centred(self) -> FloatArray:
        """Pose (4, 4) of the base in the frame of the dynamics: axes of the trial's frame, origin of the base."""
        return se3.pose(self.base[:3, :3], np.zeros(3))

    @property
    def reference(self) -> FloatArray:
        """Reference point (3,) of the moments in the fit, m: the centre of the plate."""
        return self.base[:3, 3] if self.plate is None else self.plate

    @property
    def to_plate(self) -> FloatArray:
        """Matrix (6, 6) that moves the reference point of wrenches from the trial's origin to the plate's centre."""
        return shift_wrench(-self.reference)

    @property
    def to_trial(self) -> FloatArray:
        """Inverse matrix (6, 6) of :attr:`to_plate`."""
        return shift_wrench(self.reference)

    @property
    def plate_wrench(self) -> FloatArray:
        """Wrench (T, 6) about the plate's centre, NaN in all components if any is missing."""
        return blank_incomplete(self.wrench @ self.to_plate.T)

    def regressor(self, motion: SpatialMotion, frames: FloatArray, gravity: float) -> FloatArray:
        """Return the regressor (T, 6, 10K) of the wrench about the plate's centre.

        ``frames`` (K, 4, 4) are the frames of the parameters, as poses in the segments' frames.
        """
        return shift_wrench(self.base[:3, 3] - self.reference) @ segment_regressor(motion.in_frames(frames), gravity)

    @cached_property
    def motion(self) -> SpatialMotion:
        """Motion of the segments in the frame of the dynamics."""
        return move_segments(self.chain, self.centred, self.rotation, self.omega, self.alpha)


@dataclass(frozen=True)
class SpatialTrial:
    """A trial in space prepared for identification; moments are about the plate's centre."""

    recorded: SpatialRecord  # measured motion and wrench
    settings: FitSettings  # settings of the identification
    lowpass: LowPass  # filter of regressor and wrench
    structure: SpatialBase  # base parameters of the chain
    # (T, 6, 10K) full regressor in the simple frames (`structure`), without filtering; NaN where a pose is NaN
    regressor: FloatArray
    filtered: FloatArray  # (T, 6, b) base columns after the low-pass
    filtered_wrench: SampledWrench  # filtered wrench, at times of the plate's clock
    usable: BoolArray  # (T,) samples with filtered regressor, and with filtered wrench at every offset within the limit
    prior: BodyPrior | None = None  # always None, because there is no prior in space

    @property
    def base(self) -> BaseSet:
        """Base parameters in the simple frames."""
        return self.structure.base

    @property
    def rows(self) -> FloatArray:
        """Minimal regressor (T, 6, b), unfiltered (eq. 4.7)."""
        return self.regressor[:, :, self.base.kept]

    @property
    def constants(self) -> tuple[int, ...]:
        """Components whose constant error is estimated: Fx, Fz and tauy, which gravity does not affect."""
        return _FREE if self.settings.plate_bias else ()

    def filtered_measured(self, samples: IntArray, stamped: FloatArray) -> FloatArray:
        """Return the filtered wrench (..., R, 6) at times (..., R) on the plates' clock, s; ``samples`` is not used."""
        return self.filtered_wrench(stamped)

    def measured(self, offset: float) -> FloatArray:
        """Return the wrench (T, 6) about the plate's centre at the cameras' times, for a plate's clock offset, s."""
        sampled = SampledWrench.of(self.recorded.time, self.recorded.plate_wrench)
        return sampled(self.recorded.time - offset)

    def build_rows(self, motion: SpatialMotion, gravity: float) -> FloatArray:
        """Return the minimal regressor (T, 6, b) for any motion of the segments."""
        return self.recorded.regressor(motion, self.structure.frames, gravity)[:, :, self.base.kept]


def prepare(recorded: SpatialRecord, settings: FitSettings) -> SpatialTrial:
    """Build the regressor, find the base parameters, filter regressor and wrench, and mark the usable samples.

    ``settings.components`` must contain the indices of all six :data:`COMPONENTS`.
    """
    structure = structural_base(recorded.chain, recorded.centred)
    regressor = recorded.regressor(recorded.motion, structure.frames, settings.gravity)
    cutoff = settings.cutoff or choose_cutoff(_find_fast_velocities(recorded), recorded.rate)
    lowpass = LowPass(cutoff, recorded.rate)
    filtered_wrench = undo_averaging(lowpass(recorded.plate_wrench), recorded.averaged * recorded.rate)
    observed = find_complete_rows(regressor) & recorded.observed
    return SpatialTrial(
        recorded=recorded,
        settings=settings,
        lowpass=lowpass,
        structure=structure,
        regressor=regressor,
        filtered=lowpass(regressor[:, :, structure.base.kept]),
        filtered_wrench=SampledWrench.of(recorded.time, filtered_wrench),
        usable=find_usable(lowpass, observed, filtered_wrench, settings.offset_limit),
    )


def shift_wrench(arm: FloatArray) -> FloatArray:
    """Return the matrix (6, 6) that adds arm × force to the moment of a wrench, for an arm (3,), m."""
    matrix = np.eye(6)
    matrix[3:, :3] = so3.hat(arm)
    return matrix


def _find_fast_velocities(recorded: SpatialRecord) -> FloatArray:
    """Return the velocities (T, c), rad/s, of the c fast coordinates; the spectrum of slow ones contains only noise."""
    motion, joints = recorded.motion, recorded.chain.joints
    relative = motion.omega[:, 1:] - motion.omega[:, [joint.parent for joint in joints]]
    each = np.repeat(relative, [joint.dimension for joint in joints], axis=1)
    speeds = np.sum(each * motion.axis, axis=2)
    size = np.nanstd(speeds, axis=0)
    return np.asarray(speeds[:, size >= _FAST * size.max()])
