"""Schema of ``dynamics`` in ``summary.json``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.results import Result


class BaseEntry(Result):
    """A base parameter and its uncertainty.

    ``verdict`` compares the standard deviation with the size of the parameter (``relative_sd``). ``excitation`` is the
    norm of the part of its regressor column that is independent of all other columns, in standard deviations of the
    residual per SI unit; ``own_share`` is this norm divided by the norm of the whole column. ``helps`` is the movement
    that would reduce the standard deviation most, and ``sd_ratio`` the resulting standard deviation divided by the
    present one; 1 if no tested movement helps. Both are null if every parameter is known, because no movement is tested
    then. ``prior_share`` is the fraction of the precision that comes from the loose prior (0 with the pinned chain).
    """

    name: str
    value: float | None
    sd: float | None
    unit: str
    verdict: Literal["known", "weak", "not identifiable"] | None
    relative_sd: float | None
    excitation: float | None
    own_share: float | None
    helps: str | None
    sd_ratio: float | None
    prior_share: float | None
    why: str | None


class ChannelEntry(Result):
    """Error of a model or measurement in one component, such as Fx, over the samples of the entry that contains it."""

    bias: float | None
    sd: float | None
    r2: float | None
    why: str | None


class RivalEntry(Result):
    """Errors of an allometric body on the same chain, over the samples of the fit, else over all samples off the seat.

    ``assumed`` lists the assumptions about height, mass and sex.
    """

    height_m: float | None
    mass_kg: float | None
    assumed: list[str]
    wrench: dict[str, ChannelEntry]
    cop_rms_m: float | None
    why: str | None


class HeldOutEntry(Result):
    """Prediction errors for left-out repetitions, by models fitted without them; all are over the same samples.

    ``samples``, ``repetitions`` and ``folds`` are the numbers of samples, repetitions and models. Each model leaves out
    one repetition, or several neighbours if there are more than five. Errors are those of Fx, Fy (N), tauz (N·m) and
    cop_x (m): ``model`` by these models, ``in_sample`` by the model of the whole trial, ``reference`` by the allometric
    body (null without such a body). With measured poses, these three are computed after the low-pass of the fit.
    ``unfiltered`` is the error of ``model`` against the unfiltered wrench, and ``inside`` the fraction of samples in
    95 % intervals derived from the other repetitions. ``clock_offset_s`` lists the clock offset of each model.
    """

    repetitions: int | None
    folds: int | None
    samples: int | None
    model: dict[str, ChannelEntry] | None
    unfiltered: dict[str, ChannelEntry] | None
    in_sample: dict[str, ChannelEntry] | None
    reference: dict[str, ChannelEntry] | None
    clock_offset_s: list[float] | None
    inside: dict[str, float] | None
    why: str | None


class GapEntry(Result):
    """Gap between the two sides of a joint and its acceleration below 3 Hz, both rms; whether the joint is pinned."""

    gap_m: float | None
    acceleration_m_s2: float | None
    pinned: bool
    why: str | None


class MotionEntry(Result):
    """Motion of the masses: the pinned ``chain`` or the measured poses of ``segments``; ``why`` says why it was chosen.

    ``bands_hz`` are the cut-off frequencies for x, y and angle of the measured poses, ``bodies`` the names of the
    bodies and ``prior`` the source of the loose prior. ``bodies_condition_number`` is the condition number of the
    regressor with all parameters of all bodies, without the prior, in SI units and with unit-norm columns
    (``_scaled``). It is not comparable with ``condition_number`` of the chain. All of these are null for the chain.
    ``joints`` is null if the gaps of the joints were not measured.
    """

    source: Literal["chain", "segments"]
    why: str
    bands_hz: dict[str, float] | None
    bands_why: str | None
    bodies: list[str] | None
    prior: str | None
    bodies_condition_number: float | None
    bodies_condition_number_scaled: float | None
    joints: dict[str, GapEntry] | None


class PredictedEntry(Result):
    """Errors of predictions of left-out repetitions."""

    wrench: dict[str, ChannelEntry]
    cop_rms_m: float | None
    why: str | None


class PinsEntry(Result):
    """Prediction errors with and without pinned joints, on the same left-out samples and after the same low-pass.

    ``chain`` has the errors with pinned joints, ``segments`` those with measured poses; ``samples`` counts the samples.
    ``clock_offset_s`` is the clock offset of the pinned chain. All values are null if the dynamics use that chain.
    """

    samples: int | None
    chain: PredictedEntry | None
    segments: PredictedEntry | None
    clock_offset_s: float | None
    why: str | None


class TorqueEntry(Result):
    """Largest torque of a joint in each direction, in samples in which only measured forces carry the body.

    ``positive`` and ``negative`` name the movement towards which a torque of this sign acts, such as extension; they
    are "positive" and "negative" if the joint has no anatomical name. ``highest`` is the largest torque and ``lowest``
    the smallest, with standard deviation and time, and divided by ``mass_kg``, the mass of the standing person or, if
    unknown, the identified mass. Samples with a standard deviation above twice the median are left out. ``known`` is
    the fraction of samples with a torque.
    """

    positive: str
    negative: str
    highest_nm: float | None
    highest_sd_nm: float | None
    highest_nm_per_kg: float | None
    highest_time_s: float | None
    lowest_nm: float | None
    lowest_sd_nm: float | None
    lowest_nm_per_kg: float | None
    lowest_time_s: float | None
    mass_kg: float | None
    known: float
    why: str | None


class DynamicsEntry(Result):
    """Results of the identification; ``mass_kg`` and ``cop_mean_m`` come from the plates alone.

    ``wrench`` and ``cop_rms_m`` are errors over the samples of the fit, ``held_out`` the errors on left-out
    repetitions. ``condition_number`` belongs to the regressor of the chain's base parameters (eq. 6.1) over the samples
    of the fit, also where the bodies move as measured. ``consistency`` is the set of bodies considered physically
    consistent. ``rivals`` contains the reference bodies by the names of their allometric tables; empty if no table
    applies. ``motion`` describes the motion of the masses, and ``pins`` the effect of pinned joints. ``legs`` is "both"
    if wrench and torques are sums over both legs of a person, else "none". ``torques`` has an entry for each joint in
    the plane; it is empty without a model.
    """

    base: list[BaseEntry] | None
    condition_number: float | None
    condition_number_scaled: float | None
    clock_offset_s: float | None
    clock_offset_sd_s: float | None
    wrench: dict[str, ChannelEntry] | None
    cop_rms_m: float | None
    samples: int | None
    mass_kg: float | None
    cop_mean_m: float | None
    consistency: Literal["grid", "cone", "bounded-cone"] | None
    rivals: dict[str, RivalEntry]
    held_out: HeldOutEntry
    motion: MotionEntry | None
    pins: PinsEntry
    legs: Literal["both", "none"] = "none"
    torques: dict[str, TorqueEntry] = Field({})
    why: str | None
