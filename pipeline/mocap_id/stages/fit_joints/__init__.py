"""fit-joints: centres, marker coordinates and lengths of the whole chain."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.lineup import LINEUP


class FitJointsSettings(Settings):
    """How much is looked at, and when a joint is called weak."""

    estimator: Literal["bundle", "rigid-body", "circle"] = Field(
        "bundle",
        description="the whole chain; to compare with: bodies pair by pair, or the thesis's circles link by link",
    )
    frames: int = Field(400, ge=50, description="frames fitted, evenly along the way that the markers travel")
    lambda_a: float = Field(
        0.01, gt=0, description="weight of the markers about a joint that `segment: joint_markers` names (3.16)"
    )
    small_arc_deg: float = Field(10.0, ge=0, description="a joint that turns less is reported as weak, degrees")
    large_sd_m: float = Field(0.02, gt=0, description="a centre less certain than this is reported, m")


def _function(context: Context) -> Outputs:
    from mocap_id.stages.fit_joints.function import fit_joints  # noqa: PLC0415  whoever runs it loads its libraries

    return fit_joints(context)


STAGE = Stage(
    name="fit-joints",
    version=4,
    inputs=("planar.parquet", "segments.parquet"),
    outputs=("chain.h5",),
    uses=(),
    settings=FitJointsSettings,
    function=_function,
    help=LINEUP["fit-joints"],
)
