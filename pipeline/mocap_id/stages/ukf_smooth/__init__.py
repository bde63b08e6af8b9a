"""ukf-smooth: joint states of the whole chain by an unscented Kalman filter and smoother."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.lineup import LINEUP


class UkfSmoothSettings(Settings):
    """Noise, gate and engine of the filter."""

    method: Literal["rts", "two-filter", "butterworth", "spline", "encoder"] = Field(
        "rts",
        description="filter and smoother; to compare with: the thesis's passes forwards and backwards averaged, the "
        "angles of single frames through a zero-phase low-pass or a quintic smoothing spline, or a robot's encoder",
    )
    butterworth_hz: float = Field(
        6.0, gt=0, description="cutoff of each of the two passes of `method: butterworth`, Hz; human movement: 6"
    )
    engine: Literal["compiled", "filterpy"] = Field(
        "compiled", description="machine code, or filterpy's filter: the same result, a hundred times slower"
    )
    marker_sd: float | None = Field(
        None, gt=0, description="standard deviation of a marker coordinate, m; estimated where not given (thesis: 1e-3)"
    )
    sigma_v: float | None = Field(
        None,
        gt=0,
        description="standard deviation of the snap held over one frame, rad/s^4; estimated for each joint where not "
        "given (thesis: 1e2)",
    )
    marker_sd_floor: float = Field(5e-5, gt=0, description="least estimate of marker_sd, m, for filtered recordings")
    gate: float = Field(
        5.0, ge=3, description="a marker farther from its prediction than this many standard deviations is left out"
    )
    angle_sd_limit: float = Field(
        0.2, gt=0, description="an angle less certain than this is not given, rad (standard deviation)"
    )
    encoder_offset_limit_s: float = Field(
        0.5, ge=0.01, le=10, description="offsets of an encoder's clock up to ± this are tried, s"
    )
    encoder_position_sd: float | None = Field(
        None, gt=0, description="standard deviation of an encoder's position, rad; estimated where not given"
    )
    encoder_velocity_sd: float | None = Field(
        None, gt=0, description="standard deviation of an encoder's velocity, rad/s; estimated where not given"
    )


def _function(context: Context) -> Outputs:
    from mocap_id.stages.ukf_smooth.function import ukf_smooth  # noqa: PLC0415  whoever runs it loads its libraries

    return ukf_smooth(context)


STAGE = Stage(
    name="ukf-smooth",
    version=8,
    inputs=("planar.parquet", "chain.h5"),
    outputs=("states.parquet", "markers.parquet", "skin.h5", "encoder.parquet", "poses.parquet"),
    uses=("encoder",),
    settings=UkfSmoothSettings,
    function=_function,
    help=LINEUP["ukf-smooth"],
)
