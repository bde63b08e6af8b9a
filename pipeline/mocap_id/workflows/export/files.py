"""Exported files in memory, and the names by which other files refer to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mocap_id.workflows.run_folder import RunFolder


@dataclass(frozen=True)
class ExportFiles:
    """Contents by file name, and notes on missing content and on assumptions."""

    files: Mapping[str, bytes] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __add__(self, other: ExportFiles) -> ExportFiles:
        return ExportFiles({**self.files, **other.files}, tuple(dict.fromkeys((*self.notes, *other.notes))))


def model_file(run: RunFolder) -> str:
    """Return the file name of the chain's model."""
    return f"{run.name}.osim"


def free_model_file(run: RunFolder) -> str:
    """Return the file name of the model of free bodies."""
    return f"{run.name}_free.osim"


def measured_file(run: RunFolder) -> str:
    """Return the file name of the measured markers."""
    return f"{run.name}.trc"


def angles_file(run: RunFolder) -> str:
    """Return the file name of the joint angles."""
    return f"{run.name}_angles.mot"


def torques_file(run: RunFolder) -> str:
    """Return the file name of the joint torques."""
    return f"{run.name}_torques.sto"


def forces_file(run: RunFolder) -> str:
    """Return the file name of the external forces."""
    return f"{run.name}_grf.mot"


def loads_file(run: RunFolder) -> str:
    """Return the file name of the external loads."""
    return f"{run.name}_external_loads.xml"


def free_poses_file(run: RunFolder) -> str:
    """Return the file name of the poses of free bodies."""
    return f"{run.name}_free_poses.mot"
