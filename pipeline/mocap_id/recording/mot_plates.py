"""Force plates in a MOT table: force, point of application and free moment."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.clock import SENSOR_HZ, EvenClock, fit_even_clock
from mocap_id.recording.lab_plates import LOADED_N, reverse_force_on_plate
from mocap_id.recording.model import Plate
from mocap_id.recording.saturation import find_clipped
from mocap_id.recording.text_tables import MotionTable
from mocap_id.recording.units import ForceUnits

_COLUMN = re.compile(r"^(?P<name>.*?)_?(?P<what>[vpm]?)(?P<axis>[xyz])$")
_WORDS = re.compile(r"ground|force|torque|moment|free|grf|grm|cop|fp|plate|_|\.|-", re.IGNORECASE)


@dataclass(frozen=True)
class ForceColumns:
    """Name of a plate, and columns of its force, point of application and moment (numbered from 0; None if missing)."""

    name: str
    force: tuple[int, int, int]
    point: tuple[int, int, int] | None
    moment: tuple[int, int, int] | None


def find_force_columns(path: Path, table: MotionTable) -> list[ForceColumns]:
    """Return the columns of each plate of a MOT table.

    Accepted names are ``ground_force_1_vx / _px / _mx``, ``1_ground_force_vx``, ``ground_force_vx``,
    ``ground_force_r_vx``, and for the moment ``ground_torque_x``, ``1_ground_torque_x``, ``ground_torque_1_x``. Raises
    RecordingError if there is no force column, if a force lacks a component, or if two columns are the same quantity.
    """
    found: dict[str, dict[str, dict[str, int]]] = {}
    for index, column in enumerate(table.columns):
        match = _COLUMN.match(column.lower())
        if match is None:
            continue
        name = match["name"]
        what = {"v": "force", "p": "point", "m": "moment"}.get(match["what"])
        if what is None:
            what = "moment" if re.search("torque|moment|grm", name) else None
        if what is not None:
            axes = found.setdefault(_WORDS.sub("", name), {}).setdefault(what, {})
            if match["axis"] in axes:
                raise RecordingError(
                    f"{path}: the columns `{table.columns[axes[match['axis']]]}` and `{column}` are the same quantity "
                    "of the same plate; remove or rename one of them"
                )
            axes[match["axis"]] = index
    groups = {name: parts for name, parts in found.items() if "force" in parts}
    if not groups:
        raise RecordingError(
            f"{path}: no column is a ground force ({', '.join(table.columns[:3])} …); expected names such as "
            "ground_force_1_vx, ground_force_1_px, ground_torque_1_x"
        )
    return [_find_triples(path, name, parts) for name, parts in groups.items()]


def _find_triples(path: Path, name: str, parts: dict[str, dict[str, int]]) -> ForceColumns:
    triples: dict[str, tuple[int, int, int] | None] = {}
    for what in ("force", "point", "moment"):
        axes = parts.get(what, {})
        if axes and set(axes) != set("xyz"):
            raise RecordingError(f"{path}: the {what} {name or '(unnamed)'} has only the components {sorted(axes)}")
        triples[what] = (axes["x"], axes["y"], axes["z"]) if axes else None
    force = triples["force"]
    assert force is not None
    return ForceColumns(name, force, triples["point"], triples["moment"])


def read_mot_plates(
    path: Path,
    table: MotionTable,
    columns: list[ForceColumns],
    oddities: list[str],
    *,
    rotation: FloatArray,
    units: ForceUnits,
) -> tuple[Plate, ...]:
    """Return the plates of a MOT table in the lab, and add notes to ``oddities``.

    A plate without a point of application is unusable. ``rotation`` (3, 3) rotates vectors from the table's axes to the
    axes of the lab (Z up). The units of the table are m, N and N·m unless ``units`` configures others.
    """
    clock = fit_even_clock(path, table.time, fastest=SENSOR_HZ)
    if clock.rounding_note:
        oddities.append(f"{path.name}: {clock.rounding_note}")
    return tuple(
        _read_plate(table, each, index, clock, oddities, rotation=rotation, units=units)
        for index, each in enumerate(columns, start=1)
    )


def _read_plate(
    table: MotionTable,
    columns: ForceColumns,
    index: int,
    clock: EvenClock,
    oddities: list[str],
    *,
    rotation: FloatArray,
    units: ForceUnits,
) -> Plate:
    force = table.values[:, columns.force] @ rotation.T * units.factor("force")
    if columns.point is None:
        moment, problem = np.full_like(force, np.nan), "the table has no point of application"
    else:
        free: FloatArray | float = 0.0
        if columns.moment is None:
            oddities.append(f"plate {index} ({columns.name}): no moment columns, a free moment of 0 was assumed")
        else:
            free = table.values[:, columns.moment] @ rotation.T * units.factor("moment")
        moment, problem = np.cross(table.values[:, columns.point] @ rotation.T, force) + free, ""
    force, moment = reverse_force_on_plate(index, force, moment, np.isfinite(force[:, 2]), oddities)
    if not np.any(force):
        oddities.append(f"plate {index} ({columns.name}) is zero throughout")
    if problem:
        oddities.append(f"plate {index} is not used: {problem}")
        force = np.full_like(force, np.nan)
    finite = np.asarray(np.isfinite(force).all(axis=1) & np.isfinite(moment).all(axis=1))
    full = find_clipped(force[:, 2]) if finite.any() else ~finite
    if full.any():
        oddities.append(f"plate {index}: {int(full.sum())} samples are saturated: they repeat an extreme of the load")
    plate = Plate(index, "mot", None, force, moment, finite & ~full, clock.rate, clock.start, problem)
    loaded = finite.any() and np.ptp(force[finite, 2]) > LOADED_N
    dead = tuple(
        (table.columns[column], rotation[:, axis])
        for axis, column in enumerate(columns.force)
        if loaded and np.ptp(table.values[finite, column]) == 0.0
    )
    return replace(plate, saturated=full if full.any() else None, dead=dead)
