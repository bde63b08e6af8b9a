"""External forces on the body for OpenSim: a MOT table, and the external loads that refer to its columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.recording import format_motion_table
from mocap_id.store.views import Skeleton
from mocap_id.workflows.export.files import ExportFiles, forces_file, loads_file
from mocap_id.workflows.export.motions import known_rows
from mocap_id.workflows.export.names import body_names, legal
from mocap_id.workflows.export.xml import Element, document, element
from mocap_id.workflows.run_folder import RunFolder

_COMPONENTS = ("Fx", "Fy", "tauz")
_AXES = ("x", "y", "z")
GROUND = "ground_force"


@dataclass(frozen=True)
class Load:
    """An external wrench on one segment.

    Parameters
    ----------
    name : str
        Prefix of its columns.
    segment : int
        Segment on which it acts; 0 is the base.
    wrench : (T, 3) array
        Fx, Fy, tauz on the body about the origin of the plane frame, N and N·m; in space (T, 6).
    """

    name: str
    segment: int
    wrench: FloatArray


def forces(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_grf.mot`` and ``<trial>_external_loads.xml``, in the plane frame.

    They contain the measured ground wrench on the base segment, at the corrected clock, and chair and sensors
    separately.
    """
    time, found, notes = _loads(run)
    if not found:
        return ExportFiles(notes=(*notes, f"mot: no forces: {_why(run)}"))
    columns = [name for load in found for name in columns_of_load(load.name)]
    values = np.column_stack([_acting(load.wrench, _threshold(run)) for load in found])
    rows, lost = known_rows(forces_file(run), values)
    text = format_motion_table("forces of the surroundings on the body", columns, values[rows], time=time[rows])
    parts = ExportFiles({forces_file(run): text.encode()}, (*notes, *lost))
    tree = run.tree("chain.h5")
    if tree is None:
        return parts
    bodies = body_names(Skeleton.from_tree(tree))
    return parts + ExportFiles({loads_file(run): external_loads(run, found, bodies)})


def _why(run: RunFolder) -> str:
    return str(run.facts("wrench.parquet").get("why") or run.why_missing("wrench.parquet"))


def _threshold(run: RunFolder) -> float:
    return float(run.facts("wrench.parquet").get("cop_threshold_N") or 0.0)


def _loads(run: RunFolder) -> tuple[FloatArray, list[Load], tuple[str, ...]]:
    """Return times (T,), the known loads, and notes on the others."""
    table = run.table("dynamics.parquet") or run.table("wrench.parquet")
    if table is None:
        return np.zeros(0), [], ()
    time, ground = table["time"], table.stack(_COMPONENTS)
    if not np.isfinite(ground).all(axis=1).any():
        return time, [], ()
    others = list(_others(run))
    measured = {str(fact["name"]) for fact in run.facts("wrench.parquet").get("external") or ()}
    unused = sorted(measured - {name for name, _ in others})
    notes = tuple(f"mot: {name} is omitted: the identification did not use it" for name in unused)
    names = legal((name for name, _ in others), taken=("ground",))
    return (
        time,
        [Load(GROUND, 0, ground), *(Load(f"{names[name]}_force", load.segment, load.wrench) for name, load in others)],
        notes,
    )


def _others(run: RunFolder) -> Iterator[tuple[str, Load]]:
    """Yield chair and sensors that the identification used, at the cameras' times."""
    table, used = run.table("wrench.parquet"), run.facts("dynamics.h5").get("external") or ()
    segments = {str(fact["name"]): int(fact["segment"]) for fact in used}
    if table is None:
        return
    time, offset = table["time"], _applied_offset(run)
    for fact in run.facts("wrench.parquet").get("external") or ():
        name = str(fact["name"])
        if name not in segments:
            continue
        wrench = table.stack([f"{each}_{fact['columns']}" for each in _COMPONENTS])
        if fact["clock"] == "plates":
            wrench = SampledWrench.of(time, wrench)(time - offset)
        yield name, Load(name, segments[name], wrench)


def _applied_offset(run: RunFolder) -> float:
    """Return the clock offset of the plates that is corrected in dynamics.parquet, s."""
    about, offset = run.provenance.get("dynamics.h5"), run.facts("dynamics.h5").get("clock_offset_s")
    if about is None or offset is None:
        return 0.0
    return float(offset) if about.origin.parameters["identify-dim"]["apply_clock_offset"] else 0.0


def columns_of_load(name: str) -> list[str]:
    """Return the column names of force (``_vx`` …), point (``_px`` …) and free moment (``_mx`` …)."""
    return [f"{name}_{kind}{axis}" for kind in "vpm" for axis in _AXES]


def _acting(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return force, point and free moment (T, 9) equivalent to a wrench (T, 3).

    The point is the centre of pressure on y = 0. Where the force is too small to define it, the point keeps its last
    value, and the free moment makes the wrench exact.
    """
    force, moment = wrench[:, :2], wrench[:, 2]
    loaded = np.abs(force[:, 1]) > max(threshold, 1e-9)
    x = np.where(loaded, moment / np.where(loaded, force[:, 1], 1.0), np.nan)
    known = np.flatnonzero(np.isfinite(x))
    if len(known):
        before = np.searchsorted(known, np.arange(len(x)), side="right") - 1
        x = x[known[np.maximum(before, 0)]]
    else:
        x = np.zeros(len(x))
    zero = np.zeros(len(x))
    free = np.where(loaded, 0.0 * moment, moment - x * force[:, 1])
    return np.column_stack([force, zero, x, zero, zero, zero, zero, free])


def external_loads(run: RunFolder, loads: list[Load], bodies: tuple[str, ...]) -> bytes:
    """Return the external loads that refer to the columns of the table of forces."""
    objects = element(
        "objects",
        children=[
            element(
                "ExternalForce",
                name=load.name,
                children=_force(load, bodies[load.segment]),
            )
            for load in loads
        ],
    )
    data = element("datafile", text=forces_file(run))
    return document(element("ExternalLoads", name=legal([run.name])[run.name], children=[objects, data]))


def _force(load: Load, body: str) -> list[Element]:
    properties = {
        "applied_to_body": body,
        "force_expressed_in_body": "ground",
        "point_expressed_in_body": "ground",
        "force_identifier": f"{load.name}_v",
        "point_identifier": f"{load.name}_p",
        "torque_identifier": f"{load.name}_m",
    }
    return [element(key, text=value) for key, value in properties.items()]
