"""The map of springs: the range with each spring of a grid (figure 7.9). An interrupted computation can resume."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config.prescription import SearchGrid
from mocap_id.prescription.level_set import JointDynamics, Scheme, compute_reachable_set, find_reached_and_held
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.store.atomic import write_files

ROWS_FILE = "search.json"
"""File in the output folder with the finished rows of the map."""


@dataclass(frozen=True)
class SpringMap:
    """The range that a person can reach and hold with each spring of a grid."""

    stiffness: FloatArray  # (K,) N·m/rad
    rest: FloatArray  # (R,) rad
    # (K, R) total width of the held intervals that are reached within the horizon, rad; NaN without an equilibrium
    # within the joint's limits
    width: FloatArray
    static: FloatArray  # (K, R) total width of the held intervals without a time limit, rad
    horizon: float  # s

    @property
    def best(self) -> tuple[int, int] | None:
        """Indices (stiffness, rest) of the spring with the largest ``width``; None if all of ``width`` is NaN."""
        if np.isnan(self.width).all():
            return None
        k, r = np.unravel_index(int(np.nanargmax(self.width)), self.width.shape)
        return int(k), int(r)


def map_springs(
    joint: OneJoint, inertia: float, grid: SearchGrid, folder: Path | None, report: Callable[[str], None]
) -> SpringMap:
    """Return the map of springs, computed row by row.

    If ``folder`` is given, each finished row is saved there, and saved rows of the same search are not computed again.
    ``report`` is called with a line after each row. ``inertia`` is in kg·m².

    Raises
    ------
    ValueError
        The grid is empty.
    StoreError
        The folder cannot be written.
    """
    stiffness = np.radians(1.0) ** -1 * 1e-3 * _grid_values(grid.stiffness_mNm_per_deg)
    rest = np.radians(_grid_values(grid.rest_deg))
    key = _search_key(joint, inertia, grid)
    rows = _read_rows(folder, key)
    for index, k in enumerate(stiffness.tolist()):
        if index < len(rows):
            continue
        rows.append([_find_widths(joint, inertia, k, angle, grid) for angle in rest.tolist()])
        if folder is not None:
            _save_rows(folder, key, rows)
        report(f"springs: {index + 1} of {len(stiffness)} stiffnesses")
    both = np.array([[[np.nan if x is None else x for x in pair] for pair in row] for row in rows])
    return SpringMap(stiffness, rest, both[..., 0], both[..., 1], grid.horizon_s)


def _find_widths(
    joint: OneJoint, inertia: float, stiffness: float, rest: float, grid: SearchGrid
) -> tuple[float | None, float]:
    """Return the width of the reached and held range (None without an equilibrium), and of the held range, rad."""
    dynamics = JointDynamics(joint, inertia, stiffness, rest)
    static = float(sum(high - low for low, high in joint.held_intervals(stiffness, rest)))
    if dynamics.equilibrium() is None:
        return None, static
    reached = compute_reachable_set(dynamics, (grid.horizon_s,), Scheme(grid.angles, grid.velocities))
    return float(sum(high - low for low, high in find_reached_and_held(dynamics, reached))), static


def _grid_values(given: tuple[float, float, float]) -> FloatArray:
    first, last, step = given
    if not step > 0 or last < first:
        raise ValueError(f"the search's grid {list(given)} is empty; expected first <= last, and a step above 0")
    return np.asarray(first, dtype=np.float64) + step * np.arange(int(np.floor((last - first) / step + 1e-9)) + 1)


def _search_key(joint: OneJoint, inertia: float, grid: SearchGrid) -> str:
    inputs = {"joint": asdict(joint), "inertia": inertia, "grid": grid.model_dump(mode="json"), "version": 1}
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()


def _read_rows(folder: Path | None, key: str) -> list[list[tuple[float | None, float]]]:
    if folder is None or not (folder / ROWS_FILE).is_file():
        return []
    try:
        data = json.loads((folder / ROWS_FILE).read_text("utf-8"))
        return [[(pair[0], pair[1]) for pair in row] for row in data["rows"]] if data["key"] == key else []
    except (ValueError, KeyError, TypeError, IndexError):
        return []  # unreadable: compute it again


def _save_rows(folder: Path, key: str, rows: list[list[tuple[float | None, float]]]) -> None:
    write_files(folder, {ROWS_FILE: json.dumps({"key": key, "rows": rows}).encode()})
