"""Exported files in memory, endings of their names, and names of components that OpenSim accepts."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from mocap_id.store.views import Skeleton, SpatialSkeleton
from mocap_id.workflows.run_folder import RunFolder

MODEL, FREE_MODEL = ".osim", "_free.osim"
MEASURED_MARKERS, ANGLES, FREE_POSES = ".trc", "_angles.mot", "_free_poses.mot"
TORQUES, FORCES, LOADS = "_torques.sto", "_grf.mot", "_external_loads.xml"

BASE = "base"  # name of the joint that connects the base segment to the ground

_ILLEGAL = re.compile(r"[^A-Za-z0-9_.\-]+")


@dataclass
class ExportFiles:
    """The files of an export, to which every exporter adds its own.

    An exporter is a function of a run and of these files. What it cannot make is a note.
    """

    files: dict[str, bytes] = field(default_factory=dict)  # contents by file name
    notes: list[str] = field(default_factory=list)  # on missing content and on assumptions, each once

    def note(self, *notes: str) -> None:
        """Add notes, unless they are known."""
        self.notes += [one for one in dict.fromkeys(notes) if one not in self.notes]


def note_contact(run: RunFolder, out: ExportFiles, file_format: str) -> None:
    """Note that torques are unknown while an unmeasured support carries the body; nothing without contact."""
    table = run.table("dynamics.parquet")
    if table is not None and "contact" in table.names and table["contact"].any():
        out.note(
            f"{file_format}: a chair or support that no plate measures carries, or may carry, the body in "
            f"{100 * table['contact'].mean():.0f} % of the samples (column `contact` of dynamics.parquet). The torques "
            "of the joints below it are unknown there: do not interpolate them"
        )


def make_legal(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """Return for each name a unique name with only letters, digits, ``_``, ``.`` and ``-``, as OpenSim requires.

    The names ``taken`` are not used.

    Examples
    --------
    >>> make_legal(["joint 1", "joint/1", "hip"])
    {'joint 1': 'joint_1', 'joint/1': 'joint_1_2', 'hip': 'hip'}
    """
    legal: dict[str, str] = {}
    used = set(taken)
    for name in names:
        plain = _ILLEGAL.sub("_", name).strip("_") or "unnamed"
        chosen, number = plain, 2
        while chosen in used:
            chosen, number = f"{plain}_{number}", number + 1
        legal[name] = chosen
        used.add(chosen)
    return legal


def opensim_bodies(segments: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the segments in OpenSim, base first."""
    return tuple(make_legal(segments, taken=("ground",)).values())


def opensim_joints(skeleton: Skeleton | SpatialSkeleton) -> tuple[str, ...]:
    """Return the names of the joints in OpenSim."""
    return tuple(make_legal(skeleton.joints, taken=(BASE,)).values())


def name_coordinates(skeleton: Skeleton) -> tuple[str, ...]:
    """Return the names of the joint angles in OpenSim, such as ``ankle_angle``."""
    return tuple(f"{joint}_angle" for joint in opensim_joints(skeleton))
