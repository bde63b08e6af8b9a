"""Schema of ``summary.json``, version 1. Keys may be added; a renamed key needs a new version.

An unknown quantity is null, and ``why`` in the same object gives the reason (null if everything is known). No number is
NaN or infinite. ``Summary.model_json_schema()`` returns the JSON Schema of the file.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.reporting.dynamics_schema import ChannelEntry, DynamicsEntry
from mocap_id.reporting.space.schema import AngleEntry, CurlsEntry, ImuEntry, LandmarkEntry, WorkspaceEntry
from mocap_id.reporting.summary_entry import Entry
from mocap_id.verdict import Level


class ReasonEntry(Entry):
    """One reason of the verdict (see :class:`mocap_id.verdict.Reason`)."""

    code: str
    message: str
    value: float | None
    limit: float | None
    level: Level


class VerdictEntry(Entry):
    """Verdict: ``reasons`` are cautions or a refusal, ``notes`` are information."""

    level: Level
    reasons: list[ReasonEntry]
    notes: list[ReasonEntry]


class PlaneEntry(Entry):
    """Plane of motion, and the origin of its frame in the laboratory.

    ``planarity`` is the minor divided by the major variance of the horizontal motion of all markers.
    ``out_of_plane_share`` is the share of the chain's motion out of the plane; the verdict depends on it.
    """

    yaw_deg: float | None
    planarity: float | None
    out_of_plane_share: float | None
    origin_m: list[float] | None
    why: str | None


class HypothesisEntry(Entry):
    """A segmentation that was considered; no value is null, and ``why`` says why it was rejected.

    ``segments`` includes the base; the lists start with joint 1. ``left_out`` is the number of moving markers without a
    segment, before single markers are added to the chosen segmentation. ``cost`` is the sum of log residuals plus a
    penalty for each segment; only its differences have a meaning.
    """

    segments: int
    cost: float
    why: str
    chosen: bool
    left_out: int
    joint_residual_m: list[float]
    arc_deg: list[float]


class SegmentsEntry(Entry):
    """Segments; ``count`` and ``names`` include the base, and ``assignment`` omits markers without a segment.

    ``confidence`` is the probability that count and assignment are right. ``against`` is the reduction of the log
    odds by each piece of evidence (:class:`mocap_id.kinematics.confidence.Confidence`); 0 without this evidence.
    ``hypotheses`` are the segmentations considered, lowest cost first.
    """

    count: int | None
    names: list[str] | None
    assignment: dict[str, int] | None
    confidence: float | None
    against: dict[str, float] | None
    hypotheses: list[HypothesisEntry] | None
    why: str | None


class JointEntry(Entry):
    """A joint; ``parent`` is the segment to which its centre is fixed, 0 = base.

    ``axis`` is a unit vector in the frame of the parent. A two-axis joint also has a second axis, in the frame of the
    moving segment. ``known`` is false if the motion does not determine the centre. ``evidence`` is the rotation that
    each kind of joint leaves unexplained, as a multiple of the markers' noise. ``glide_m`` is the shift of the centre
    at an elevation of 180°. In the plane every joint is a hinge about z, and these lists are empty.
    """

    name: str
    parent: int
    kind: Literal["ball", "two-axis", "hinge"] = "hinge"
    centre_m: list[float] | None
    sd_m: list[float] | None
    axis: list[float] | list[list[float]] | None = Field([0.0, 0.0, 1.0])
    axis_sd_deg: list[float] = Field([])
    glide_m: list[float] = Field([])
    glide_sd_m: list[float] = Field([])
    arc_deg: float | None
    known: bool = True
    evidence: dict[str, float] = Field({})
    why: str | None


class LengthEntry(Entry):
    """Distance between the two joints of a segment; for the base of a robot, from the plane origin to the joint."""

    value: float | None
    sd: float | None
    why: str | None


class MarkersEntry(Entry):
    """Prediction error of the markers and share of missing samples."""

    reprojection_rms_mm: float | None
    missing_fraction: float | None
    why: str | None


class NoiseEntry(Entry):
    """Estimated standard deviations: of a marker coordinate, and of the snap (rms over the joints, and per joint)."""

    marker_sd_m: float | None
    sigma_v: float | None
    sigma_v_per_joint: list[float] | None
    why: str | None


class RepetitionEntry(Entry):
    """Events of one repetition, on the clock of the recording.

    ``seat_off_72_s`` and ``seat_off_model_s`` are seat-off by the two rules of the thesis. ``reached`` is the greatest
    height as a share of the trial's rise, and ``held_s`` the time in pauses between seat and standing. ``attempts`` is
    the number of failed attempts before the rise, and ``support`` the unexplained vertical force divided by the weight.
    ``remark`` describes unusual events, also if every value is known.
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
    """A published time of the five-times-sit-to-stand test, for context and not for diagnosis."""

    limit_s: float
    people: str
    meaning: str
    stop: str
    source: str


class FiveTimesEntry(Entry):
    """Times of the five-times-sit-to-stand test by both common stop rules, from the start of the first rise.

    ``repetitions`` is the number of rises that reach standing, ``mean_cycle_s`` the mean time from stand to stand, and
    ``failed_attempts`` the number of failed attempts within the test time.
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
    """A failed attempt to rise: time and value of the greatest height, and share of the chair load on the feet."""

    time_s: float
    height: float
    unloaded: float | None


class SpreadEntry(Entry):
    """Mean and standard deviation over the repetitions."""

    mean: float | None
    sd: float | None


class LoadShareEntry(Entry):
    """Share of the left foot in the load of both feet in each phase, if each foot has its own plate."""

    left_plate: int | None
    right_plate: int | None
    left: dict[str, SpreadEntry]
    why: str | None


class EncoderEntry(Entry):
    """Errors of the cameras and of the model's torque against the encoder of a robot, in the sense of the plane.

    ``sign`` is 1 if the encoder has the sense of the plane. A row of the encoder at time t is the state at the time
    t + ``clock_offset_s`` of the cameras.
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
    """The content of ``summary.json``; ``mirrored`` is true for a left arm, whose z axis points to the left."""

    kind: Literal["mocap-id/summary"] = Field("mocap-id/summary", alias="schema")
    version: Literal[1] = 1
    trial: str
    product: str
    space: Literal["plane", "3d"] = "plane"
    mirrored: bool = False
    verdict: VerdictEntry
    plane: PlaneEntry
    segments: SegmentsEntry
    joints: list[JointEntry] | None
    lengths_m: dict[str, LengthEntry] | None
    angles: dict[str, AngleEntry]
    landmarks: dict[str, LandmarkEntry]
    markers: MarkersEntry
    noise: NoiseEntry
    dynamics: DynamicsEntry
    repetitions: list[RepetitionEntry] | None
    five_times: FiveTimesEntry
    attempts: list[AttemptEntry] | None
    load_share: LoadShareEntry
    encoder: EncoderEntry
    imus: dict[str, ImuEntry] = Field(default_factory=dict)
    workspace: WorkspaceEntry
    curls: CurlsEntry
    time_s: dict[str, float] | None
    why: str | None
