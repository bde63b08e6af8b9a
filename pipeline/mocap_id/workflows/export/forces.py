"""External forces on the body for OpenSim: a MOT table, and a file of external loads that refers to its columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.recording import format_motion_table
from mocap_id.workflows.export.files import FORCES, LOADS, ExportFiles, make_legal, name_bodies
from mocap_id.workflows.export.motions import find_known_rows
from mocap_id.workflows.export.xml import element, format_document
from mocap_id.workflows.run_folder import RunFolder

_IN_PLANE = ("Fx", "Fy", "tauz")
_IN_SPACE = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")


@dataclass(frozen=True)
class _Load:
    """An external wrench on one segment."""

    name: str  # prefix of its columns
    segment: int  # 0 is the base
    wrench: FloatArray  # (T, 3) or in space (T, 6) about the origin, N and N·m


def export_forces(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_grf.mot`` and ``<trial>_external_loads.xml``.

    They contain the measured ground wrench on the base segment at the cameras' times, in the plane frame, or for a
    trial in space in the frame of the trial. In the plane, chair and force sensors have columns of their own.
    """
    time, loads, notes = _read_loads(run)
    if not loads:
        why = run.facts("wrench.parquet").get("why") or run.why_missing("wrench.parquet")
        return ExportFiles(notes=(*notes, f"mot: no forces: {why}"))
    threshold = float(run.facts("wrench.parquet").get("cop_threshold_N") or 0.0)
    columns = [f"{load.name}_{kind}{axis}" for load in loads for kind in "vpm" for axis in "xyz"]
    convert = convert_spatial_wrench if run.in_space else convert_planar_wrench
    values = np.column_stack([convert(load.wrench, threshold) for load in loads])
    file = run.name + FORCES
    rows, missing = find_known_rows(file, values)
    text = format_motion_table("external forces on the body", columns, values[rows], time=time[rows])
    parts = ExportFiles({file: text.encode()}, (*notes, *missing))
    tree = run.tree("chain.h5")
    if tree is None:
        return parts
    bodies = name_bodies(tree.texts("segments/name"))
    return parts + ExportFiles({run.name + LOADS: _format_loads(run, loads, bodies)})


def _read_loads(run: RunFolder) -> tuple[FloatArray, list[_Load], tuple[str, ...]]:
    """Return times (T,), s, the loads with measured values, and notes on loads that are omitted."""
    components = _IN_SPACE if run.in_space else _IN_PLANE
    tables = (run.table("dynamics.parquet"), run.table("wrench.parquet"))
    table = next((each for each in tables if each is not None and set(components) <= set(each.names)), None)
    if table is None:
        return np.zeros(0), [], ()
    time, wrench = table["time"], table.stack(components)
    if not np.isfinite(wrench).all(axis=1).any():
        return time, [], ()
    ground = _Load("ground_force", 0, wrench)
    if run.in_space:
        return time, [ground], ()
    others = list(_read_other_loads(run))
    measured = {str(fact["name"]) for fact in run.facts("wrench.parquet").get("external") or ()}
    unused = sorted(measured - {load.name for load in others})
    notes = tuple(f"mot: {name} is omitted, because the identification did not use it" for name in unused)
    names = make_legal((load.name for load in others), taken=("ground",))
    return time, [ground, *(_Load(f"{names[each.name]}_force", each.segment, each.wrench) for each in others)], notes


def _read_other_loads(run: RunFolder) -> Iterator[_Load]:
    """Yield the wrenches of chair and force sensors that the identification used, at the cameras' times."""
    table, used = run.table("wrench.parquet"), run.facts("dynamics.h5").get("external") or ()
    segments = {str(fact["name"]): int(fact["segment"]) for fact in used}
    if table is None:
        return
    time, offset = table["time"], _read_applied_offset(run)
    for fact in run.facts("wrench.parquet").get("external") or ():
        name = str(fact["name"])
        if name not in segments:
            continue
        wrench = table.stack([f"{each}_{fact['columns']}" for each in _IN_PLANE])
        if fact["clock"] == "plates":
            wrench = SampledWrench.of(time, wrench)(time - offset)
        yield _Load(name, segments[name], wrench)


def _read_applied_offset(run: RunFolder) -> float:
    """Return the clock offset, s, that is corrected in dynamics.parquet but not in wrench.parquet."""
    return float((run.facts("dynamics.h5").get("clock") or {}).get("applied_s") or 0.0)


def convert_planar_wrench(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return force, point and free moment (T, 9) that are equivalent to a wrench Fx, Fy, tauz (T, 3) about the origin.

    The point is the centre of pressure on y = 0. Where the absolute value of Fy is not above ``threshold``, N, the
    point keeps its last value, and the free moment makes the wrench exact.
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


def convert_spatial_wrench(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return force, point and free moment (T, 9) that are equivalent to a wrench (T, 6) about the origin.

    The point is the centre of pressure on y = 0, or the origin where the absolute value of Fy is not above
    ``threshold``, N.
    """
    force, moment = wrench[:, :3], wrench[:, 3:]
    loaded = np.abs(force[:, 1]) > max(threshold, 1e-9)
    divisor = np.where(loaded, force[:, 1], 1.0)
    point = np.zeros_like(force)
    point[:, 0] = np.where(loaded, moment[:, 2] / divisor, 0.0 * moment[:, 2])
    point[:, 2] = np.where(loaded, -moment[:, 0] / divisor, 0.0 * moment[:, 0])
    return np.column_stack([force, point, moment - np.cross(point, force)])


def _format_loads(run: RunFolder, loads: list[_Load], bodies: tuple[str, ...]) -> bytes:
    """Return the content of the file of external loads, which refers to the columns of the table of forces."""
    objects = []
    for load in loads:
        properties = {
            "applied_to_body": bodies[load.segment],
            "force_expressed_in_body": "ground",
            "point_expressed_in_body": "ground",
            "force_identifier": f"{load.name}_v",
            "point_identifier": f"{load.name}_p",
            "torque_identifier": f"{load.name}_m",
        }
        children = [element(key, text=value) for key, value in properties.items()]
        objects.append(element("ExternalForce", name=load.name, children=children))
    data = element("datafile", text=run.name + FORCES)
    return format_document("ExternalLoads", run.name, [element("objects", children=objects), data])
