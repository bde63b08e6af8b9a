"""Regression check: recompute trials and compare their main results with a baseline."""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd

from mocap_id import __version__, runner
from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.errors import ConfigError, RecordingError, StoreError
from mocap_id.runner.dependencies import FileHashes, find_owner
from mocap_id.store import Artefact, LongTable, Table
from mocap_id.store.atomic import replace_together
from mocap_id.store.parquet import expand_columns
from mocap_id.store.provenance import SCHEMAS
from mocap_id.workflows.batch import find_readable_trials
from mocap_id.workflows.parallel import Backend, TrialCallback, run_trials
from mocap_id.workflows.run_folder import SUMMARY, RunFolder, open_run
from mocap_id.workflows.trial_outcome import read_summary

if TYPE_CHECKING:
    from mocap_id.config.trial import Trial

_ROUNDING = 1e-12  # SI: smaller differences are rounding errors of coordinates that are zero by definition
_DIGITS = 12  # number of digits of a hash that are output
_NOISE = (
    ("markers", "reprojection_rms_mm", "mm"),
    ("markers", "missing_fraction", ""),
    ("noise", "marker_sd_m", "m"),
    ("noise", "sigma_v", "rad/s^4"),
)
_FIT = {"condition_number": "", "condition_number_scaled": "", "mass_kg": "kg", "cop_rms_m": "m", "samples": ""}
_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "taux": "N*m", "tauy": "N*m", "tauz": "N*m"}
_SERIES = {
    "states.parquet": re.compile(r"(d{0,2})theta_\d+"),
    "angles.parquet": re.compile(r"(?!sd_|constant_sd_|time$).+"),
    "dynamics.parquet": re.compile(r"(F[xyz]|tau[xyz]|cop_x)(_model)?|tau_\d+"),
}
"""Names of the compared time series, by artefact."""
Value: TypeAlias = float | int | str | bool | None
Summary: TypeAlias = Mapping[str, Any]


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
        return self.difference != 0.0 if self.difference is not None else self.a != self.b


@dataclass(frozen=True)
class RunComparison:
    """Differences between two runs."""

    a: RunFolder
    b: RunFolder
    identical: bool  # whether all artefacts have the same content
    rows: tuple[Difference, ...]  # all compared quantities, including equal ones

    @property
    def changed(self) -> tuple[Difference, ...]:
        return tuple(row for row in self.rows if row.differs)

    def as_json(self, rows: Sequence[Difference]) -> dict[str, Any]:
        """Return the comparison with the given rows as JSON values."""
        return {
            "schema": "mocap-id/compare",
            "version": 1,
            "a": {"trial": self.a.name, "folder": str(self.a.path)},
            "b": {"trial": self.b.name, "folder": str(self.b.path)},
            "identical": self.identical,
            "differences": [asdict(row) for row in rows],
        }


def format_rows(rows: Sequence[Difference]) -> bytes:
    """Return the content of a CSV file with the rows."""
    table = pd.DataFrame([asdict(row) for row in rows], columns=list(Difference.__dataclass_fields__))
    return table.to_csv(index=False, lineterminator="\n").encode()


def compare_runs(a: Path, b: Path, progress: runner.Progress = lambda step: None) -> RunComparison:
    """Return the comparison of two runs; StoreError is raised if a run has no summary.

    Paths, ``progress`` and other errors are as for :func:`mocap_id.workflows.run_folder.open_run`.
    """
    first, second = open_run(a, progress), open_run(b, progress)
    for run in (first, second):
        if not run.summary:
            raise StoreError(f"{run.path / SUMMARY} is missing: run `mocap-id report` on the trial first")
    # Artefacts by a hash of what they are made from; two artefacts with the same content get a common one.
    keys, others = (
        {file: str(about.origin.key[:_DIGITS]) for file, about in run.provenance.items()} for run in (first, second)
    )
    for file in {*keys} & {*others}:
        one, other = first.artefacts[file], second.artefacts[file]
        same_facts = (one.facts, one.reasons) == (other.facts, other.reasons)
        if same_facts and _is_equal(_collect_data(one), _collect_data(other)):
            keys[file] = others[file] = min(keys[file], others[file])
    # Versions, input files, and settings of the stages that both runs completed.
    both = set.intersection(*({about.origin.stage for about in run.provenance.values()} for run in (first, second)))
    found: dict[str, tuple[dict[str, Value], ...]] = {name: ({}, {}) for name in ("versions", "inputs", "settings")}
    for k, run in enumerate((first, second)):
        versions, inputs, settings = (found[name][k] for name in found)
        for file, about in run.provenance.items():
            origin = about.origin
            # The hashes that the user's files had when the stages read them.
            inputs |= {name: content[:_DIGITS] for name, content in origin.inputs.items() if name not in SCHEMAS}
            if origin.stage in both:
                versions["mocap-id"] = origin.product
                versions[f"{origin.stage} (stage)"] = origin.stage_version
                versions[f"{file} (schema)"] = about.schema_version
                settings |= dict(flatten(dict(origin.parameters)))
    rows = (
        *(row for section, entries in found.items() for row in compare_entries(section, *entries)),
        *compare_entries("artefacts", keys, others),
        *compare_results(first.summary, second.summary),
        *compare_tables(first, second),
    )
    return RunComparison(first, second, keys == others, rows)


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


def compare_entries(section: str, a: Mapping[str, Value], b: Mapping[str, Value]) -> Iterator[Difference]:
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


def compare_results(a: Summary, b: Summary) -> Iterator[Difference]:
    """Yield the differences between two summaries."""
    yield Difference("verdict", "level", a["verdict"]["level"], b["verdict"]["level"])
    reasons = dict[str, Summary](), dict[str, Summary]()  # by code; a repeated code gets a number
    for numbered, verdict in zip(reasons, (a["verdict"], b["verdict"]), strict=True):
        for reason in (*verdict["reasons"], *verdict.get("notes", ())):
            key, number = reason["code"], 2
            while key in numbered:
                key, number = f"{reason['code']} {number}", number + 1
            numbered[key] = reason
    for key, one, other in _pair(*reasons):
        if not one or not other:
            name = f"{key} {'lost' if one else 'gained'}"
            yield Difference("verdict", name, one.get("message"), other.get("message"))
        elif one["value"] is None and other["value"] is None:
            yield Difference("verdict", key, one["message"], other["message"])
        else:
            yield _compare_key("verdict", key, one, other, "value")

    before, after = a["segments"], b["segments"]
    yield _compare_key("segments", "count", before, after, "count")
    yield _compare_key("segments", "confidence", before, after, "confidence")
    yield Difference("segments", "names", ", ".join(before["names"] or ()), ", ".join(after["names"] or ()))
    yield from compare_entries("markers", dict(before["assignment"] or {}), dict(after["assignment"] or {}))

    for name, one, other in _pair(_by_name(a["joints"]), _by_name(b["joints"])):
        centre, moved = _list_components(one), _list_components(other)
        for axis in "xyz"[: max(len(centre), len(moved), 2)]:
            ends = centre.get(axis, {}), moved.get(axis, {})
            yield _compare_key("joints", f"{name} {axis}", *ends, "value", unit="m", sd="sd")
        yield _compare_key("joints", f"{name} arc", one, other, "arc_deg", unit="deg")
        if one.get("kind") != other.get("kind"):
            yield Difference("joints", f"{name} kind", one.get("kind"), other.get("kind"))
    for name, one, other in _pair(a["lengths_m"] or {}, b["lengths_m"] or {}):
        yield _compare_key("lengths", name, one, other, "value", unit="m", sd="sd")
    for name, one, other in _pair(a.get("angles") or {}, b.get("angles") or {}):
        yield _compare_key("angles", f"{name} range", one, other, "range_deg", unit="deg")
    for group, key, unit in _NOISE:
        yield _compare_key("noise", key, a[group], b[group], key, unit=unit)

    before, after = a["dynamics"], b["dynamics"]
    for name, one, other in _pair(_by_name(before["base"]), _by_name(after["base"])):
        unit = str(one.get("unit") or other.get("unit"))
        yield _compare_key("base parameters", name, one, other, "value", unit=unit, sd="sd")
        yield Difference("base parameters", f"{name} verdict", one.get("verdict"), other.get("verdict"))
    for key, unit in _FIT.items():
        yield _compare_key("fit", key, before, after, key, unit=unit)
    yield _compare_key("fit", "clock_offset_s", before, after, "clock_offset_s", unit="s", sd="clock_offset_sd_s")
    for name, one, other in _pair(before["wrench"] or {}, after["wrench"] or {}):
        for key, unit in (("bias", _UNITS[name]), ("sd", _UNITS[name]), ("r2", "")):
            yield _compare_key("fit", f"{name} {key}", one, other, key, unit=unit)

    repetitions, others = a["repetitions"] or (), b["repetitions"] or ()
    yield compare_numbers("events", "repetitions", len(repetitions), len(others))
    for k, (one, other) in enumerate(zip(repetitions, others, strict=False), start=1):
        for key in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield _compare_key("events", f"repetition {k} {key.removesuffix('_s')}", one, other, key, unit="s")


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


def _list_components(joint: Summary) -> dict[str, Summary]:
    """Return the coordinates of a joint centre by axis, m, with their standard deviations if known."""
    centre, sd = joint.get("centre_m") or (), joint.get("sd_m") or ()
    return {
        axis: {"value": value, "sd": sd[k] if k < len(sd) else None}
        for k, (axis, value) in enumerate(zip("xyz", centre, strict=False))
    }


def compare_tables(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Yield the rms of angles, velocities, accelerations, wrench and torques in both runs, and their rms difference.

    The second run is interpolated linearly at those times of the first run that lie within the second run. A series
    without a time at which both runs have a known value is left out.
    """
    for file, pattern in _SERIES.items():
        one, other = a.artefacts.get(file), b.artefacts.get(file)
        if not isinstance(one, Table) or not isinstance(other, Table) or not one.length or not other.length:
            continue
        units = {column.name: column.unit for column in expand_columns(one.schema, one.names)}
        time, there = one["time"], other["time"]
        inside = (time >= there[0]) & (time <= there[-1])
        for name in (name for name in one.names if pattern.fullmatch(name) and name in other.names):
            own, values = one[name], other[name]
            theirs = values if np.array_equal(time, there) else np.interp(time, there, values)
            both = inside & np.isfinite(own) & np.isfinite(theirs)
            if both.any():
                first, second = own[both], theirs[both]
                difference, size = _rms(second - first), _rms(first)
                percent = 100 * difference / size if size else None
                yield Difference("series", name, size, _rms(second), units.get(name, ""), difference, percent)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


_SCHEMA = "mocap-id/baseline"
_VERSION = 1
_REGRESS_DIGITS = 9
_ABOUT = (
    "`mocap-id regress` fails if a number changes by more than its tolerance. `tolerances` contains your own "
    "tolerances by patterns of names, such as `lengths_m.*` or `s01/dynamics.*`; the last pattern that fits is used. "
    "An update keeps your tolerances."
)


@dataclass(frozen=True)
class Expected:
    """A value with its tolerance."""

    value: Value  # a number, or a text that must not change; None if unknown
    tolerance: float = 0.0  # in the unit of the value
    unit: str = ""


@dataclass(frozen=True)
class Change:
    """A result of a trial: its value in the baseline, and now."""

    trial: str
    name: str
    before: Value  # value in the baseline; None if unknown
    now: Value
    tolerance: float  # allowed change
    unit: str

    @property
    def tolerance_used(self) -> float:
        """The change divided by its tolerance; infinite if a text changed, or if only one value is known."""
        if round_value(self.before) == round_value(self.now):
            return 0.0
        if not isinstance(self.before, float | int) or not isinstance(self.now, float | int):
            return float("inf")
        return abs(self.now - self.before) / self.tolerance if self.tolerance > 0 else float("inf")


@dataclass(frozen=True)
class Regression:
    """Comparison of recomputed trials with a baseline."""

    moved: tuple[Change, ...]  # results that changed by more than their tolerance
    compared: int  # number of compared results
    unknown: tuple[str, ...]  # trials that are not in the baseline
    messages: Mapping[str, str]  # why a trial failed or was refused, by trial; a message may name files
    nearest: Change | None  # the result with the largest tolerated change; None if no change is tolerated

    @property
    def passed(self) -> bool:
        """Whether every trial is in the baseline and no result changed by more than its tolerance."""
        return not self.moved and not self.unknown


def check_trials(
    named: Sequence[str], baseline: Baseline, backend: Backend, tell: TrialCallback = lambda done: None
) -> Regression:
    """Recompute trials in temporary folders, and return their comparison with a baseline.

    ``named`` is as for :func:`mocap_id.workflows.batch.find_trials`; ``tell`` is called with each finished trial.
    """
    trials = _find_trials(named)
    results, messages = _recompute(trials, backend, tell)
    for trial, digest in _hash_recordings(trials).items():
        if baseline.recordings.get(trial, digest) != digest:
            said = f"\n{messages[trial]}" if trial in messages else ""
            messages[trial] = f"its recording is not the one of the baseline; the contents of the file differ{said}"
    changes, missing = [], Expected(None)
    for trial, now in results.items():
        before = baseline.trials.get(trial, {})
        for name in {**before, **now} if trial in baseline.trials else ():
            expected, actual = before.get(name, missing), now.get(name, missing)
            tolerance = baseline.find_tolerance(trial, name, expected.tolerance)
            unit = expected.unit or actual.unit
            changes.append(Change(trial, name, expected.value, actual.value, tolerance, unit))
    small = [one for one in changes if one.tolerance_used <= 1.0]
    return Regression(
        moved=tuple(one for one in changes if one.tolerance_used > 1.0),
        compared=len(changes),
        unknown=tuple(trial for trial in results if trial not in baseline.trials),
        messages=messages,
        nearest=max(small, key=lambda one: one.tolerance_used, default=None),
    )


def update(
    named: Sequence[str], baseline: Baseline, backend: Backend, tell: TrialCallback = lambda done: None
) -> Baseline:
    """Return the baseline with the current results of the named trials; other trials and tolerances are kept.

    Raises StoreError if the baseline contains the results of another recording with a trial's name.
    """
    trials = _find_trials(named)
    recordings = _hash_recordings(trials)
    for name, digest in recordings.items():
        if baseline.recordings.get(name, digest) != digest:
            raise StoreError(
                f"the baseline contains the results of another recording with the name {name}, and this one would "
                "replace them. Give one of the trials another name (`trial:`). If this is the same recording, exported "
                f'again, delete the entry of {name} in "recordings" of the baseline'
            )
    results, _ = _recompute(trials, backend, tell)
    return Baseline({**baseline.trials, **results}, baseline.tolerances, {**baseline.recordings, **recordings})


def _find_trials(named: Sequence[str]) -> list[Trial]:
    """Return the named trials; raise ConfigError if two have one name."""
    trials = find_readable_trials(named)
    twice = {trial.name for trial in trials if sum(other.name == trial.name for other in trials) > 1}
    if twice:
        raise ConfigError(f"two trials are called {sorted(twice)[0]}: the baseline identifies trials by their names")
    return trials


def _hash_recordings(trials: Sequence[Trial]) -> dict[str, str]:
    """Return the SHA-256 of each trial's recording by trial, without the recordings that cannot be read."""
    owners = {trial.name: find_owner(trial, FileHashes(trial)) for trial in trials}
    return {name: owner.contents[0] for name, owner in owners.items() if owner.contents}


def _recompute(
    trials: Sequence[Trial], backend: Backend, tell: TrialCallback
) -> tuple[dict[str, Mapping[str, Expected]], dict[str, str]]:
    """Return the results by trial, and the messages of failed or refused trials by trial.

    A trial without a summary has only the exit code.
    """
    results: dict[str, Mapping[str, Expected]] = {}
    with tempfile.TemporaryDirectory(prefix="mocap-id-regress-") as folder:
        copies = [replace(trial, out=Path(folder) / trial.name) for trial in trials]
        runs = run_trials(copies, backend, tell)
        for trial, run in zip(copies, runs, strict=True):
            summary = read_summary(trial.out, run)
            failed = {"exit_code": Expected(str(run.exit_code))}
            results[trial.name] = failed if summary is None else dict(list_expected(summary))
    return results, {run.trial: run.message for run in runs if run.message is not None}


@dataclass(frozen=True)
class Baseline:
    """Expected results of trials."""

    trials: Mapping[str, Mapping[str, Expected]] = field(default_factory=dict)  # quantities by trial and name
    # the user's tolerances by pattern of ``NAME`` or ``TRIAL/NAME``, in the unit of the quantity
    tolerances: Mapping[str, float] = field(default_factory=dict)
    recordings: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of the recordings by trial, where known
    product: str = __version__  # version of the program that computed the results

    def find_tolerance(self, trial: str, name: str, usual: float) -> float:
        """Return the user's tolerance of a number, or the ``usual`` tolerance if the user gives none."""
        own = [
            value
            for pattern, value in self.tolerances.items()
            if fnmatchcase(name, pattern) or fnmatchcase(f"{trial}/{name}", pattern)
        ]
        return own[-1] if own else usual

    @classmethod
    def read(cls, file: Path) -> Baseline:
        try:
            data = json.loads(file.read_text("utf-8"))
            if (data["schema"], data["version"]) != (_SCHEMA, _VERSION):
                raise ValueError(f"its schema is {data['schema']!r}, version {data['version']!r}")
            trials = {
                trial: {name: Expected(**one) for name, one in expected.items()}
                for trial, expected in data["trials"].items()
            }
            tolerances = {pattern: float(value) for pattern, value in data["tolerances"].items()}
            recordings = {trial: str(digest) for trial, digest in data.get("recordings", {}).items()}
            return cls(trials, tolerances, recordings, str(data["product"]))
        except FileNotFoundError as error:
            raise RecordingError(
                f"{file}: no such file: create it from the trials' current results with `--update`"
            ) from error
        except OSError as error:
            raise RecordingError(f"{file}: the file cannot be read ({error.strerror})") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            message = f"not a baseline of version {_VERSION} ({error}); expected a file from `regress --update`"
            raise RecordingError(f"{file}: {message}") from error

    def write(self, file: Path) -> None:
        """Write the file completely or not at all; raise StoreError if the file cannot be written."""
        data = {
            "schema": _SCHEMA,
            "version": _VERSION,
            "about": _ABOUT,
            "product": self.product,
            "tolerances": dict(self.tolerances),
            "recordings": dict(self.recordings),
            "trials": {
                trial: {
                    name: {"value": one.value}
                    if isinstance(one.value, str)
                    else {"value": round_value(one.value), "tolerance": round_value(one.tolerance), "unit": one.unit}
                    for name, one in expected.items()
                }
                for trial, expected in self.trials.items()
            },
        }
        file = file.absolute()
        text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        replace_together(file.parent, {file.name: text.encode()})


def round_value(value: Value) -> Value:
    """Return a value, rounded to the precision of the baseline's file; text and None are not changed."""
    return value if value is None or isinstance(value, str) else float(f"{value:.{_REGRESS_DIGITS}g}")


def list_expected(summary: Mapping[str, Any]) -> Iterator[tuple[str, Expected]]:
    """Yield the name and the value of each compared result in summary.json; a name is the path of keys in the file."""
    verdict = summary["verdict"]
    yield "verdict.level", Expected(verdict["level"])
    yield "verdict.codes", Expected(" ".join(sorted({reason["code"] for reason in verdict["reasons"]})))

    plane, segments = summary.get("plane") or {}, summary.get("segments") or {}
    yield "plane.yaw_deg", Expected(plane.get("yaw_deg"), 0.5, "deg")
    yield "segments.names", Expected(" ".join(segments.get("names") or []))
    for marker, segment in sorted((segments.get("assignment") or {}).items()):
        yield f"segments.assignment.{marker}", Expected(str(segment))
    for joint in summary.get("joints") or []:
        centre = joint["centre_m"] or []
        for axis, value, sd in zip("xyz", centre, joint["sd_m"] or [None] * len(centre), strict=False):
            yield f"joints.{joint['name']}.{axis}", _by_interval(value, sd, "m")
        if summary.get("space") == "3d":
            yield f"joints.{joint['name']}.kind", Expected(joint["kind"])
            yield f"joints.{joint['name']}.known", Expected(str(joint["known"]))
    for name, angle in (summary.get("angles") or {}).items():
        low, high = angle["interval_deg"] or (None, None)
        sd = None if low is None or high is None else (high - low) / (2 * NORMAL_95)
        yield f"angles.{name}.range_deg", _by_interval(angle["range_deg"], sd, "deg")
    for name, length in (summary.get("lengths_m") or {}).items():
        yield f"lengths_m.{name}", _by_interval(length["value"], length["sd"], "m")
    markers, noise = summary.get("markers") or {}, summary.get("noise") or {}
    yield "markers.reprojection_rms_mm", _by_share(markers.get("reprojection_rms_mm"), 0.05, "mm")
    yield "markers.missing_fraction", Expected(markers.get("missing_fraction"), 0.001, "")
    yield "noise.marker_sd_m", _by_share(noise.get("marker_sd_m"), 0.05, "m")

    dynamics = summary.get("dynamics") or {}
    for base in dynamics.get("base") or []:
        yield f"dynamics.base.{base['name']}", _by_interval(base["value"], base["sd"], base["unit"])
        yield f"dynamics.base.{base['name']}.verdict", Expected(base.get("verdict") or "")
    yield "dynamics.condition_number", _by_share(dynamics.get("condition_number"), 0.05, "")
    offset, sd = dynamics.get("clock_offset_s"), dynamics.get("clock_offset_sd_s")
    yield "dynamics.clock_offset_s", _by_interval(offset, sd, "s")
    for name, residual in (dynamics.get("wrench") or {}).items():
        yield f"dynamics.wrench.{name}.r2", Expected(residual["r2"], 0.005, "")
        unit = "N*m" if name.startswith("tau") else "N"
        yield f"dynamics.wrench.{name}.sd", _by_share(residual["sd"], 0.05, unit)
    yield "dynamics.cop_rms_m", _by_share(dynamics.get("cop_rms_m"), 0.05, "m")
    yield "dynamics.samples", _by_share(dynamics.get("samples"), 0.02, "")

    repetitions = summary.get("repetitions") or []
    yield "repetitions.count", Expected(str(len(repetitions)))
    for number, one in enumerate(repetitions, start=1):
        for event in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield f"repetitions.{number}.{event}", Expected(one.get(event), 0.02, "s")


def _by_interval(value: float | None, sd: float | None, unit: str) -> Expected:
    """Return a value whose tolerance is half of its 95 % interval, or 5 % if the standard deviation is unknown."""
    if sd is None or not math.isfinite(sd):
        return _by_share(value, 0.05, unit)
    return Expected(value, NORMAL_95 * sd, unit)


def _by_share(value: float | None, share: float, unit: str) -> Expected:
    return Expected(value, 0.0 if value is None else share * abs(value), unit)
