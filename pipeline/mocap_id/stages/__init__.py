"""The stages of the pipeline. Their records are imported when someone asks: they bring all the libraries along."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mocap_id.stages.lineup import LINEUP

if TYPE_CHECKING:
    from mocap_id.stages.base import Stage

    STAGES: tuple[Stage, ...]

__all__ = ["LINEUP", "STAGES", "Stage"]


def __getattr__(name: str) -> Any:
    if name == "STAGES":
        found: Any = tuple(import_module(f"{__name__}.{stage.replace('-', '_')}").STAGE for stage in LINEUP)
    elif name == "Stage":
        found = import_module(f"{__name__}.base").Stage
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found
