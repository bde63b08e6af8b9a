"""segment: which markers move as one, and how the bodies hang together."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from pydantic import Field

from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.lineup import LINEUP

_Markers: TypeAlias = Annotated[tuple[str, ...], Field(min_length=1)]


class SegmentSettings(Settings):
    """What counts as still, as turning and as a joint."""

    count: int | None = Field(None, ge=2, le=9, description="number of segments with the base; found where not given")
    names: tuple[str, ...] | None = Field(None, description="names of the segments, base first")
    together: tuple[_Markers, ...] = Field(
        (), description="groups of markers, by name or pattern, that are on one segment each"
    )
    apart: tuple[_Markers, ...] = Field((), description="groups of markers of which no two are on the same segment")
    ignore: tuple[str, ...] = Field((), description="markers, by name or pattern, that are on no segment")
    joint_markers: dict[str, _Markers] = Field(
        {}, description="markers about a joint, by its name: their mean pulls its centre (3.15, `fit-joints: lambda_a`)"
    )
    still_limit_m: float = Field(0.015, gt=0, description="largest scatter (rms) of a base marker, m")
    min_arc_deg: float = Field(6.0, gt=0, lt=180, description="a joint turns by at least this, degrees")
    max_joint_residual_m: float = Field(0.05, gt=0, description="two bodies' points at a joint stay this close, m")
    max_body_residual_m: float = Field(0.015, gt=0, description="markers of one body stay this close to it, m")
    planarity_caution: float = Field(0.03, ge=0, le=1, description="out-of-plane share of the chain's motion to report")
    planarity_limit: float = Field(0.15, ge=0, le=1, description="out-of-plane share of the chain's motion to refuse")
    asymmetry_deg: float = Field(
        4.0, ge=0, description="left and right that turn more differently are reported, degrees"
    )
    frames: int = Field(500, ge=50, description="frames looked at, evenly over the trial")


def _function(context: Context) -> Outputs:
    from mocap_id.stages.segment.function import segment  # noqa: PLC0415  whoever runs it loads its libraries

    return segment(context)


STAGE = Stage(
    name="segment",
    version=6,
    inputs=("planar.parquet",),
    outputs=("segments.parquet",),
    uses=("protocol",),
    settings=SegmentSettings,
    function=_function,
    help=LINEUP["segment"],
)
