"""The shape of ``summary.json``, version 1: an interface, so add freely and rename only with a new version.

A quantity that could not be determined is null, and the object that holds the null says ``why`` (itself null where
everything is known). No number is NaN or infinite. ``Summary.model_json_schema()`` is the JSON Schema of the file.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.reporting.dynamics_shape import ChannelEntry, DynamicsEntry
from mocap_id.reporting.entry import Entry
from mocap_id.verdict import Level


class ReasonEntry(Entry):
    """One reason of the verdict, as :class:`mocap_id.verdict.Reason`."""

    code: str
    message: str
    value: float | None
    limit: float | None
    level: Level


class VerdictEntry(Entry):
    """``reasons`` caution or refuse, ``notes`` inform."""

    level: Level
    reasons: list[ReasonEntry]
    notes: list[ReasonEntry]


class PlaneEntry(Entry):
    """The plane of motion, and its frame's origin in the lab.

    ``planarity`` is the minor over the major variance of the horizontal motion of all markers; ``out_of_plane_share``
    is the share of the chain's whole motion that leaves the plane, which is what the verdict judges.
    """

    yaw_deg: float | None
    planarity: float | None
    out_of_plane_share: float | None
    origin_m: list[float] | None
    why: str | None


class HypothesisEntry(Entry):
    """A reading of the recording that was weighed up; nothing in it is null, and ``why`` says why it lost.

    ``segments`` include the base, the lists go from joint 1 on. ``left_out`` counts the moving markers on none, before
    single ones join the segments of the chosen reading that hold them after all. ``cost`` is a summed log of residuals
    plus a price for every segment: only differences mean something.
    """

    segments: int
    cost: float
    why: str
    chosen: bool
    left_out: int
    joint_residual_m: list[float]
    arc_deg: list[float]


class SegmentsEntry(Entry):
    """``count`` and ``names`` include the base; markers without a segment are not in ``assignment``.

    ``confidence`` is the chance that count and assignment are right, ``against`` what takes it down: how much each
    piece of evidence (:class:`mocap_id.kinematics.confidence.Confidence`) takes off the log odds, 0 where it is good.
    ``hypotheses`` are what was weighed up, the cheapest first.
    """

    count: int | None
    names: list[str] | None
    assignment: dict[str, int] | None
    confidence: float | None
    against: dict[str, float] | None
    hypotheses: list[HypothesisEntry] | None
    why: str | None


class JointEntry(Entry):
    """A joint: ``parent`` is the segment that its centre is fixed to, 0 = base."""

    name: str
    parent: int
    centre_m: list[float] | None
    sd_m: list[float] | None
    arc_deg: float | None
    why: str | None


class LengthEntry(Entry):
    """Distance between the two joints of a segment; of a robot's base, from the plane's origin to its joint."""

    value: float | None
    sd: float | None
    why: str | None


class MarkersEntry(Entry):
    """How well the chain predicts the markers, and how many samples are missing."""

    reprojection_rms_mm: float | None
    missing_fraction: float | None
    why: str | None


class NoiseEntry(Entry):
    """The noise that the filter settled on: of a marker's coordinate, and of the snap (rms over the joints; each)."""

    marker_sd_m: float | None
    sigma_v: float | None
    sigma_v_per_joint: list[float] | None
    why: str | None


class RepetitionEntry(Entry):
    """The events of one repetition, in the recording's own clock.

    ``seat_off_72_s`` and ``seat_off_model_s`` are seat-off by the thesis's two rules, ``reached`` the greatest height
    as a share of the trial's rise, ``held_s`` time in pauses between seat and standing, ``attempts`` failed ones
    before, ``support`` unexplained vertical force over the weight. ``remark`` says what is unusual, whether or not
    anything is missing.
    """

    start_s: float | None
    seat_off_s: float | None
    stand_s: float | None
    seat_on_s: float | None
    end_s: float | None
    complete: bool
    seat_off_72_s: float | None
    seat_off_model_s: float | None
    reached: float | None
    held_s: float | None
    attempts: int | None
    support: float | None
    remark: str
    why: str | None


class PublishedEntry(Entry):
    """A published time of the five-times-sit-to-stand test: context, no diagnosis."""

    limit_s: float
    people: str
    meaning: str
    stop: str
    source: str


class FiveTimesEntry(Entry):
    """The five-times-sit-to-stand test by both common stop rules, from the start of the first rise.

    ``repetitions`` counts rises that come to standing, ``mean_cycle_s`` goes from stand to stand, ``failed_attempts``
    lie within the time.
    """

    repetitions: int | None
    to_fifth_stand_s: float | None
    to_fifth_seat_contact_s: float | None
    to_fifth_seated_s: float | None
    mean_cycle_s: float | None
    cycle_sd_s: float | None
    failed_attempts: int | None
    published: list[PublishedEntry]
    why: str | None


class AttemptEntry(Entry):
    """A rise that was broken off: when it was highest, how high, and the share of the chair's load that was lifted."""

    time_s: float
    height: float
    unloaded: float | None


class SpreadEntry(Entry):
    """Mean and standard deviation over the repetitions."""

    mean: float | None
    sd: float | None


class LoadShareEntry(Entry):
    """The left foot's share of the feet's load in each phase, where each foot has a plate of its own."""

    left_plate: int | None
    right_plate: int | None
    left: dict[str, SpreadEntry]
    why: str | None


class EncoderEntry(Entry):
    """A robot's encoder beside the cameras, in the plane's sense: theirs less its, and the model's torque less its.

    ``sign`` is 1 where it counts the plane's way round; a row at t is the state at t + ``clock_offset_s``.
    """

    sign: int | None
    zero_rad: float | None
    zero_sd_rad: float | None
    clock_offset_s: float | None
    clock_offset_sd_s: float | None
    camera: dict[str, ChannelEntry] | None
    torque: ChannelEntry | None
    why: str | None


class Summary(Entry):
    """The whole file."""

    kind: Literal["mocap-id/summary"] = Field("mocap-id/summary", alias="schema")
    version: Literal[1] = 1
    trial: str
    product: str
    verdict: VerdictEntry
    plane: PlaneEntry
    segments: SegmentsEntry
    joints: list[JointEntry] | None
    lengths_m: dict[str, LengthEntry] | None
    markers: MarkersEntry
    noise: NoiseEntry
    dynamics: DynamicsEntry
    repetitions: list[RepetitionEntry] | None
    five_times: FiveTimesEntry
    attempts: list[AttemptEntry] | None
    load_share: LoadShareEntry
    encoder: EncoderEntry
    time_s: dict[str, float] | None
    why: str | None
