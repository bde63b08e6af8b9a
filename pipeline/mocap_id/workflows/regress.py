"""Regression check: recompute trials and compare their main results with a baseline."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeAlias

from mocap_id import __version__
from mocap_id.arrays import NORMAL_95
from mocap_id.config import Trial
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.store.atomic import replace_together
from mocap_id.workflows.batch import find_readable_trials
from mocap_id.workflows.parallel import Backend, TrialCallback, TrialRun, run_trials
from mocap_id.workflows.trial_outcome import read_summary

__all__ = ["Baseline", "Change", "Regression", "regress", "update"]


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


def regress(
    named: Sequence[str], baseline: Baseline, backend: Backend, tell: TrialCallback = lambda done: None
) -> Regression:
    """Recompute trials in temporary folders, and return their comparison with a baseline.

    ``named`` is as for :func:`mocap_id.workflows.batch.find_trials`; ``tell`` is called with each finished trial.

    Raises
    ------
    ConfigError
        A name matches no trial, or a trial's file is invalid.
    """
    results, messages = _run(named, backend, tell)
    known = {trial: now for trial, now in results.items() if trial in baseline.trials}
    changes = [one for trial, now in known.items() for one in _compare(trial, baseline, now)]
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
    """Return the baseline with the current results of the named trials; other trials and tolerances are kept."""
    results, _ = _run(named, backend, tell)
    return Baseline({**baseline.trials, **results}, baseline.tolerances)


def _compare(trial: str, baseline: Baseline, now: Mapping[str, Quantity]) -> Iterator[Change]:
    before, missing = baseline.trials[trial], Quantity(None)
    for name in {**before, **now}:
        expected, actual = before.get(name, missing), now.get(name, missing)
        tolerance = baseline.find_tolerance(trial, name, expected.tolerance)
        yield Change(trial, name, expected.value, actual.value, tolerance, expected.unit or actual.unit)


def _run(
    named: Sequence[str], backend: Backend, tell: TrialCallback
) -> tuple[dict[str, Mapping[str, Quantity]], Mapping[str, str]]:
    """Return the results by trial, and the messages of failed or refused trials by trial."""
    trials = find_readable_trials(named)
    twice = {trial.name for trial in trials if sum(other.name == trial.name for other in trials) > 1}
    if twice:
        raise ConfigError(f"two trials are called {sorted(twice)[0]}: the baseline identifies trials by their names")
    with tempfile.TemporaryDirectory(prefix="mocap-id-regress-") as folder:
        copies = [replace(trial, out=Path(folder) / trial.name) for trial in trials]
        runs = run_trials(copies, backend, tell)
        results = {trial.name: _read_results(trial, run) for trial, run in zip(copies, runs, strict=True)}
    return results, {run.trial: run.message for run in runs if run.message is not None}


def _read_results(trial: Trial, run: TrialRun) -> Mapping[str, Quantity]:
    """Return the quantities of a trial; for a trial without a summary, return only the exit code."""
    summary = read_summary(trial.out, run)
    return {"exit_code": Quantity(str(run.exit_code))} if summary is None else quantities(summary)


_SCHEMA = "mocap-id/baseline"
_VERSION = 1
_DIGITS = 9
_ABOUT = (
    "`mocap-id regress` fails if a number changes by more than its tolerance. `tolerances` contains your own "
    "tolerances by patterns of names, such as `lengths_m.*` or `s01/dynamics.*`; the last pattern that fits is used. "
    "An update keeps your tolerances."
)


@dataclass(frozen=True)
class Baseline:
    """Expected results of trials."""

    trials: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)  # quantities by trial and name
    # the user's tolerances by pattern of ``NAME`` or ``TRIAL/NAME``, in the unit of the quantity
    tolerances: Mapping[str, float] = field(default_factory=dict)
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
        """Read a baseline.

        Raises
        ------
        RecordingError
            The file is missing, cannot be read, or is not a baseline.
        """
        try:
            data = json.loads(file.read_text("utf-8"))
            if (data["schema"], data["version"]) != (_SCHEMA, _VERSION):
                raise ValueError(f"its schema is {data['schema']!r}, version {data['version']!r}")
            trials = {
                trial: {name: Quantity(**one) for name, one in quantities.items()}
                for trial, quantities in data["trials"].items()
            }
            tolerances = {pattern: float(value) for pattern, value in data["tolerances"].items()}
            return cls(trials, tolerances, str(data["product"]))
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
        trials = {
            trial: {name: _as_json(one) for name, one in quantities.items()}
            for trial, quantities in self.trials.items()
        }
        data = {
            "schema": _SCHEMA,
            "version": _VERSION,
            "about": _ABOUT,
            "product": self.product,
            "tolerances": dict(self.tolerances),
            "trials": trials,
        }
        file = file.absolute()
        text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        replace_together(file.parent, {file.name: text.encode()})


def round_value(value: Value) -> Value:
    """Return a value, rounded to the precision of the baseline's file; text and None are not changed."""
    return value if value is None or isinstance(value, str) else float(f"{value:.{_DIGITS}g}")


def _as_json(one: Quantity) -> dict[str, Any]:
    if isinstance(one.value, str):
        return {"value": one.value}
    return {"value": round_value(one.value), "tolerance": round_value(one.tolerance), "unit": one.unit}


Value: TypeAlias = float | str | None


@dataclass(frozen=True)
class Quantity:
    """A value with its tolerance."""

    value: Value  # a number, or a text that must not change; None if unknown
    tolerance: float = 0.0  # in the unit of the value
    unit: str = ""


def quantities(summary: Mapping[str, Any]) -> dict[str, Quantity]:
    """Return the quantities in a trial's summary.json by name; a name is the path of keys in the file."""
    return {
        **dict(_list_verdict(summary)),
        **dict(_list_skeleton(summary)),
        **dict(_list_dynamics(summary.get("dynamics") or {})),
        **dict(_list_repetitions(summary.get("repetitions") or [])),
    }


def _list_verdict(summary: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    verdict = summary["verdict"]
    yield "verdict.level", Quantity(verdict["level"])
    yield "verdict.codes", Quantity(" ".join(sorted({reason["code"] for reason in verdict["reasons"]})))


def _list_skeleton(summary: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    plane, segments = summary.get("plane") or {}, summary.get("segments") or {}
    markers, noise = summary.get("markers") or {}, summary.get("noise") or {}
    yield "plane.yaw_deg", Quantity(plane.get("yaw_deg"), 0.5, "deg")
    yield "segments.names", Quantity(" ".join(segments.get("names") or []))
    for marker, segment in sorted((segments.get("assignment") or {}).items()):
        yield f"segments.assignment.{marker}", Quantity(str(segment))
    for joint in summary.get("joints") or []:
        centre = joint["centre_m"] or []
        for axis, value, sd in zip("xyz", centre, joint["sd_m"] or [None] * len(centre), strict=False):
            yield f"joints.{joint['name']}.{axis}", _make_with_interval(value, sd, "m")
        if summary.get("space") == "3d":
            yield f"joints.{joint['name']}.kind", Quantity(joint["kind"])
            yield f"joints.{joint['name']}.known", Quantity(str(joint["known"]))
    for name, angle in (summary.get("angles") or {}).items():
        low, high = angle["interval_deg"] or (None, None)
        sd = None if low is None or high is None else (high - low) / (2 * NORMAL_95)
        yield f"angles.{name}.range_deg", _make_with_interval(angle["range_deg"], sd, "deg")
    for name, length in (summary.get("lengths_m") or {}).items():
        yield f"lengths_m.{name}", _make_with_interval(length["value"], length["sd"], "m")
    yield "markers.reprojection_rms_mm", _make_relative(markers.get("reprojection_rms_mm"), 0.05, "mm")
    yield "markers.missing_fraction", Quantity(markers.get("missing_fraction"), 0.001, "")
    yield "noise.marker_sd_m", _make_relative(noise.get("marker_sd_m"), 0.05, "m")


def _list_dynamics(dynamics: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    for base in dynamics.get("base") or []:
        yield f"dynamics.base.{base['name']}", _make_with_interval(base["value"], base["sd"], base["unit"])
        yield f"dynamics.base.{base['name']}.verdict", Quantity(base.get("verdict") or "")
    yield "dynamics.condition_number", _make_relative(dynamics.get("condition_number"), 0.05, "")
    offset, sd = dynamics.get("clock_offset_s"), dynamics.get("clock_offset_sd_s")
    yield "dynamics.clock_offset_s", _make_with_interval(offset, sd, "s")
    for name, residual in (dynamics.get("wrench") or {}).items():
        yield f"dynamics.wrench.{name}.r2", Quantity(residual["r2"], 0.005, "")
        yield (
            f"dynamics.wrench.{name}.sd",
            _make_relative(residual["sd"], 0.05, "N*m" if name.startswith("tau") else "N"),
        )
    yield "dynamics.cop_rms_m", _make_relative(dynamics.get("cop_rms_m"), 0.05, "m")
    yield "dynamics.samples", _make_relative(dynamics.get("samples"), 0.02, "")


def _list_repetitions(repetitions: list[Mapping[str, Any]]) -> Iterator[tuple[str, Quantity]]:
    yield "repetitions.count", Quantity(str(len(repetitions)))
    for number, one in enumerate(repetitions, start=1):
        for event in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield f"repetitions.{number}.{event}", Quantity(one.get(event), 0.02, "s")


def _make_with_interval(value: float | None, sd: float | None, unit: str) -> Quantity:
    """Return a quantity whose tolerance is half of its 95 % interval, or 5 % if the standard deviation is unknown."""
    if sd is None or not math.isfinite(sd):
        return _make_relative(value, 0.05, unit)
    return Quantity(value, NORMAL_95 * sd, unit)


def _make_relative(value: float | None, share: float, unit: str) -> Quantity:
    return Quantity(value, 0.0 if value is None else share * abs(value), unit)
