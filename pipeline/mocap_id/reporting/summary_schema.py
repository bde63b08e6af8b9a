"""Schema of ``summary.json``, version 1. Keys may be added; a renamed key needs a new version.

An unknown quantity is null, and ``why`` in the same object explains this (``why`` is null if everything is known). No
number is NaN or infinite. ``Summary.model_json_schema()`` returns the JSON Schema of the file.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mocap_id.protocols.five_times import Attempt, FiveTimes, LoadShare
from mocap_id.results import Quantity, Result
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
    odds by each piece of evidence (:class:`mocap_id.kinematics.segmentation.Confidence`); 0 without this evidence.
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

    start_s: Annotated[float | None, Quantity("start", "s", decimals=2)]
    seat_off_s: Annotated[float | None, Quantity("seat-off", "s", decimals=2)]
    stand_s: Annotated[float | None, Quantity("standing", "s", decimals=2)]
    seat_on_s: Annotated[float | None, Quantity("seat-on", "s", decimals=2)]
    end_s: Annotated[float | None, Quantity("end", "s", decimals=2)]
    complete: bool
    seat_off_72_s: float | None
    seat_off_model_s: float | None
    reached: Annotated[float | None, Quantity("height", "%")]
    held_s: Annotated[float | None, Quantity("paused", "s", decimals=1)]
    attempts: Annotated[int | None, Quantity("failed attempts", decimals=0)]
    support: Annotated[float | None, Quantity("unexplained force", "% of weight")]
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
    relative_sd: Annotated[float | None, Quantity("sd", "%")]
    excitation: Annotated[float | None, Quantity("excitation")]
    own_share: Annotated[float | None, Quantity("own share", "%")]
    helps: str | None
    sd_ratio: float | None
    prior_share: float | None
    why: str | None


class ChannelEntry(Result):
    """Error of a model or measurement in one component, such as Fx, over the samples of the entry that contains it."""

    bias: Annotated[float | None, Quantity("bias")]
    sd: Annotated[float | None, Quantity("standard deviation")]
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

    gap_m: Annotated[float | None, Quantity("gap", "mm")]
    acceleration_m_s2: Annotated[float | None, Quantity("acceleration below 3 Hz", "m/s²")]
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
    clock_offset_s: Annotated[float | None, Quantity("clock offset, plates after cameras", "ms", decimals=2)]
    clock_offset_sd_s: Annotated[float | None, Quantity("standard deviation of the clock offset", "ms", decimals=2)]
    wrench: dict[str, ChannelEntry] | None
    cop_rms_m: Annotated[float | None, Quantity("rms error of the centre of pressure", "mm")]
    samples: Annotated[int | None, Quantity("samples in the fit", decimals=0)]
    mass_kg: Annotated[float | None, Quantity("mass measured by the plates", "kg", digits=4)]
    cop_mean_m: Annotated[float | None, Quantity("mean centre of pressure", "mm")]
    consistency: Literal["grid", "cone", "bounded-cone"] | None
    rivals: dict[str, RivalEntry]
    held_out: HeldOutEntry
    motion: MotionEntry | None
    pins: PinsEntry
    legs: Literal["both", "none"] = "none"
    torques: dict[str, TorqueEntry] = Field({})
    why: str | None


class AngleEntry(Result):
    """Statistics of one angle, degrees, over the samples in which the angle is known and has a meaning.

    Plane and axial rotation of the shoulder have no meaning if the elevation is within 15° of 0 or 180°. ``used_share``
    is the fraction of samples in which the angle is known and has a meaning. ``interval_deg`` is the 95 % interval of
    ``range_deg``, which is ``high_deg`` minus ``low_deg``. ``sd_deg`` is the typical standard deviation of a change of
    the angle, and ``constant_sd_deg`` the standard deviation of a constant error from the landmarks; the interval
    includes both.
    """

    low_deg: Annotated[float | None, Quantity("lowest", "deg", decimals=1)]
    high_deg: Annotated[float | None, Quantity("highest", "deg", decimals=1)]
    range_deg: Annotated[float | None, Quantity("range", "deg", decimals=1)]
    interval_deg: Annotated[list[float] | None, Quantity("95 % interval of the range", "deg", decimals=1)]
    sd_deg: Annotated[float | None, Quantity("sd of changes", "deg", decimals=2)]
    constant_sd_deg: Annotated[float | None, Quantity("sd of a constant error", "deg", decimals=1)]
    used_share: Annotated[float, Quantity("samples used", "%")]
    why: str | None


class LandmarkEntry(Result):
    """Position of an anatomical landmark in the frame of its segment; ``sd_m`` applies to each coordinate."""

    segment: str
    local_m: list[float] | None
    sd_m: float | None
    why: str | None


class RangeEntry(Result):
    """Range of one angle, robust against single samples, degrees.

    ``interval_deg`` is the 95 % interval of ``range_deg``. It does not contain constant errors of the angle, because
    they do not change a range.
    """

    low_deg: Annotated[float, Quantity("lowest", "deg", decimals=1)]
    high_deg: Annotated[float, Quantity("highest", "deg", decimals=1)]
    range_deg: Annotated[float, Quantity("range", "deg", decimals=1)]
    interval_deg: Annotated[list[float], Quantity("95 % interval of the range", "deg", decimals=1)]
    low_sd_deg: float
    high_sd_deg: float
    used_share: Annotated[float, Quantity("samples used", "%")]


class VisitedEntry(Result):
    """Volume reached in the recorded postures and in postures between them.

    ``share`` is this volume divided by the volume for independent limits of the angles; ``meaning`` explains it.
    """

    volume_m3: float | None = None
    interval_m3: list[float] | None = None
    discretisation_m3: float | None = None
    convergence_m3: list[float] | None = None
    share: float | None = None
    meaning: str
    why: str | None


class HeightsEntry(Result):
    """Highest and lowest position of the wrist above the shoulder, m and as fractions of the arm length.

    ``levels`` says whether the hand reached the height of each part of the body. A value is null if the hand was
    probably there only while the markers of the arm were missing or not used.
    """

    highest_m: float | None
    lowest_m: float | None
    highest_share: float | None
    lowest_share: float | None
    levels: dict[str, bool | None]


class TargetEntry(Result):
    """Number of reaches to one part of the body, and smallest and median distance by which they missed it, m."""

    count: Annotated[int, Quantity("reaches", decimals=0)]
    best_miss_m: Annotated[float, Quantity("smallest miss", "mm")]
    median_miss_m: Annotated[float, Quantity("median miss", "mm")]


class WorkspaceEntry(Result):
    """Volume that the wrist can reach, its 95 % interval, and the quantities from which it is computed.

    ``box_deg`` contains the independent limits of the angles; ``visited`` is the volume for recorded combinations of
    them. ``relative_volume`` is the volume divided by the volume of a sphere with the arm length as radius.
    ``discretisation_m3`` is the change of the volume in the last refinement of the grid, ``sources`` the contribution
    of every range and length to the variance. ``surface`` has the relative areas of the furthest reach by quadrant.
    """

    volume_m3: float | None = None
    interval_m3: list[float] | None = None
    box_deg: dict[str, list[float]] | None = None
    sd_m3: float | None = None
    relative_volume: float | None = None
    discretisation_m3: float | None = None
    convergence_m3: list[float] | None = None
    sources: dict[str, float] | None = None
    visited: VisitedEntry | None = None
    surface: dict[str, dict[str, float]] | None = None
    ranges: dict[str, RangeEntry] | None = None
    lengths_m: dict[str, float] | None = None
    arm_length_m: float | None = None
    shoulder_m: list[float] | None = None
    glide_m: list[float] | None = None
    heights: HeightsEntry | None = None
    tasks: dict[str, TargetEntry] | None = None
    why: str | None


class CompensationEntry(Result):
    """Motion of one angle that should not change in curls: one value for each curl, null for a failed attempt.

    ``floor_deg`` is the range that errors alone can cause. ``offset_deg`` is the mean angle of the curl minus the mean
    angle of the first curl. ``sustained_s`` is the longest time beyond the allowed change; 0 if it is shorter than the
    rule requires. Axial rotation excludes the part that depends on the flexion alone; ``in_step_deg`` is the range of
    this part in the first curl.
    """

    range_deg: list[float | None]
    interval_deg: list[list[float] | None]
    floor_deg: list[float | None]
    offset_deg: list[float | None]
    sustained_s: list[float | None]
    in_step_deg: float | None = None
    in_step_interval_deg: list[float] | None = None


class TrendEntry(Result):
    """Change of a quantity per curl with its 95 % interval, in the unit at the end of the quantity's name.

    ``curls`` is the number of curls used.
    """

    slope: float
    interval: list[float]
    curls: int


class CurlsEntry(Result):
    """Number of complete curls before the end of the trial and of failed attempts, and changes from curl to curl.

    ``end_rule`` is the rule that ends the trial: ``stopped``, ``tempo``, ``plane``, or ``recording`` if no rule does.
    ``after_end`` is the number of complete curls after the end, which are not counted.
    """

    count: int | None = None
    partial: int | None = None
    after_end: int | None = None
    condition: str | None = None
    end_s: float | None = None
    end_rule: str | None = None
    compensation: dict[str, CompensationEntry] = Field(default_factory=dict)
    largest_torque_nm: float | None = None
    largest_torque_sd_nm: float | None = None
    fatigue: dict[str, TrendEntry] = Field(default_factory=dict)
    why: str | None


class ImuEntry(Result):
    """Inertial sensor on a segment; its time stamp t is the camera time ``clock_offset_s + t (1 + 1e-6 ppm)``.

    ``sd_s`` is the standard deviation of this time in the middle of the trial; ``observable`` is false if the motion
    does not determine the clock offset to 2 ms. ``mounting`` is the rotation from the sensor to the segment,
    ``position_m`` is in the segment's frame, and ``skin_share`` is the fraction of the segment's axial rotation that
    the skin under the sensor does not follow. Without markers, the clock offset is relative to the first sensor, and
    ``heading_deg`` is the rotation about the vertical axis between start and end, by the gyroscope alone.
    """

    used: bool
    clock_offset_s: Annotated[float | None, Quantity("clock offset", "ms", sd="sd_s")] = None
    sd_s: float | None = None
    ppm: Annotated[float | None, Quantity("clock drift", "ppm", decimals=0)] = None
    observable: bool = False
    gyro_bias_rad_s: list[float] | None = None
    gyro_bias_sd_rad_s: list[float] | None = None
    acc_bias_m_s2: list[float] | None = None
    acc_bias_sd_m_s2: list[float] | None = None
    mounting: list[list[float]] | None = None
    mounting_sd_deg: Annotated[float | None, Quantity("sd of mounting", "deg", decimals=1)] = None
    position_m: list[float] | None = None
    position_sd_m: list[float] | None = None
    skin_share: Annotated[
        float | None, Quantity("fraction of axial rotation that the skin does not follow", decimals=2)
    ] = None
    gyro_residual_rad_s: Annotated[float | None, Quantity("gyroscope against markers", "rad/s", decimals=3)] = None
    acc_residual_m_s2: Annotated[float | None, Quantity("accelerometer against markers", "m/s²", decimals=2)] = None
    saturated: float | None = None
    heading_deg: float | None = None
    heading_sd_deg: float | None = None
    why: str | None
