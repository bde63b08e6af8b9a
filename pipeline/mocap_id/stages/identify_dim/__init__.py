"""Settings and record of the stage identify-dim: inertial parameters, wrench and torques, events and averages."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Only, Outputs, Settings, Stage


class IdentifyDimSettings(Settings):
    """Settings of the identification, for people and robots."""

    plane_only: ClassVar[Only] = dict.fromkeys(
        (
            *("motion", "components", "contact", "seat_off_share", "knee_bend_rad", "seat_plate", "seat_segment"),
            *("reference", "reference_sd", "reference_pulls", "consistency", "grid", "subject_mass_sd_kg"),
        ),
        (),
    )

    motion: Literal["chain", "segments"] | None = Field(
        None,
        description="motion of the masses: chain (with pinned joints), or segments (measured poses of all segments, if "
        "the two sides of a joint separate). Default: segments; for robot-joint: chain",
    )
    components: tuple[Literal["Fx", "Fy", "tauz"], ...] = Field(
        ("Fx", "Fy", "tauz"), min_length=1, description="components of the wrench to fit"
    )
    cutoff_hz: float | None = Field(
        None,
        gt=0,
        description="cut-off of the low-pass of regressor and wrench, Hz. Default: from the joint velocities; with "
        "measured poses: 5",
    )
    apply_clock_offset: bool = Field(
        True, description="correct the clock offset between cameras and plate; it is always reported"
    )
    clock_offset_limit_s: float | None = Field(
        None,
        ge=0.01,
        le=5,
        description="largest possible clock offset, ± s. Default: 5, if forces and markers show one clear offset, "
        "otherwise 0.15",
    )
    plate_bias: bool = Field(True, description="estimate the constant error of the plate's Fx")
    plate_zero_sd_n: float = Field(
        5.0, ge=0, description="standard deviation of the constant error of the plate's Fy, N"
    )
    plate_zero_sd_nm: float = Field(
        0.5, ge=0, description="standard deviation of the constant error of the plate's tauz, N*m"
    )
    plate_gain_sd: float = Field(0.01, ge=0, lt=1, description="relative standard deviation of the plate's gain")
    plate_moments_sd: float = Field(
        0.01, ge=0, lt=1, description="relative standard deviation of an additional gain of the plate's moments"
    )
    plate_position_sd_m: float | None = Field(
        None,
        ge=0,
        description="standard deviation of the plate's position along the motion, m; default: 0.005, for robot-joint "
        "0.001",
    )
    camera_scale_sd: float = Field(0.003, ge=0, lt=1, description="relative standard deviation of the cameras' scale")
    camera_tilt_sd_deg: float = Field(
        0.3, ge=0, description="standard deviation of the tilt of the cameras' vertical axis against gravity, degrees"
    )
    subject_mass_sd_kg: float = Field(1.0, gt=0, description="standard deviation of `subject: {mass}`, kg")
    contact: Literal["seat-force", "weight", "knee"] = Field(
        "seat-force", description="rule for contact with the chair"
    )
    seat_off_share: float = Field(
        0.72, gt=0, lt=1, description="share of the standing weight, for `contact: weight` and `seat_off_72`"
    )
    knee_bend_rad: float = Field(
        0.8, gt=0, description="knee angle below which there is no contact, for `contact: knee`, rad"
    )
    seat_plate: bool = Field(True, description="use the wrench of the chair if it has its own plate")
    seat_segment: str | int | None = Field(
        None, description="segment in contact with the chair, by name or number (0 = base); default: the thigh"
    )
    reference: Literal["winter", "de-leva"] = Field("winter", description="allometric table of the reference body")
    reference_sd: float = Field(0.15, gt=0, le=1, description="relative standard deviation of the reference parameters")
    reference_pulls: bool | Literal["foot"] | None = Field(
        None,
        description="parameters for which the reference body is a prior (4.13): all (true), none (false), or those of "
        "the foot. Default for people: foot, if a segment has only one or two marker positions; otherwise, the foot "
        "for the torques only, or none if forces of a chair or on a hand are measured",
    )
    consistency: Literal["grid", "cone", "bounded-cone"] | None = Field(
        None,
        description="physical consistency by point masses (grid) or by the exact cone. Default: grid; with measured "
        "poses: cone",
    )
    grid: tuple[int, int] = Field((5, 9), description="number of point masses across and along each segment")
    block_s: float = Field(1.0, gt=0, description="length of the blocks used for standard deviations, s")
    still_arc_deg: float = Field(
        3.0,
        ge=0,
        description="smallest rotation of a joint for an identification, degrees; with less, only the mass is known",
    )
    weak_share: float | None = Field(
        None,
        gt=0,
        le=1,
        description="relative standard deviation above which a parameter is weak; default: 0.2, for robot-joint 0.05",
    )
    gravity: float = Field(9.81, gt=0, description="acceleration of gravity, m/s^2")


def _function(context: Context) -> Outputs:
    if context.trial.space == "3d":
        from mocap_id.stages.identify_dim.space import identify_in_space  # noqa: PLC0415

        return identify_in_space(context)
    from mocap_id.stages.identify_dim.plane import identify_dim  # noqa: PLC0415  loads its libraries only when run

    return identify_dim(context)


STAGE = Stage(
    name="identify-dim",
    version=27,
    inputs=(
        *("wrench.parquet", "chain.h5", "states.parquet", "skin.h5", "encoder.parquet", "poses.parquet"),
        "angles.parquet",
    ),
    outputs=("events.parquet", "dynamics.parquet", "dynamics.h5", "phases.parquet"),
    uses=("trial", "space", "protocol", "subject", "compare", "encoder", "static", "curl"),
    settings=IdentifyDimSettings,
    function=_function,
    help=STAGE_HELP["identify-dim"],
)
