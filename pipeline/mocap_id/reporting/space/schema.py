"""Entries of ``summary.json`` for a trial in space."""

from __future__ import annotations

from pydantic import Field

from mocap_id.results import Result


class AngleEntry(Result):
    """Statistics of one angle, degrees, over the samples in which the angle is known and has a meaning.

    Plane and axial rotation of the shoulder have no meaning if the elevation is within 15° of 0 or 180°. ``used_share``
    is the fraction of samples in which the angle is known and has a meaning. ``interval_deg`` is the 95 % interval of
    ``range_deg``, which is ``high_deg`` minus ``low_deg``. ``sd_deg`` is the typical standard deviation of a change of
    the angle, and ``constant_sd_deg`` the standard deviation of a constant error from the landmarks; the interval
    includes both.
    """

    low_deg: float | None
    high_deg: float | None
    range_deg: float | None
    interval_deg: list[float] | None
    sd_deg: float | None
    constant_sd_deg: float | None
    used_share: float
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

    low_deg: float
    high_deg: float
    range_deg: float
    interval_deg: list[float]
    low_sd_deg: float
    high_sd_deg: float
    used_share: float


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

    ``levels`` says whether the hand reached the height of each part of the body.
    """

    highest_m: float
    lowest_m: float
    highest_share: float
    lowest_share: float
    levels: dict[str, bool]


class TargetEntry(Result):
    """Number of reaches to one part of the body, and smallest and median distance by which they missed it, m."""

    count: int
    best_miss_m: float
    median_miss_m: float


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
    clock_offset_s: float | None = None
    sd_s: float | None = None
    ppm: float | None = None
    observable: bool = False
    gyro_bias_rad_s: list[float] | None = None
    gyro_bias_sd_rad_s: list[float] | None = None
    acc_bias_m_s2: list[float] | None = None
    acc_bias_sd_m_s2: list[float] | None = None
    mounting: list[list[float]] | None = None
    mounting_sd_deg: float | None = None
    position_m: list[float] | None = None
    position_sd_m: list[float] | None = None
    skin_share: float | None = None
    gyro_residual_rad_s: float | None = None
    acc_residual_m_s2: float | None = None
    saturated: float | None = None
    heading_deg: float | None = None
    heading_sd_deg: float | None = None
    why: str | None
