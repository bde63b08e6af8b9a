"""identify-dim: base parameters, clock offset, predicted wrench and torques; repetitions, their events and averages."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.lineup import LINEUP


class IdentifyDimSettings(Settings):
    """How the dynamics are identified; the defaults suit people and robots alike."""

    motion: Literal["chain", "segments"] | None = Field(
        None,
        description="what moves the masses: the pinned chain, or every segment's own measured pose where a joint gives "
        "way; default: segments, for a robot's joint the chain",
    )
    components: tuple[Literal["Fx", "Fy", "tauz"], ...] = Field(
        ("Fx", "Fy", "tauz"), min_length=1, description="components of the wrench that are fitted"
    )
    cutoff_hz: float | None = Field(
        None,
        gt=0,
        description="low-pass of regressor and wrench, Hz; default: from the joints' velocities, on measured poses 5",
    )
    apply_clock_offset: bool = Field(True, description="take the offset between the clocks out; it is always reported")
    clock_offset_limit_s: float = Field(0.15, ge=0.01, le=1, description="offsets up to ± this are tried, s")
    plate_bias: bool = Field(True, description="estimate a constant error of the plate's Fx")
    plate_zero_sd_n: float = Field(3.0, ge=0, description="sd of a constant error of the plate's Fy, N")
    plate_zero_sd_nm: float = Field(0.5, ge=0, description="sd of a constant error of the plate's tauz, N*m")
    contact: Literal["seat-force", "weight", "knee"] = Field(
        "seat-force", description="how the chair's contact is found"
    )
    seat_off_share: float = Field(
        0.72, gt=0, lt=1, description="of the standing weight, for `contact: weight` and `seat_off_72`"
    )
    knee_bend_rad: float = Field(0.8, gt=0, description="straighter is off the chair, for `contact: knee`, rad")
    seat_plate: bool = Field(True, description="take the chair's force from its own plate, where it has one")
    seat_segment: str | int | None = Field(
        None, description="segment that the chair pushes on, by name or number (0 = base); default: the thigh"
    )
    reference: Literal["winter", "de-leva"] = Field("winter", description="allometric table to compare with")
    reference_sd: float = Field(0.15, gt=0, le=1, description="standard deviation of its parameters, of their size")
    reference_pulls: bool = Field(False, description="it pulls what the wrench tells too (4.13), as a prior")
    consistency: Literal["grid", "cone", "bounded-cone"] | None = Field(
        None,
        description="bodies that can exist: point masses, or their exact cone; default: grid, on measured poses cone",
    )
    grid: tuple[int, int] = Field((5, 9), description="point masses across and along each segment")
    block_s: float = Field(1.0, gt=0, description="length of the blocks behind the standard deviations, s")
    still_arc_deg: float = Field(3.0, ge=0, description="if no joint turns more, only the mass is known, degrees")
    weak_share: float | None = Field(
        None,
        gt=0,
        le=1,
        description="a parameter is weak above this standard deviation, of its size; default: a robot's 0.05, else 0.2",
    )
    gravity: float = Field(9.81, gt=0, description="m/s^2")


def _function(context: Context) -> Outputs:
    from mocap_id.stages.identify_dim.function import identify_dim  # noqa: PLC0415  whoever runs it loads its libraries

    return identify_dim(context)


STAGE = Stage(
    name="identify-dim",
    version=15,
    inputs=("wrench.parquet", "chain.h5", "states.parquet", "skin.h5", "encoder.parquet", "poses.parquet"),
    outputs=("events.parquet", "dynamics.parquet", "dynamics.h5", "phases.parquet"),
    uses=("trial", "protocol", "subject", "compare", "encoder"),
    settings=IdentifyDimSettings,
    function=_function,
    help=LINEUP["identify-dim"],
)
