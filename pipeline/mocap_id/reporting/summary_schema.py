"""Schema of ``summary.json``, version 1. Keys may be added; a renamed key needs a new version.

An unknown quantity is null, and ``why`` in the same object explains this (``why`` is null if everything is known). No
number is NaN or infinite. ``Summary.model_json_schema()`` returns the JSON Schema of the file.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.protocols.attempts import Attempt
from mocap_id.protocols.five_times import FiveTimes
from mocap_id.protocols.load_share import LoadShare
from mocap_id.reporting.dynamics_schema import ChannelEntry, DynamicsEntry
from mocap_id.reporting.space.schema import AngleEntry, CurlsEntry, ImuEntry, LandmarkEntry, WorkspaceEntry
from mocap_id.results import Result
from mocap_id.verdict import Level


class ReasonEntry(Result):
    """One reason for the verdict (see :class:`mocap_id.verdict.Reason`)."""

    code: str
    message: str
    value: float | None
    limit: float | None
    level: Level


class VerdictEntry(Result):
    """Verdict; ``reasons`` contains the cautions or the refusal, ``notes`` only information."""

    level: Level
    reasons: list[ReasonEntry]
    notes: list[ReasonEntry]


class PlaneEntry(Result):
    """Plane of motion, and the origin of its coordinate frame in the laboratory.

    ``planarity`` is the smaller principal variance of the horizontal motion of all markers divided by the larger one.
    ``out_of_plane_share`` is the out-of-plane fraction of the chain's motion; the verdict depends on it.
    """

    yaw_deg: float | None
    planarity: float | None
    out_of_plane_share: float | None
    origin_m: list[float] | None
    why: str | None


class HypothesisEntry(Result):
    """A segmentation that was considered; ``why`` says why it was rejected or chosen. No value is null.

    ``segments`` includes the base. The lists start with joint 1. ``left_out`` is the number of moving markers without a
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


class SegmentsEntry(Result):
    """Segments; ``count`` and ``names`` include the base, and ``assignment`` omits markers without a segment.

    ``confidence`` is the probability that count and assignment are right. ``against`` is the reduction of its log
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


class JointEntry(Result):
    """A joint; ``parent`` is the number of the segment to which its centre is fixed, 0 for the base.

    ``axis`` is a unit vector in the frame of the parent. A two-axis joint also has a second axis, in the frame of the
    moving segment. ``known`` is false if the motion does not determine the centre. ``evidence`` is the rotation that
    each kind of joint leaves unexplained, as a multiple of the markers' noise. ``glide_m`` is the shift of the centre
    at an elevation of 180°. In the plane every joint is a hinge about z, and
    ``axis_sd_deg``, ``evidence`` and the values of the glide are empty.

    ``zero`` says where the angle of a joint in the plane is zero: in the pose under `static:`, in the standing phases
    of the protocol, or where the segment lines are parallel, which depends on the markers and is arbitrary.
    ``zero_deg`` is the value of ``theta_j`` in ``states.parquet`` there. In space ``zero`` is empty: the definition of
    each angle contains its zero.
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
    zero: Literal["static", "standing", "segment line", ""] = ""
    zero_deg: float = 0.0
    zero_sd_deg: float | None = 0.0
    known: bool = True
    evidence: dict[str, float] = Field({})
    why: str | None


class LengthEntry(Result):
    """Distance between the two joints of a segment; for the base of a robot, from the plane origin to the joint."""

    value: float | None
    sd: float | None
    why: str | None


class MarkersEntry(Result):
    """Prediction error of the markers, and fraction of missing marker samples."""

    reprojection_rms_mm: float | None
    missing_fraction: float | None
    why: str | None


class NoiseEntry(Result):
    """Estimated standard deviations of a marker coordinate, and the snap, rad/s⁴ (rms over joints, and by joint)."""

    marker_sd_m: float | None
    sigma_v: float | None
    sigma_v_per_joint: list[float] | None
    why: str | None


class RepetitionEntry(Result):
    """Events of one repetition, on the clock of the recording.

    ``seat_off_72_s`` and ``seat_off_model_s`` are seat-off by the two rules of the thesis. ``reached`` is the greatest
    hip height as a fraction of the full rise, and ``held_s`` the time in pauses between seat and standing.
    ``attempts`` is the number of failed attempts before the rise, and ``support`` the unexplained vertical force as a
    fraction of the weight.
    ``remark`` describes anything unusual, also if every value is known; it may be empty.
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
    why: str | None = None


class EncoderEntry(Result):
    """Errors of the cameras and of the model's torque against the encoder of a robot, positive as in the plane.

    ``sign`` is 1 if the encoder counts positive in the same direction as the plane, else -1. A row of the encoder at
    time t is the state at the time t + ``clock_offset_s`` of the cameras.
    """

    sign: int | None
    zero_rad: float | None
    zero_sd_rad: float | None
    clock_offset_s: float | None
    clock_offset_sd_s: float | None
    camera: dict[str, ChannelEntry] | None
    torque: ChannelEntry | None
    why: str | None


class Summary(Result):
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
    five_times: FiveTimes
    attempts: list[Attempt] | None
    load_share: LoadShare
    encoder: EncoderEntry
    imus: dict[str, ImuEntry] = Field(default_factory=dict)
    workspace: WorkspaceEntry
    curls: CurlsEntry
    time_s: dict[str, float] | None
    why: str | None
