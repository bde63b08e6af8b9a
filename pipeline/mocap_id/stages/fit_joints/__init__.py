"""fit-joints: joint centres, marker coordinates and segment lengths of the whole chain."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Outputs, Settings, Stage


class FitJointsSettings(Settings):
    """Estimator, number of frames, and limits for cautions about joints."""

    estimator: Literal["bundle", "rigid-body", "circle"] = Field(
        "bundle",
        description="the whole chain; for comparison: pairs of rigid bodies, or the circles of the thesis",
    )
    frames: int = Field(400, ge=50, description="number of frames fitted, evenly along the path of the markers")
    lambda_a: float = Field(0.01, gt=0, description="weight of the markers in `segment: joint_markers` (3.16)")
    small_arc_deg: float = Field(10.0, ge=0, description="smallest rotation of a joint without a caution, degrees")
    large_sd_m: float = Field(0.02, gt=0, description="largest standard deviation of a centre without a caution, m")


def _function(context: Context) -> Outputs:
    from mocap_id.stages.fit_joints.function import fit_joints  # noqa: PLC0415  loads its libraries only when run

    return fit_joints(context)


STAGE = Stage(
    name="fit-joints",
    version=7,
    inputs=("planar.parquet", "segments.parquet"),
    outputs=("chain.h5",),
    uses=(),
    settings=FitJointsSettings,
    function=_function,
    help=STAGE_HELP["fit-joints"],
)
