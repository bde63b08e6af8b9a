"""Regression check: recompute trials and compare their main results with a baseline."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from mocap_id import __version__
from mocap_id.arrays import NORMAL_95
from mocap_id.errors import ConfigError, RecordingError, StoreError
from mocap_id.runner.dependencies import FileHashes, find_owner
from mocap_id.store.atomic import replace_together
from mocap_id.workflows.batch import find_readable_trials
from mocap_id.workflows.parallel import Backend, TrialCallback, run_trials
from mocap_id.workflows.trial_outcome import read_summary

if TYPE_CHECKING:
    from mocap_id.config.trial import Trial

_SCHEMA = "mocap-id/baseline"
_VERSION = 1
_DIGITS = 9
_ABOUT = (
    "`mocap-id regress` fails if a number changes by more than its tolerance. `tolerances` contains your own "
    "tolerances by patterns of names, such as `lengths_m.*` or `s01/dynamics.*`; the last pattern that fits is used. "
    "An update keeps your tolerances."
)
Value: TypeAlias = float | str | None


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
    return value if value is None or isinstance(value, str) else float(f"{value:.{_DIGITS}g}")


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
