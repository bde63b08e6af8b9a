"""planarise: the recording → marker trajectories and the ground's wrench in the plane of motion."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.lineup import LINEUP


class PlanariseSettings(Settings):
    """How the recording is read and turned into its plane."""

    units: Literal["mm", "cm", "m", "in"] | None = Field(
        None, description="length unit of the markers, where the file does not declare it or declares it wrong"
    )
    vertical: Literal["X", "Y", "Z", "-X", "-Y", "-Z"] | None = Field(
        None, description="the file's axis that points up; found from the force plates or the file where not given"
    )
    force_unit: Literal["N", "kN", "mN", "lbf", "kgf"] | None = Field(
        None, description="unit of the plates' force channels, where the file does not declare it or declares it wrong"
    )
    moment_unit: Literal["Nm", "Nmm", "Ncm", "kNm", "lbf.ft", "lbf.in", "kgf.m"] | None = Field(
        None, description="unit of the plates' moment channels, where the file does not declare it or declares it wrong"
    )
    facing: Literal["-x", "+x"] = Field(
        "-x", description="way along the plane's x that the subject should face; +x turns the plane around"
    )
    yaw_deg: float | None = Field(
        None, ge=-180, le=180, description="angle of the plane's x from the lab's X, degrees; fitted where not given"
    )
    ignore: tuple[str, ...] = Field((), description="markers to leave out, as names or patterns such as 'L*WR*'")
    repair_swaps: bool = Field(False, description="exchange markers back that carry each other's label for a while")
    cop_threshold_N: float = Field(  # noqa: N815
        20.0, gt=0, description="vertical force under which there is no centre of pressure, N"
    )
    seat_zero: Literal["standing", "none"] = Field(
        "standing", description="what a chair's own plate reads without the person: as the person stands, or nothing"
    )


def _function(context: Context) -> Outputs:
    from mocap_id.stages.planarise.function import planarise  # noqa: PLC0415  whoever runs it loads its libraries

    return planarise(context)


STAGE = Stage(
    name="planarise",
    version=6,
    inputs=(),
    outputs=("planar.parquet", "wrench.parquet"),
    uses=("recording", "protocol", "window", "plates", "external"),
    settings=PlanariseSettings,
    function=_function,
    help=LINEUP["planarise"],
)
