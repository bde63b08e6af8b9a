"""planarise: marker trajectories and the ground's wrench in the plane of motion, from the recording."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

from pydantic import Field

from mocap_id.errors import Refused
from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Only, Outputs, Settings, Stage
from mocap_id.store import Document
from mocap_id.verdict import Reason


class PlanariseSettings(Settings):
    """Units and axes of the recording, and choice of the plane."""

    plane_only: ClassVar[Only] = {"facing": (), "yaw_deg": (), "repair_swaps": (), "seat_zero": ()}

    units: Literal["mm", "cm", "m", "in"] | None = Field(
        None, description="length unit of the markers, if the unit in the file is missing or wrong"
    )
    vertical: Literal["X", "Y", "Z", "-X", "-Y", "-Z"] | None = Field(
        None, description="axis of the file that points up; found from the force plates or the file if not given"
    )
    force_unit: Literal["N", "kN", "mN", "lbf", "kgf"] | None = Field(
        None, description="unit of the plates' force channels, if the unit in the file is missing or wrong"
    )
    moment_unit: Literal["Nm", "Nmm", "Ncm", "kNm", "lbf.ft", "lbf.in", "kgf.m"] | None = Field(
        None, description="unit of the plates' moment channels, if the unit in the file is missing or wrong"
    )
    facing: Literal["-x", "+x"] = Field(
        "-x", description="direction along the plane's x that the subject faces; with +x, the plane is rotated by 180°"
    )
    yaw_deg: float | None = Field(
        None, ge=-180, le=180, description="angle of the plane's x from the lab's X, degrees; fitted if not given"
    )
    ignore: tuple[str, ...] = Field((), description="markers to leave out, as labels or patterns such as 'L*WR*'")
    repair_swaps: bool = Field(False, description="correct markers whose labels are swapped for a while")
    cop_threshold_N: float = Field(  # noqa: N815
        20.0, gt=0, description="vertical force below which there is no centre of pressure, N"
    )
    seat_zero: Literal["standing", "none"] = Field(
        "standing",
        description="reading of the chair's plate without the person: measured while the person stands, or 0",
    )


def _planarise(context: Context) -> Outputs:
    guess = context.trial.guessed
    if guess is not None and guess.movement in {"walking", "jumping"}:
        from mocap_id.protocols.movement import ELSEWHERE  # noqa: PLC0415  loads numpy

        raise Refused(
            "walking" if guess.movement == "walking" else "jumping",
            f"this is {guess.movement}: {guess.evidence}. mocap-id needs feet, or another base, that stand. "
            f"{ELSEWHERE[guess.movement]}. If only a part of the recording is of interest, give `window:`; if the "
            "movement is another one, give its protocol (`--protocol`)",
        )
    # each loads its libraries only when run
    if context.trial.space == "3d":
        from mocap_id.stages.planarise.space import planarise_in_space as planarise  # noqa: PLC0415
    elif context.trial.recording is None:
        from mocap_id.stages.planarise.space import planarise_sensors as planarise  # noqa: PLC0415
    else:
        from mocap_id.stages.planarise.plane import planarise  # noqa: PLC0415
    outputs = planarise(context)
    if guess is None:
        return outputs
    what = " and ".join(f"`{name}: {getattr(context.trial, name)}`" for name in guess.keys)
    note = Reason(
        "guessed",
        f"{what} {'were' if len(guess.keys) > 1 else 'was'} guessed, because {guess.evidence}. If this is wrong, give "
        "the right values (`--protocol`, `--space`, `--side`)",
        level="ok",
    )
    planar, wrench = outputs
    assert not isinstance(planar, Document)
    return replace(planar, reasons=(note, *planar.reasons)), wrench


STAGE = Stage(
    name="planarise",
    version=11,
    inputs=(),
    outputs=("planar.parquet", "wrench.parquet"),
    uses=("recording", "space", "side", "landmarks", "protocol", "window", "plates", "external", "guessed"),
    settings=PlanariseSettings,
    function=_planarise,
    help=STAGE_HELP["planarise"],
    uses_alone=("imus", "calibration"),
)
