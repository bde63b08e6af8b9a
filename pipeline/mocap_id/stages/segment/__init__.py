"""Settings and record of the stage segment, which groups the markers into rigid bodies with joints."""

from __future__ import annotations

from typing import Annotated, ClassVar, TypeAlias

from pydantic import Field

from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Only, Outputs, Settings, Stage
from mocap_id.stages.calibration_trial import has_no_markers

_Markers: TypeAlias = Annotated[tuple[str, ...], Field(min_length=1)]


class SegmentSettings(Settings):
    """Limits and hints for the segmentation."""

    plane_only: ClassVar[Only] = dict.fromkeys(
        ("count_alone", "joint_markers", "still_limit_m", "planarity_caution", "planarity_limit", "asymmetry_deg"), ()
    )

    count: int | None = Field(
        None, ge=2, le=9, description="number of segments including the base; default: from the motion"
    )
    count_alone: int | None = Field(
        None,
        description="number that the trial has alone, if `mocap-id study` chose `count` from all of a person's trials",
    )
    names: tuple[str, ...] | None = Field(None, description="names of the segments, base first")
    together: tuple[_Markers, ...] = Field(
        (), description="groups of markers, by label or pattern; the markers of a group are on one segment"
    )
    apart: tuple[_Markers, ...] = Field(
        (), description="groups of markers, by label or pattern; all markers of a group are on different segments"
    )
    ignore: tuple[str, ...] = Field((), description="markers, by label or pattern, that are on no segment")
    joint_markers: dict[str, _Markers] = Field(
        {},
        description="markers around each joint, by the joint's name; they attract its centre (3.15, `fit-joints: "
        "lambda_a`)",
    )
    still_limit_m: float = Field(0.015, gt=0, description="largest rms motion of a marker on the base, m")
    min_arc_deg: float = Field(6.0, gt=0, lt=180, description="smallest rotation of a joint, degrees")
    max_joint_residual_m: float = Field(
        0.05, gt=0, description="largest rms distance between two bodies at their joint, m"
    )
    max_body_residual_m: float = Field(
        0.015, gt=0, description="largest rms distance of a marker from its position on a body, m"
    )
    planarity_caution: float = Field(
        0.03, ge=0, le=1, description="share of the motion out of the plane above which there is a caution"
    )
    planarity_limit: float = Field(
        0.15, ge=0, le=1, description="share of the motion out of the plane above which the trial is refused"
    )
    asymmetry_deg: float = Field(
        4.0, ge=0, description="largest rms difference between left and right without a caution, degrees"
    )
    frames: int = Field(500, ge=50, description="number of frames used, evenly distributed over the trial")


def _function(context: Context) -> Outputs:
    if context.trial.space == "3d":
        from mocap_id.stages.segment.space import segment_bodies  # noqa: PLC0415

        return segment_bodies(context)
    if has_no_markers(context.long("planar.parquet").facts):
        from mocap_id.stages.segment.hints import assign_by_calibration  # noqa: PLC0415

        return assign_by_calibration(context)
    from mocap_id.stages.segment.plane import segment  # noqa: PLC0415  loads its libraries only when run

    return segment(context)


STAGE = Stage(
    name="segment",
    version=16,
    inputs=("planar.parquet",),
    outputs=("segments.parquet",),
    uses=("space", "protocol", "calibration"),
    settings=SegmentSettings,
    function=_function,
    help=STAGE_HELP["segment"],
)
