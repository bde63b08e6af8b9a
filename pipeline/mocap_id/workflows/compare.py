"""Comparison of two runs: what changed, and by how much."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store import Artefact, LongTable, Table
from mocap_id.store.atomic import write_files
from mocap_id.store.ownership import Owner, check_owner, store_owner
from mocap_id.store.parquet import expand_columns
from mocap_id.store.schemas import SCHEMAS
from mocap_id.workflows.run_folder import SUMMARY, RunFolder, open_run

__all__ = ["Comparison", "Difference", "as_json", "check_format", "compare", "write"]


@dataclass(frozen=True)
class Comparison:
    """Differences between two runs."""

    a: RunFolder
    b: RunFolder
    identical: bool  # whether all artefacts have the same content
    rows: tuple[Difference, ...]  # all compared quantities, including equal ones

    @property
    def changed(self) -> tuple[Difference, ...]:
        """The rows that differ."""
        return tuple(row for row in self.rows if row.differs)


def compare(a: Path, b: Path, progress: runner.Progress = lambda step: None) -> Comparison:
    """Return the comparison of two runs.

    Paths and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`.

    Raises
    ------
    StoreError
        A folder contains no run, a damaged run, or a run without a summary.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    first, second = open_run(a, progress), open_run(b, progress)
    for run in (first, second):
        if not run.summary:
            raise StoreError(f"{run.path / SUMMARY} is missing: run `mocap-id report` on the trial first")
    contents = tuple(compare_artefacts(first, second))
    results = compare_results(first.summary, second.summary)
    rows = (*compare_origins(first, second), *contents, *results, *compare_series(first, second))
    return Comparison(first, second, all(row.a == row.b for row in contents), rows)


def check_format(file: Path) -> None:
    """Raise ConfigError if the file name does not end in .csv."""
    if file.suffix.lower() != ".csv":
        raise ConfigError(f"--out {file}: expected a file name that ends in .csv")


def write(rows: tuple[Difference, ...], file: Path, owner: Owner | None = None) -> None:
    """Write rows to a CSV file; raise StoreError if it cannot be written, or if it is a table of another ``owner``."""
    if owner is not None:
        check_owner(file.parent, owner, file.name)
    columns = list(Difference.__dataclass_fields__)
    text = pd.DataFrame([asdict(row) for row in rows], columns=columns).to_csv(index=False, lineterminator="\n")
    write_files(file.parent, {file.name: text.encode()})
    if owner is not None:
        store_owner(file.parent, owner, file.name)


def as_json(comparison: Comparison, rows: tuple[Difference, ...]) -> dict[str, Any]:
    """Return the comparison with the given rows as JSON values."""
    return {
        "schema": "mocap-id/compare",
        "version": 1,
        "a": {"trial": comparison.a.name, "folder": str(comparison.a.path)},
        "b": {"trial": comparison.b.name, "folder": str(comparison.b.path)},
        "identical": comparison.identical,
        "differences": [asdict(row) for row in rows],
    }


_ROUNDING = 1e-12  # SI: smaller differences are rounding errors of coordinates that are zero by definition
Value: TypeAlias = float | int | str | bool | None


@dataclass(frozen=True)
class Difference:
    """The values of a quantity or of a setting in two runs, and their difference."""

    section: str
    name: str
    a: Value  # value in the first run; None if missing
    b: Value  # value in the second run; None if missing
    unit: str = ""
    difference: float | None = None  # second minus first; for time series, the rms difference over common times
    percent: float | None = None  # the difference relative to the first value, %
    # The difference divided by sqrt(sd_a² + sd_b²), which assumes independent errors. Two runs on one recording share
    # errors, and the value is then too small.
    in_sd: float | None = None

    @property
    def differs(self) -> bool:
        """Whether the two runs differ."""
        return self.difference != 0.0 if self.difference is not None else self.a != self.b


def compare_numbers(
    section: str,
    name: str,
    a: float | None,
    b: float | None,
    unit: str = "",
    *,
    sds: tuple[float | None, float | None] = (None, None),
) -> Difference:
    """Return the difference of two numbers; ``sds`` are their standard deviations, None if unknown."""
    if a is None or b is None:
        return Difference(section, name, a, b, unit)
    difference = b - a if abs(b - a) > _ROUNDING else 0.0
    spread = math.hypot(*(sd for sd in sds if sd is not None)) if None not in sds else 0.0
    percent = 100 * difference / abs(a) if a else None
    return Difference(section, name, a, b, unit, difference, percent, difference / spread if spread > 0 else None)


def compare_entries(section: str, a: dict[str, Value], b: dict[str, Value]) -> Iterator[Difference]:
    """Yield a difference for each key of two mappings: first the keys of ``a``, then the keys that only ``b`` has."""
    for key in dict.fromkeys((*a, *b)):
        yield Difference(section, key, a.get(key), b.get(key))


def flatten(value: object, prefix: str = "") -> Iterator[tuple[str, Value]]:
    """Yield each of the nested settings as a dotted key and a plain value; a list becomes one text."""
    match value:
        case dict():
            for key, item in value.items():
                yield from flatten(item, f"{prefix}.{key}" if prefix else str(key))
        case list() | tuple():
            yield prefix, ", ".join(_format(item) for item in value)
        case None | bool() | int() | float() | str():
            yield prefix, value
        case _:
            yield prefix, str(value)


def _format(item: object) -> str:
    return ", ".join(f"{key}: {value}" for key, value in flatten(item)) if isinstance(item, dict | list) else str(item)


_DIGITS = 12  # number of digits of a hash that are output


def compare_origins(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Yield the differences in versions, input files, and settings of the stages that both runs completed."""
    both = _list_stages(a) & _list_stages(b)
    yield from compare_entries("versions", _list_versions(a, both), _list_versions(b, both))
    yield from compare_entries("inputs", _list_inputs(a), _list_inputs(b))
    yield from compare_entries("settings", _list_settings(a, both), _list_settings(b, both))


def compare_artefacts(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Yield the differences between the artefacts' keys; two artefacts with the same content get a common key."""
    first, second = _list_keys(a), _list_keys(b)
    for file in {*first} & {*second}:
        if _has_same_content(a.artefacts[file], b.artefacts[file]):
            first[file] = second[file] = min(str(first[file]), str(second[file]))
    yield from compare_entries("artefacts", first, second)


def _list_keys(run: RunFolder) -> dict[str, Value]:
    return {file: about.origin.key[:_DIGITS] for file, about in run.provenance.items()}


def _has_same_content(one: Artefact, other: Artefact) -> bool:
    """Return whether two artefacts have the same data, facts and reasons for the verdict."""
    return (one.facts, one.reasons) == (other.facts, other.reasons) and _is_equal(
        _collect_data(one), _collect_data(other)
    )


def _collect_data(artefact: Artefact) -> Any:
    match artefact:
        case Table():
            return artefact.columns
        case LongTable():
            index = {"frame": artefact.frames, "time": artefact.time, "marker": np.array(artefact.labels)}
            return {**artefact.values, **index}
    return artefact.data


def _is_equal(one: Any, other: Any) -> bool:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_is_equal(one[name], other[name]) for name in one)
    one, other = np.asarray(one), np.asarray(other)
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f" == other.dtype.kind)


def _list_stages(run: RunFolder) -> set[str]:
    return {about.origin.stage for about in run.provenance.values()}


def _list_versions(run: RunFolder, stages: set[str]) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for file, about in run.provenance.items():
        if about.origin.stage not in stages:
            continue
        found["mocap-id"] = about.origin.product
        found[f"{about.origin.stage} (stage)"] = about.origin.stage_version
        found[f"{file} (schema)"] = about.schema_version
    return found


def _list_inputs(run: RunFolder) -> dict[str, Value]:
    """Return by name the hashes that the user's files had when the stages read them."""
    return {
        name: content[:_DIGITS]
        for about in run.provenance.values()
        for name, content in about.origin.inputs.items()
        if name not in SCHEMAS
    }


def _list_settings(run: RunFolder, stages: set[str]) -> dict[str, Value]:
    settings = (about.origin.parameters for about in run.provenance.values() if about.origin.stage in stages)
    return {key: value for parameters in settings for key, value in flatten(dict(parameters))}


Summary = Mapping[str, Any]
_NOISE = (
    ("markers", "reprojection_rms_mm", "mm"),
    ("markers", "missing_fraction", ""),
    ("noise", "marker_sd_m", "m"),
    ("noise", "sigma_v", "rad/s^4"),
)
_FIT = {"condition_number": "", "condition_number_scaled": "", "mass_kg": "kg", "cop_rms_m": "m", "samples": ""}
_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "taux": "N*m", "tauy": "N*m", "tauz": "N*m"}


def compare_results(a: Summary, b: Summary) -> Iterator[Difference]:
    """Yield the differences between two summaries."""
    yield from _compare_verdicts(a["verdict"], b["verdict"])
    yield from _compare_segments(a["segments"], b["segments"])
    yield from _compare_joints(_by_name(a["joints"]), _by_name(b["joints"]))
    for name, one, other in _pair(a["lengths_m"] or {}, b["lengths_m"] or {}):
        yield _compare_key("lengths", name, one, other, "value", unit="m", sd="sd")
    for name, one, other in _pair(a.get("angles") or {}, b.get("angles") or {}):
        yield _compare_key("angles", f"{name} range", one, other, "range_deg", unit="deg")
    for group, key, unit in _NOISE:
        yield _compare_key("noise", key, a[group], b[group], key, unit=unit)
    for name, one, other in _pair(_by_name(a["dynamics"]["base"]), _by_name(b["dynamics"]["base"])):
        unit = str(one.get("unit") or other.get("unit"))
        yield _compare_key("base parameters", name, one, other, "value", unit=unit, sd="sd")
        yield Difference("base parameters", f"{name} verdict", one.get("verdict"), other.get("verdict"))
    yield from _compare_fit(a["dynamics"], b["dynamics"])
    yield from _compare_events(a["repetitions"] or (), b["repetitions"] or ())


def _by_name(entries: Sequence[Summary] | None) -> dict[str, Summary]:
    return {entry["name"]: entry for entry in entries or ()}


def _pair(a: Summary, b: Summary) -> Iterator[tuple[str, Summary, Summary]]:
    """Yield each name with its entries in ``a`` and ``b``; an entry is empty if the mapping does not have the name."""
    for name in dict.fromkeys((*a, *b)):
        yield name, a.get(name, {}), b.get(name, {})


def _compare_key(
    section: str, name: str, a: Summary, b: Summary, key: str, *, unit: str = "", sd: str = ""
) -> Difference:
    """Return the difference of the numbers at ``key`` in two entries; ``sd`` is the key of the standard deviation."""
    return compare_numbers(section, name, a.get(key), b.get(key), unit, sds=(a.get(sd), b.get(sd)))


def _compare_verdicts(a: Summary, b: Summary) -> Iterator[Difference]:
    yield Difference("verdict", "level", a["level"], b["level"])
    for key, one, other in _pair(_number_reasons(a), _number_reasons(b)):
        if not one or not other:
            name = f"{key} {'lost' if one else 'gained'}"
            yield Difference("verdict", name, one.get("message"), other.get("message"))
        elif one["value"] is None and other["value"] is None:
            yield Difference("verdict", key, one["message"], other["message"])
        else:
            yield _compare_key("verdict", key, one, other, "value")


def _number_reasons(verdict: Summary) -> dict[str, Summary]:
    """Return the reasons for a verdict by code; a repeated code gets a number."""
    reasons: dict[str, Summary] = {}
    for reason in (*verdict["reasons"], *verdict.get("notes", ())):
        key, number = reason["code"], 2
        while key in reasons:
            key, number = f"{reason['code']} {number}", number + 1
        reasons[key] = reason
    return reasons


def _compare_segments(a: Summary, b: Summary) -> Iterator[Difference]:
    yield _compare_key("segments", "count", a, b, "count")
    yield _compare_key("segments", "confidence", a, b, "confidence")
    yield Difference("segments", "names", ", ".join(a["names"] or ()), ", ".join(b["names"] or ()))
    yield from compare_entries("markers", dict(a["assignment"] or {}), dict(b["assignment"] or {}))


def _compare_joints(a: Summary, b: Summary) -> Iterator[Difference]:
    for name, one, other in _pair(a, b):
        before, after = (_list_components(entry) for entry in (one, other))
        for axis in "xyz"[: max(len(before), len(after), 2)]:
            pair = before.get(axis, {}), after.get(axis, {})
            yield _compare_key("joints", f"{name} {axis}", *pair, "value", unit="m", sd="sd")
        yield _compare_key("joints", f"{name} arc", one, other, "arc_deg", unit="deg")
        if one.get("kind") != other.get("kind"):
            yield Difference("joints", f"{name} kind", one.get("kind"), other.get("kind"))


def _list_components(joint: Summary) -> dict[str, Summary]:
    """Return the coordinates of a joint centre by axis, m, with their standard deviations if known."""
    centre, sd = joint.get("centre_m") or (), joint.get("sd_m") or ()
    return {
        axis: {"value": value, "sd": sd[k] if k < len(sd) else None}
        for k, (axis, value) in enumerate(zip("xyz", centre, strict=False))
    }


def _compare_fit(a: Summary, b: Summary) -> Iterator[Difference]:
    for key, unit in _FIT.items():
        yield _compare_key("fit", key, a, b, key, unit=unit)
    yield _compare_key("fit", "clock_offset_s", a, b, "clock_offset_s", unit="s", sd="clock_offset_sd_s")
    for name, one, other in _pair(a["wrench"] or {}, b["wrench"] or {}):
        for key, unit in (("bias", _UNITS[name]), ("sd", _UNITS[name]), ("r2", "")):
            yield _compare_key("fit", f"{name} {key}", one, other, key, unit=unit)


def _compare_events(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    yield compare_numbers("events", "repetitions", len(a), len(b))
    for k, (one, other) in enumerate(zip(a, b, strict=False), start=1):
        for key in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield _compare_key("events", f"repetition {k} {key.removesuffix('_s')}", one, other, key, unit="s")


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
