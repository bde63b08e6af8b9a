"""ukf-smooth: joint states of the whole chain from an unscented Kalman filter and smoother."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Only, Outputs, Settings, Stage
from mocap_id.stages.calibration_trial import has_no_markers


class UkfSmoothSettings(Settings):
    """Method, noise and gate of the filter."""

    plane_only: ClassVar[Only] = {
        "method": ("two-filter", "butterworth", "spline", "encoder"),
        "engine": ("filterpy",),
        **dict.fromkeys(("butterworth_hz", "encoder_offset_limit_s", "encoder_position_sd", "encoder_velocity_sd"), ()),
    }

    method: Literal["rts", "two-filter", "butterworth", "spline", "encoder"] = Field(
        "rts",
        description="rts: filter and smoother. For comparison: two-filter (thesis), the average of a forward and a "
        "backward pass; butterworth or spline, the smoothed angles of single frames; encoder, a robot's encoder",
    )
    butterworth_hz: float = Field(
        6.0, gt=0, description="cut-off of each of the two passes of `method: butterworth`, Hz; usual for people: 6"
    )
    engine: Literal["compiled", "filterpy"] = Field(
        "compiled",
        description="compiled code, or the library filterpy, which is a hundred times slower and gives the same result",
    )
    marker_sd: float | None = Field(
        None, gt=0, description="standard deviation of a marker coordinate, m; estimated if not given (thesis: 1e-3)"
    )
    sigma_v: float | None = Field(
        None,
        gt=0,
        description="standard deviation of the snap, which is constant over a frame, rad/s^4; estimated for each joint "
        "if not given (thesis: 1e2)",
    )
    marker_sd_floor: float = Field(
        5e-5, gt=0, description="lower limit of the estimated marker_sd, needed for filtered recordings, m"
    )
    gate: float = Field(
        5.0, ge=3, description="a marker farther from its prediction is left out; in standard deviations"
    )
    angle_sd_limit: float = Field(
        0.2, gt=0, description="largest standard deviation of an angle, rad; a more uncertain angle is left out"
    )
    encoder_offset_limit_s: float = Field(
        0.5, ge=0.01, le=10, description="largest clock offset of the encoder that is tried, in either direction, s"
    )
    encoder_position_sd: float | None = Field(
        None, gt=0, description="standard deviation of an encoder's position, rad; estimated if not given"
    )
    encoder_velocity_sd: float | None = Field(
        None, gt=0, description="standard deviation of an encoder's velocity, rad/s; estimated if not given"
    )


def _function(context: Context) -> Outputs:
    if context.trial.space == "3d":
        from mocap_id.stages.ukf_smooth.space import smooth_trial_in_space  # noqa: PLC0415

        return smooth_trial_in_space(context)
    if has_no_markers(context.long("planar.parquet").facts):
        from mocap_id.stages.ukf_smooth.inertial import states_of_sensors  # noqa: PLC0415

        return states_of_sensors(context)
    from mocap_id.stages.ukf_smooth.plane import ukf_smooth  # noqa: PLC0415  loads its libraries only when run

    return ukf_smooth(context)


STAGE = Stage(
    name="ukf-smooth",
    version=23,
    inputs=("planar.parquet", "segments.parquet", "chain.h5"),
    outputs=(
        *("states.parquet", "markers.parquet", "skin.h5", "encoder.parquet", "poses.parquet"),
        "angles.parquet",
    ),
    uses=("space", "encoder", "imus", "calibration"),
    settings=UkfSmoothSettings,
    function=_function,
    help=STAGE_HELP["ukf-smooth"],
)
