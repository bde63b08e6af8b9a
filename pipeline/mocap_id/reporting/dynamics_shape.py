"""The shape of ``dynamics`` in ``summary.json``."""

from __future__ import annotations

from typing import Literal

from mocap_id.reporting.entry import Entry


class BaseEntry(Entry):
    """A base parameter, and how well it is known.

    ``verdict`` compares the standard deviation with the parameter's size (``relative_sd``); ``excitation`` is the norm
    of the part of its column that no other column can imitate, in standard deviations of the residual for one SI unit,
    ``own_share`` that part's share of the column. ``helps`` is the movement that would tell most more of it, and
    ``sd_ratio`` the standard deviation with that movement divided by the present one; 1 where none of those tried
    helps. Both are null where every parameter is known: then no movement is tried. ``prior_share`` is how much of the
    precision comes from the loose prior (0 … 1; 0 on the pinned chain).
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


class ChannelEntry(Entry):
    """The model's error in one component of the wrench, over the samples of the fit."""

    bias: float | None
    sd: float | None
    r2: float | None
    why: str | None


class RivalEntry(Entry):
    """An allometric body on the same chain, judged over the same samples as the model; off the seat without one."""

    height_m: float | None
    mass_kg: float | None
    assumed: list[str]
    wrench: dict[str, ChannelEntry]
    cop_rms_m: float | None
    why: str | None


class HeldOutEntry(Entry):
    """Repetitions predicted by models that were fitted without them, all over the same ``samples``.

    ``repetitions`` were found; ``folds`` counts the models, which leave out one each or, where there are more than
    five, neighbouring ones together. ``model`` is the error of their predictions of Fx, Fy (N), tauz (N·m) and cop_x
    (m), ``in_sample`` that of the model of the whole trial, ``reference`` that of the allometric body, null where
    there is none. On measured poses these three hold after the fit's low-pass. ``unfiltered`` is the error of ``model``
    against the wrench as it was measured, ``inside`` the share of samples within 95 % intervals that the other
    repetitions give. ``clock_offset_s`` is what each model found without the repetition.
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


class GapEntry(Entry):
    """How far a joint's two sides part (rms), the gap's acceleration below 3 Hz, and whether the joint is pinned."""

    gap_m: float | None
    acceleration_m_s2: float | None
    pinned: bool
    why: str | None


class MotionEntry(Entry):
    """The motion of the masses, and ``why`` this one: the pinned ``chain``, or the measured poses of ``segments``.

    ``bands_hz`` are the cut-offs of x, y and angle of the measured poses, ``bodies`` their names, ``prior`` the source
    of the loose prior; null on the chain. ``joints`` are null where the poses were not compared.
    """

    source: Literal["chain", "segments"]
    why: str
    bands_hz: dict[str, float] | None
    bands_why: str | None
    bodies: list[str] | None
    prior: str | None
    joints: dict[str, GapEntry] | None


class PredictedEntry(Entry):
    """Errors of predictions of left-out repetitions."""

    wrench: dict[str, ChannelEntry]
    cop_rms_m: float | None
    why: str | None


class PinsEntry(Entry):
    """What pins would cost: both motions on the same left-out ``samples``, after the same low-pass.

    ``clock_offset_s`` is the pinned chain's. Null where the dynamics use the pinned chain.
    """

    samples: int | None
    chain: PredictedEntry | None
    segments: PredictedEntry | None
    clock_offset_s: float | None
    why: str | None


class DynamicsEntry(Entry):
    """The identification; ``mass_kg`` and ``cop_mean_m`` are what the plates show by themselves.

    ``wrench`` and ``cop_rms_m`` are errors over the samples of the fit, ``held_out`` those on repetitions that the fit
    did not see. ``consistency`` is which bodies counted as possible. ``rivals`` are the bodies of each table of people,
    by its name; empty where none applies. ``motion`` is what moves the masses, ``pins`` what pinned joints would cost.
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
    why: str | None
