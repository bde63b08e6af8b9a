"""Exported files in memory, endings of their names, and names of components that OpenSim accepts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mocap_id.store.views import Skeleton, SpatialSkeleton
from mocap_id.workflows.run_folder import RunFolder

MODEL, FREE_MODEL = ".osim", "_free.osim"
MEASURED_MARKERS, ANGLES, FREE_POSES = ".trc", "_angles.mot", "_free_poses.mot"
TORQUES, FORCES, LOADS = "_torques.sto", "_grf.mot", "_external_loads.xml"

BASE = "base"  # name of the joint that connects the base segment to the ground

_ILLEGAL = re.compile(r"[^A-Za-z0-9_.\-]+")


@dataclass(frozen=True)
class ExportFiles:
    """Contents of files by file name, and notes on missing content and on assumptions."""

    files: Mapping[str, bytes] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __add__(self, other: ExportFiles) -> ExportFiles:
        return ExportFiles({**self.files, **other.files}, tuple(dict.fromkeys((*self.notes, *other.notes))))


def note_contact(run: RunFolder, file_format: str) -> ExportFiles:
    """Return a note that torques are unknown while an unmeasured support carries the body; none without contact."""
    table = run.table("dynamics.parquet")
    if table is None or "contact" not in table.names or not table["contact"].any():
        return ExportFiles()
    note = (
        f"{file_format}: a chair or support that no plate measures carries, or may carry, the body in "
        f"{100 * table['contact'].mean():.0f} % of the samples (column `contact` of dynamics.parquet). The torques of "
        "the joints below it are unknown there: do not interpolate them"
    )
    return ExportFiles(notes=(note,))


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


def name_bodies(segments: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the segments in OpenSim, base first."""
    return tuple(make_legal(segments, taken=("ground",)).values())


def name_joints(skeleton: Skeleton | SpatialSkeleton) -> tuple[str, ...]:
    """Return the names of the joints in OpenSim."""
    return tuple(make_legal(skeleton.joints, taken=(BASE,)).values())


def name_coordinates(skeleton: Skeleton) -> tuple[str, ...]:
    """Return the names of the joint angles in OpenSim, such as ``ankle_angle``."""
    return tuple(f"{joint}_angle" for joint in name_joints(skeleton))


def note_changed_names(names: Mapping[str, str]) -> tuple[str, ...]:
    """Return a note that lists the changed names; empty if no name was changed."""
    changed = [f"{old} → {new}" for old, new in names.items() if old != new]
    return (f"names that OpenSim does not accept were changed: {', '.join(changed)}",) if changed else ()
