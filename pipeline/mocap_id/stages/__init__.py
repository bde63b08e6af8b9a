"""Stages of the pipeline, in order. ``STAGES`` is the tuple of their records, which are imported on first access.

``STAGE_HELP`` is the only list of stages: commands, Makefile rules, settings and documentation are made from it. A
stage comes after the stages whose outputs it reads. The last stage is the report, which is also made if an earlier
stage refuses the trial. The record of a stage such as ``fit-joints`` is ``STAGE`` in ``stages/fit_joints``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mocap_id.stages.base import Stage

    STAGES: tuple[Stage, ...]

__all__ = ["STAGES", "STAGE_HELP", "Stage"]

STAGE_HELP = {
    "planarise": "Read the recording and find the plane of motion.",
    "segment": "Sort the markers into a base and the segments of a chain.",
    "fit-joints": "Fit joint centres, marker coordinates and segment lengths.",
    "ukf-smooth": "Estimate joint angles, velocities and accelerations.",
    "identify-dim": "Identify the inertial parameters and the joint torques.",
    "report": "Write the verdict, the figures and the page.",
}
"""Description of each stage in one line, by the name of the stage, in the order of the stages."""


def __getattr__(name: str) -> Any:
    if name == "STAGES":
        value: Any = tuple(import_module(f"{__name__}.{stage.replace('-', '_')}").STAGE for stage in STAGE_HELP)
    elif name == "Stage":
        value = import_module(f"{__name__}.base").Stage
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value
