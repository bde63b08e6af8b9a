"""Differences between time series of two runs at common times."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.store import Table
from mocap_id.store.parquet import expand_columns
from mocap_id.workflows.compare.difference import Difference
from mocap_id.workflows.run_folder import RunFolder

_STATES = re.compile(r"(d{0,2})theta_\d+")
_DYNAMICS = re.compile(r"(F[xyz]|tau[xyz]|cop_x)(_model)?|tau_\d+")
_ANGLES = re.compile(r"(?!sd_|constant_sd_|time$).+")
_FILES = (("states.parquet", _STATES), ("angles.parquet", _ANGLES), ("dynamics.parquet", _DYNAMICS))


def compare_series(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Yield the rms of angles, velocities, accelerations, wrench and torques in both runs, and their rms difference.

    The second run is interpolated linearly at those times of the first run that lie within the second run.
    """
    for file, pattern in _FILES:
        one, other = a.artefacts.get(file), b.artefacts.get(file)
        if not isinstance(one, Table) or not isinstance(other, Table):
            continue
        units = {column.name: column.unit for column in expand_columns(one.schema, one.names)}
        names = [name for name in one.names if pattern.fullmatch(name) and name in other.names]
        for name in names:
            difference = _compare(name, units.get(name, ""), one, other)
            if difference is not None:
                yield difference


def _compare(name: str, unit: str, a: Table, b: Table) -> Difference | None:
    """Return the difference of a column; None if there is no time at which both tables have a known value."""
    time, own = a["time"], a[name]
    there, values = b["time"], b[name]
    if not len(time) or not len(there):
        return None
    inside = (time >= there[0]) & (time <= there[-1])
    theirs = values if np.array_equal(time, there) else np.interp(time, there, values)
    both = inside & np.isfinite(own) & np.isfinite(theirs)
    if not both.any():
        return None
    first, second = own[both], theirs[both]
    difference, size = _rms(second - first), _rms(first)
    percent = 100 * difference / size if size else None
    return Difference("series", name, size, _rms(second), unit, difference, percent)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
