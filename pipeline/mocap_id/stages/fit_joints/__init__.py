"""Settings and record of the stage fit-joints: joint centres, marker positions in the segments, segment lengths."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Only, Outputs, Settings, Stage


class FitJointsSettings(Settings):
    """Settings of the joint fit: estimator, number of frames, and limits for cautions about joints."""

    plane_only: ClassVar[Only] = {
        "estimator": ("rigid-body", "circle"),
        "lambda_a": (),
        "frames": (),
        "small_arc_deg": (),
    }
    space_only: ClassVar[Only] = {
        "estimator": ("score", "sphere", "helical"),
        **dict.fromkeys(("kinds", "humerus", "palpation_sd_m"), ()),
    }

    estimator: Literal["bundle", "rigid-body", "circle", "score", "sphere", "helical"] = Field(
        "bundle",
        description="method: bundle fits the whole chain. The other methods are for comparison. In the plane: "
        "rigid-body (pairs of rigid bodies) or circle (thesis); in space: score (symmetrical centres of rotation), "
        "sphere or helical (helical axes)",
    )
    kinds: dict[str, Literal["ball", "two-axis", "hinge"]] = Field(
        {}, description="in space: kinds of joints by name; default: from the motion"
    )
    humerus: Literal[1, 2] = Field(
        1, description="in space: axes of the upper arm by the ISB's first option, or by its second (from the forearm)"
    )
    palpation_sd_m: float = Field(
        0.005, gt=0, description="in space: standard deviation of a palpated landmark along each axis, m"
    )
    frames: int = Field(400, ge=50, description="number of frames in the fit, evenly spaced along the markers' paths")
    lambda_a: float = Field(0.01, gt=0, description="weight of the markers in `segment: joint_markers` (3.16)")
    small_arc_deg: float = Field(10.0, ge=0, description="smallest rotation of a joint without a caution, degrees")
    large_sd_m: float = Field(
        0.02, gt=0, description="largest standard deviation of a joint centre without a caution, m"
    )


def _function(context: Context) -> Outputs:
    if context.trial.space == "3d":
        from mocap_id.stages.fit_joints.space import fit_chain_in_space  # noqa: PLC0415

        return fit_chain_in_space(context)
    from mocap_id.stages.fit_joints.plane import fit_joints  # noqa: PLC0415  loads its libraries only when run

    return fit_joints(context)


STAGE = Stage(
    name="fit-joints",
    version=19,
    inputs=("planar.parquet", "segments.parquet"),
    outputs=("chain.h5",),
    uses=("space", "protocol", "side", "landmarks", "pointers", "pointer", "static", "calibration", "subject"),
    settings=FitJointsSettings,
    function=_function,
    help=STAGE_HELP["fit-joints"],
)
