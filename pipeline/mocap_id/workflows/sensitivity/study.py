"""``mocap-id sensitivity``: perturb a trial and write the levels that its parameters tolerate.

From top to bottom: the estimates of a trial and their changes; the runs of the perturbed trials; the tolerated levels;
the tables; the study. Perturbed trials are computed in memory, in parallel processes, whose number does not affect the
results; only the perturbed logs of inertial sensors are files, in a temporary folder.

A perturbation is tolerated if no base parameter changes by more than a fraction of its size (5 % by default), or by its
stated standard deviation if that is larger, because a smaller change is within the uncertainty of the trial. Between
the tested levels, the level at which the first parameter exceeds this limit is interpolated.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import __version__, runner
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, MocapIdError, NumericalError, Refused
from mocap_id.geometry.planar import rotate
from mocap_id.reporting.grids import show
from mocap_id.reporting.results import CommandResult, ResultTable, declare_tables, number, text, to_finite, whole
from mocap_id.reporting.results import ResultColumn as Column
from mocap_id.reporting.sensitivity import Parameter, render_sensitivity_page
from mocap_id.stages.base import Context
from mocap_id.stages.calibration_trial import has_no_markers
from mocap_id.store import Artefact, Folder, Table, Tree
from mocap_id.store.artefacts import Skeleton, joint_columns
from mocap_id.store.folder import check_owner, store_owner
from mocap_id.verdict import Level, overall
from mocap_id.workflows.parallel import LocalBackend
from mocap_id.workflows.run_folder import find_owner_of_files
from mocap_id.workflows.sensitivity.perturbations import (
    ALL,
    COMPONENTS,
    FIRST,
    KINDS,
    Kind,
    KindSelection,
    Perturbation,
    RerunInputs,
    SensitivityOptions,
    locate_trial,
    perturb_logs,
    plan,
    read_rerun_inputs,
    repeated_stages,
)
from mocap_id.workflows.trial_outcome import number_or_nan

STATE_NAMES = ("theta", "dtheta", "ddtheta")
_SAME_TIME = 1e-5  # s: frames with a smaller difference have the same time


@dataclass(frozen=True)
class Estimates:
    """The estimates of a perturbed or unperturbed trial; a number is NaN if unknown."""

    parameters: Mapping[str, Parameter]  # by name
    condition: float  # condition number
    offset: float  # clock offset, s
    cop_rms: float  # rms error of the centre of pressure, m
    wrench_r2: tuple[float, ...]  # r² of Fx, Fy and tauz
    samples: int  # number of samples of the fit
    level: Level  # level of the verdict
    codes: frozenset[str]  # codes of the verdict's reasons, without notes


@dataclass(frozen=True)
class SeriesChanges:
    """Changes of the time series of n joints between the unperturbed and the perturbed trial, at common times."""

    # (3, n) r² of angle, velocity and acceleration relative to the unperturbed series; 1 = no change
    state_r2: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))
    angle_rms: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,) rad
    torque_rms: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,) N·m
    torque_size: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,) rms of the unperturbed torques, N·m


def read_estimates(trial: RerunInputs) -> Estimates:
    """Return the estimates in a trial's artefacts."""
    dynamics, chain = trial.tree("dynamics.h5"), trial.tree("chain.h5")
    parameters = []
    names = ("name", "unit", "value", "sd", "relative_sd", "verdict")
    for name, unit, value, sd, share, verdict in zip(*(dynamics.array(f"base/{one}") for one in names), strict=True):
        # The verdict divides sd by the same size.
        size = float(sd / share) if float(share) > 0 and math.isfinite(sd) else abs(float(value))
        parameters.append(Parameter(str(name), str(unit), float(value), float(sd), size, str(verdict)))
    segments, lengths, sds = (chain.array(f"segments/{one}") for one in ("name", "length", "length_sd"))
    for name, value, sd in zip(segments[1:], lengths, sds, strict=False):  # the last segment has no length
        if math.isfinite(value):
            parameters.append(Parameter(f"length of {name}", "m", float(value), float(sd), float(value)))
    facts = dynamics.facts
    wrench: Mapping[str, Any] = facts["wrench"] or {}
    reasons = [reason for artefact in trial.artefacts.values() for reason in artefact.reasons]
    return Estimates(
        parameters={one.name: one for one in parameters},
        condition=number_or_nan(facts["condition_number"]),
        offset=number_or_nan(facts["clock_offset_s"]),
        cop_rms=number_or_nan(facts["cop_rms_m"]),
        wrench_r2=tuple(number_or_nan((wrench.get(name) or {}).get("r2")) for name in COMPONENTS),
        samples=int(facts["samples"] or 0),
        level=overall(reasons),
        codes=frozenset(reason.code for reason in reasons if reason.level != "ok"),
    )


def compare_series(own: RerunInputs, changed: RerunInputs) -> SeriesChanges:
    """Return the changes of the perturbed series relative to the unperturbed series."""
    # Rows of both trials at their common times; the times increase.
    nearest = np.clip(np.searchsorted(own.time, changed.time - _SAME_TIME), 0, len(own.time) - 1)
    same = np.abs(own.time[nearest] - changed.time) <= _SAME_TIME
    before, now = nearest[same], np.flatnonzero(same)
    states = [(own.states(name)[before], changed.states(name)[now]) for name in STATE_NAMES]
    torques = [
        joint_columns(trial.table("dynamics.parquet"), "tau", len(own.joints))[rows]
        for trial, rows in ((own, before), (changed, now))
    ]
    r2 = []  # of each joint; NaN for a series that is constant or has no common samples
    for one, other in states:
        both = np.isfinite(one) & np.isfinite(other)
        mean = np.where(both, one, 0.0).sum(axis=0) / np.maximum(both.sum(axis=0), 1)
        total = np.where(both, (one - mean) ** 2, 0.0).sum(axis=0)
        residual = np.where(both, (other - one) ** 2, 0.0).sum(axis=0)
        r2.append(np.where(total > 0, 1.0 - residual / np.where(total > 0, total, 1.0), np.nan))
    return SeriesChanges(
        state_r2=np.array(r2),
        angle_rms=_rms(states[0][1] - states[0][0]),
        torque_rms=_rms(torques[1] - torques[0]),
        torque_size=_rms(torques[0]),
    )


def _rms(values: FloatArray) -> FloatArray:
    """Return the root mean square of the known samples of each column; NaN for a column without known samples."""
    known = np.isfinite(values)
    squares = np.where(known, values**2, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), np.sqrt(squares / np.maximum(known.sum(axis=0), 1)), np.nan)


def tolerance_ratio(parameter: Parameter, changed: Parameter | None, tolerance: float) -> float:
    """Return the change of a parameter divided by the tolerated change.

    The tolerated change is ``tolerance`` times the parameter's size, or the standard deviation if that is larger. The
    ratio is NaN if the unperturbed parameter is unknown, and infinite if only the perturbed parameter is unknown.
    """
    if not math.isfinite(parameter.value):
        return math.nan
    if changed is None or not math.isfinite(changed.value):
        return math.inf
    allowed = max(tolerance * parameter.size, parameter.sd if math.isfinite(parameter.sd) else 0.0)
    change = abs(changed.value - parameter.value)
    return change / allowed if allowed > 0 else (math.inf if change > 0 else 0.0)


def largest_ratio(
    own: Estimates, changed: Estimates | None, names: Sequence[str], tolerance: float
) -> tuple[float, str]:
    """Return the largest tolerance ratio of the named parameters, and its parameter; (NaN, "") if none is known."""
    after = {} if changed is None else changed.parameters
    ratios = [(tolerance_ratio(own.parameters[name], after.get(name), tolerance), name) for name in names]
    known = [pair for pair in ratios if not math.isnan(pair[0])]
    return max(known, key=lambda pair: pair[0]) if known else (math.nan, "")


@dataclass(frozen=True)
class PerturbationRun:
    """The result of one perturbation."""

    perturbation: Perturbation
    estimates: Estimates | None  # estimates of the perturbed trial; None if it was refused or failed
    changes: SeriesChanges  # changes from the unperturbed trial; empty if there are no estimates
    why: str  # reason why there are no estimates; empty if there are estimates
    refused: bool  # whether the perturbed trial was refused, rather than failed
    seconds: float  # processor time, s


def perturb(trial: RerunInputs, perturbation: Perturbation) -> RerunInputs:
    """Perturb a trial, compute the dependent artefacts again, and return the trial with these artefacts."""
    kind = perturbation.definition
    if kind.change is not None:
        return run_from(kind.entry, kind.change(trial, perturbation))
    with tempfile.TemporaryDirectory(prefix="mocap-id-") as folder:
        return run_from(kind.entry, perturb_logs(trial, perturbation, Path(folder)))


def run_from(entry: str, trial: RerunInputs) -> RerunInputs:
    """Run a stage and the later stages up to the dynamics, and return the inputs with the new artefacts."""
    stages = repeated_stages()
    first = next(k for k, stage in enumerate(stages) if stage.name == entry)
    own_chain = trial.tree("chain.h5")
    for stage in stages[first:]:
        inputs = {file: trial.artefacts[file] for file in stage.inputs}
        outputs = stage.function(Context(trial.keys, trial.settings[stage.name], inputs))
        trial = trial.with_artefacts(*(one for one in outputs if isinstance(one, Table | Tree)))
        if stage.name == FIRST:
            trial = trial.with_artefacts(_align(trial.tree("chain.h5"), own_chain))
    return trial


def _align(chain: Tree, own: Tree) -> Artefact:
    """Return the chain with its last coordinate frame aligned to the frame of the unperturbed chain ``own``.

    An axis of this frame points to the centroid of the markers. With other markers, its direction is different, which
    changes angle and first moments although the body is the same. The common markers determine the rotation.
    """
    last: list[dict[str, FloatArray]] = []  # coordinates of the last segment's markers by label, m
    for tree in (chain, own):
        names, segment, local = (tree.array(f"markers/{name}") for name in ("name", "segment", "local"))
        last.append({str(names[k]): local[k] for k in np.flatnonzero(segment == segment.max())})
    now, before = last
    common = [label for label in now if label in before]
    if not common:
        return chain
    here, there = (np.array([markers[label] for label in common]) for markers in (now, before))
    cross = float(np.sum(here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0]))
    angle = math.atan2(cross, float(np.sum(here * there)))
    data = {group: dict(nodes) if isinstance(nodes, Mapping) else nodes for group, nodes in chain.data.items()}
    table = data["markers"]
    assert isinstance(table, dict)
    segment, local = np.asarray(table["segment"]), np.asarray(table["local"], dtype=np.float64)
    table["local"] = np.where((segment == segment.max())[:, None], rotate(np.array(angle), local), local)
    return replace(chain, data=data)


def run_perturbation(trial: RerunInputs, perturbation: Perturbation) -> PerturbationRun:
    """Run a perturbed trial; a failure is returned as a result, not raised as an exception."""
    start = time.process_time()
    estimates, changes, why, refused = None, SeriesChanges(), "", False
    try:
        perturbed = perturb(trial, perturbation)
        estimates, changes = read_estimates(perturbed), compare_series(trial, perturbed)
    except MocapIdError as error:
        why, refused = str(error), isinstance(error, Refused)
    except Exception as error:  # noqa: BLE001  a bug in one perturbation must not discard the results of the others
        why = f"an unforeseen failure, {type(error).__name__}: {str(error).partition(chr(10))[0]}"
    return PerturbationRun(perturbation, estimates, changes, why, refused, seconds=time.process_time() - start)


def run_perturbations(
    trial: RerunInputs, perturbations: Sequence[Perturbation], jobs: int, tell: Callable[[PerturbationRun], None]
) -> tuple[PerturbationRun, ...]:
    """Run all perturbations of a trial in parallel processes, which read its artefacts; return the results in order.

    ``tell`` is called with the result of each finished run. NumericalError is raised if a process was killed.
    """
    runs = {}
    # The long runs come first, so that no process waits for another at the end.
    entries = [stage.name for stage in repeated_stages()]
    order = sorted(perturbations, key=lambda one: entries.index(one.definition.entry))
    try:
        with LocalBackend(jobs).workers(len(order)) as (executor, _):
            for future in as_completed([executor.submit(_run_in_worker, trial, one) for one in order]):
                run = future.result()
                tell(run)
                runs[run.perturbation] = run
    except BrokenProcessPool as error:
        message = "a process was killed, perhaps because memory ran out: run again with fewer --jobs"
        raise NumericalError(message) from error
    return tuple(runs[one] for one in perturbations)


_trials: dict[Path, RerunInputs] = {}
"""The trials that this worker process has read, by run folder."""


def _run_in_worker(trial: RerunInputs, perturbation: Perturbation) -> PerturbationRun:
    if trial.folder not in _trials:
        _trials[trial.folder] = read_rerun_inputs(trial)
    return run_perturbation(_trials[trial.folder], perturbation)


# The tolerated levels of each kind of error, and whether the verdict warns of larger errors, also as text.

_UNITS = {"s": ("ms", 1e3), "m": ("mm", 1e3), "of samples": ("% of the samples", 1e2), "rad/s^4": ("rad/s⁴", 1.0)}
_COMPONENT_UNITS = {"Fx": "N", "Fy": "N", "tauz": "N·m"}
_MUCH = 5.0  # %: rms change of a joint torque above which it is mentioned


@dataclass(frozen=True)
class Point:
    """The response to one level of a kind on a target; of two levels with opposite signs, only the worse response."""

    level: float  # absolute value of the level
    ratio: float  # largest change of a parameter, divided by the tolerated change; infinite if parameters are missing
    parameter: str  # the parameter with this change
    percent: float  # the change, % of the parameter's size
    noticed: bool  # whether the verdict has a new caution, or there is no result
    torque: float = math.nan  # largest rms change of a joint torque, % of the rms of the unperturbed torque

    @property
    def is_tolerated(self) -> bool:
        return self.ratio <= 1


@dataclass(frozen=True)
class Tolerance:
    """The tolerated levels of one kind on one target."""

    kind: Kind
    target: str
    # from the mildest to the worst level; ascending levels for a kind that gets worse in both directions
    points: tuple[Point, ...]
    # ends of the tolerated levels, interpolated; NaN if no tested level is tolerated and no end can be estimated
    low: float
    high: float

    @property
    def broken(self) -> Point | None:
        """The mildest level that is not tolerated; for ``kind.worse == "either"``, the level with the largest change.

        None if all levels are tolerated.
        """
        beyond = [point for point in self.points if not point.is_tolerated]
        if self.kind.worse == "either":
            return max(beyond, key=lambda point: point.ratio, default=None)
        return next(iter(beyond), None)

    @property
    def silent(self) -> tuple[float, ...]:
        """Levels that are not tolerated although the verdict has no new caution."""
        return tuple(point.level for point in self.points if not (point.is_tolerated or point.noticed))


def find_tolerances(
    own: Estimates, runs: Sequence[PerturbationRun], names: Sequence[str], share: float
) -> tuple[Tolerance, ...]:
    """Return the tolerated levels of each kind on each target.

    ``own`` are the estimates of the unperturbed trial, ``names`` the parameters whose changes are compared with the
    tolerance, which is the fraction ``share`` of a parameter's size.
    """
    series: dict[tuple[str, str], dict[float, Point]] = {}
    for run in runs:
        points = series.setdefault((run.perturbation.kind, run.perturbation.target), {})
        ratio, name = largest_ratio(own, run.estimates, names, share)
        if math.isnan(ratio):
            continue
        before, percent = own.parameters[name], math.nan
        after = run.estimates.parameters.get(name) if run.estimates is not None else None
        if after is not None and before.size > 0:
            percent = 100 * abs(after.value - before.value) / before.size
        noticed = run.estimates is None or bool(run.estimates.codes - own.codes)
        rms, size = run.changes.torque_rms, run.changes.torque_size
        known = np.isfinite(rms) & (size > 0)
        torque = 100 * float(np.max(rms[known] / size[known])) if known.any() else math.nan
        point = Point(abs(run.perturbation.level), ratio, name, percent, noticed, torque)
        other = points.get(point.level)
        points[point.level] = point if other is None or point.ratio > other.ratio else other
    found = []
    for (name, target), by_level in series.items():
        kind = KINDS[name]
        ordered = tuple(
            sorted(by_level.values(), key=lambda point: -point.level if kind.worse == "less" else point.level)
        )
        low, high = _find_range(ordered) if kind.worse == "either" else (0.0, _find_limit(kind, ordered))
        found.append(Tolerance(kind, target, ordered, low, high))
    return tuple(found)


def _find_limit(kind: Kind, points: Sequence[Point]) -> float:
    """Return the worst level that is tolerated together with all milder levels; NaN if there is no such level.

    Between a tolerated and the next level, it is interpolated.
    """
    mild = None
    for point in points:
        if not point.is_tolerated:
            if not kind.unit:  # a count
                return math.nan if mild is None else mild.level
            if mild is None or mild.level == 0:  # without a perturbation nothing changes
                return point.level / point.ratio if math.isfinite(point.ratio) else math.nan
            return _interpolate(mild, point)
        mild = point
    return math.nan if mild is None else mild.level


def _interpolate(mild: Point, beyond: Point) -> float:
    """Return the level with ratio 1, interpolated by a power law; ``mild.level`` if a ratio is zero or infinite."""
    if not math.isfinite(beyond.ratio) or mild.ratio <= 0:
        return mild.level
    share = math.log(1 / mild.ratio) / math.log(beyond.ratio / mild.ratio)
    return float(mild.level * (beyond.level / mild.level) ** share)


def _find_range(points: Sequence[Point]) -> tuple[float, float]:
    """Return both ends of the tolerated range around the level of least change; NaN if no level is tolerated."""
    if not any(point.is_tolerated for point in points):
        return math.nan, math.nan
    first = last = min(range(len(points)), key=lambda k: points[k].ratio)
    while first > 0 and points[first - 1].is_tolerated:
        first -= 1
    while last < len(points) - 1 and points[last + 1].is_tolerated:
        last += 1
    low = points[first].level if first == 0 else _interpolate(points[first], points[first - 1])
    high = points[last].level if last == len(points) - 1 else _interpolate(points[last], points[last + 1])
    return low, high


def describe_tolerance(one: Tolerance) -> str:
    """Return a sentence: the tolerated levels, the parameter that changes first, and whether the verdict warns."""
    kind, target = one.kind, one.target
    if kind.free:
        about = f"{kind.title}, markers to {1e3 * float(target):g} mm: sigma_v"
    else:
        about = f"{kind.title}, {'all joints' if target == ALL else target}" if target else kind.title
    if not one.points:
        return f"{about}: there is nothing to compare."
    # The range of the tolerated levels.
    few = kind.name == "marker-count"
    if math.isnan(one.low) or math.isnan(one.high):
        levels = "no level that was tried is tolerated"
    else:
        low, high = (_format_level(one, level) for level in (one.low, one.high))
        levels = f"down to {high}" if few else f"up to {high}"
        if kind.worse == "either":
            levels = f"from {low} to {high}" if low != high else f"at {low} alone"
    # Noise changes torques more than parameters, so a large change of a torque at a tolerated level is mentioned.
    points = [point for point in one.points if point.is_tolerated and point.torque > _MUCH]
    torques = ""
    if points:
        most = max(points, key=lambda point: point.torque)
        torques = f"; torques, however, change by {show(most.torque, 2, '%')} (rms) at {_format_level(one, most.level)}"
    broken = one.broken
    if broken is None:
        most = max(one.points, key=lambda point: point.ratio)
        change = f"{most.parameter} changes most, by {_format_percent(most)}"
        return f"{about}: {levels}, all levels that were tried ({change}){torques}."
    # The mildest level that is not tolerated, and whether the verdict warns of it.
    at = _format_level(one, broken.level)
    verb = "change" if few else "changes"
    change = f"{at} {verb} {broken.parameter} by {_format_percent(broken)}"
    if math.isnan(broken.percent):
        change = f"at {at} nothing is identified any more"
    silent = ", ".join(_format_level(one, level) for level in one.silent)
    warning = f"at {silent} the verdict does not warn of it" if silent else "the verdict warns of it"
    if silent and len(one.silent) == sum(not point.is_tolerated for point in one.points):
        warning = "the verdict does not warn of it"
    return f"{about}: {levels}; {change}, and {warning}{torques}."


def _format_level(one: Tolerance, level: float) -> str:
    """Return a level as text, in a usual unit."""
    if one.kind.name == "marker-count":
        return f"{level:g} markers"
    if not one.kind.unit:
        return f"division by {level:g}"
    unit, factor = _UNITS.get(one.kind.unit, (_COMPONENT_UNITS.get(one.target, one.kind.unit), 1.0))
    return f"{float(f'{factor * level:.2g}'):g} {unit}"


def _format_percent(point: Point) -> str:
    return "less than 0.001 %" if point.percent < 1e-3 else show(point.percent, 2, "%")


def describe_failures(runs: Sequence[PerturbationRun]) -> str:
    """Return a note about perturbations that failed without a refusal; empty if no perturbation failed."""
    whys = [run.why for run in runs if run.estimates is None and not run.refused]
    return f"{len(whys)} of {len(runs)} perturbations failed and count as not tolerated ({whys[0]})" if whys else ""


# The tables.


def _broken(name: str, missing: Any) -> Callable[[Tolerance], Any]:
    return lambda one: missing if one.broken is None else getattr(one.broken, name)


_KIND = "kind of the perturbation"
_PERTURBATION = (
    text("perturbation", "kind, target and level", head="perturbation"),
    text("kind", _KIND),
    text("target", "joint, component or marker sd (m) that was perturbed; empty: everything"),
    number("level", "", "level of the perturbation, in `level_unit`"),
    text("level_unit", "unit of the level; empty: a count"),
)
_SD = "its stated standard deviation, in `unit`"

TABLES = declare_tables(
    responses=(
        *_PERTURBATION,
        text("parameter", "base parameter, or length of a segment"),
        text("unit", "unit of the parameter"),
        number("own_value", "", "unperturbed value, in `unit`"),
        number("own_sd", "", _SD),
        number("value", "", "perturbed value, in `unit`"),
        number("sd", "", _SD),
        number("change", "", "perturbed minus unperturbed value, in `unit`"),
        number("change_percent", "%", "change relative to the parameter's size"),
        number("change_sd", "1", "change in stated standard deviations of the unperturbed parameter"),
        number(
            "ratio", "1", "absolute change divided by the tolerated change; infinite if there is no perturbed value"
        ),
        text("judged", "verdict in the perturbed trial: known, weak or not identifiable"),
    ),
    perturbations=(
        *_PERTURBATION,
        text("enters", "the first stage that the perturbation affects"),
        text("verdict", "ok or caution; refused or failed if there is no result"),
        text("raised", "codes that are new in the perturbed verdict"),
        text("fallen", "codes of the unperturbed verdict that no longer occur"),
        number("ratio", "1", "largest change of a parameter divided by the tolerated change"),
        text("parameter", "the parameter with the largest change", head="parameter"),
        Column("tolerated", "bool", "", "whether the ratio is at most 1"),
        whole("samples", "number of samples of the fit"),
        number("condition_number", "1", "condition number of the regressor", head="condition"),
        number("clock_offset", "s", "clock offset that the program estimated"),
        *(number(f"{name}_r2", "1", "r² of the model relative to the measurement") for name in COMPONENTS),
        number("cop_rms", "m", "rms error of the model's centre of pressure"),
        number("theta_r2", "1", "r² of the worst joint's angle relative to the unperturbed angle"),
        number("dtheta_r2", "1", "r² of the worst joint's velocity relative to the unperturbed velocity"),
        number(
            "ddtheta_r2",
            "1",
            "r² of the worst joint's acceleration relative to the unperturbed one",
            head="acceleration r²",
            decimals=4,
        ),
        number("theta_rms", "rad", "change of the worst joint's angle, rms"),
        number("tau_{k}_rms", "N*m", "change of the joint's torque, rms"),
    ),
    tolerates=(
        text("kind", _KIND, lambda one: one.kind.name),
        text("target", "what was perturbed; empty: everything", lambda one: one.target),
        number("low", "", "lowest tolerated level, in `level_unit`", lambda one: one.low),
        number("high", "", "highest tolerated level, interpolated, in `level_unit`", lambda one: one.high),
        text("level_unit", "unit of the levels; empty: a count", lambda one: one.kind.unit),
        number("least_tried", "", "mildest level tried", lambda one: one.points[0].level if one.points else None),
        number("most_tried", "", "worst level tried", lambda one: one.points[-1].level if one.points else None),
        number("breaks_at", "", "mildest level that is not tolerated", _broken("level", None)),
        text("parameter", "the parameter with the largest change at this level", _broken("parameter", "")),
        number("change_percent", "%", "its change, relative to its size", _broken("percent", None)),
        text(
            "silent",
            "levels that are not tolerated and give no new caution in the verdict",
            lambda one: ", ".join(f"{level:g}" for level in one.silent),
        ),
        text("sentence", "the content of the row as a sentence", describe_tolerance),
    ),
)
# The reason is the last column, after those of the joints.
_WHY = text("why", "why there is no result; empty otherwise")
TABLES["perturbations"] = replace(TABLES["perturbations"], optional=((_WHY,),))
"""Schemas of the tables by name."""


def _describe_perturbation(one: Perturbation) -> dict[str, Any]:
    labels = {"perturbation": one.name, "kind": one.kind, "target": one.target}
    return labels | {"level": one.level, "level_unit": one.definition.unit}


def _list_responses(own: Estimates, run: PerturbationRun, share: float) -> Iterator[dict[str, Any]]:
    """Yield the row of each parameter in the table `responses`."""
    parameters = {} if run.estimates is None else run.estimates.parameters
    for name, before in own.parameters.items():
        after = parameters.get(name)
        row = _describe_perturbation(run.perturbation) | {
            "parameter": name,
            "unit": before.unit,
            "own_value": before.value,
            "own_sd": before.sd,
            "ratio": tolerance_ratio(before, after, share),
        }
        if after is not None:
            change = after.value - before.value
            row |= {"value": after.value, "sd": after.sd, "change": change, "judged": after.verdict}
            row |= {"change_percent": 100 * change / before.size} if before.size > 0 else {}
            row |= {"change_sd": change / before.sd} if before.sd > 0 else {}
        yield row


def _describe_run(own: Estimates, run: PerturbationRun, judged: Sequence[str], share: float) -> dict[str, Any]:
    """Return the row of a run in the table `perturbations`."""

    def find_least(values: FloatArray) -> float:
        known = values[np.isfinite(values)]
        return float(known.min()) if len(known) else math.nan

    now = run.estimates
    ratio, parameter = largest_ratio(own, now, judged, share)
    row = _describe_perturbation(run.perturbation) | {
        "enters": run.perturbation.definition.entry,
        "verdict": "refused" if run.refused else "failed",
        "ratio": ratio,
        "parameter": parameter,
        "tolerated": ratio <= 1,
        "samples": 0,
        "why": run.why,
    }
    row |= {f"tau_{j}_rms": float(rms) for j, rms in enumerate(run.changes.torque_rms, start=1)}
    row |= {f"{name}_r2": find_least(r2) for name, r2 in zip(STATE_NAMES, run.changes.state_r2, strict=True)}
    row["theta_rms"] = -find_least(-run.changes.angle_rms)
    if now is None:
        return row
    return row | {
        "verdict": now.level,
        "raised": ", ".join(sorted(now.codes - own.codes)),
        "fallen": ", ".join(sorted(own.codes - now.codes)),
        "samples": now.samples,
        "condition_number": now.condition,
        "clock_offset": now.offset,
        **{f"{name}_r2": r2 for name, r2 in zip(COMPONENTS, now.wrench_r2, strict=True)},
        "cop_rms": now.cop_rms,
    }


DOCUMENT, PAGE = "sensitivity.json", "sensitivity.html"

PerturbationCallback = Callable[[PerturbationRun, int, int], None]
"""Called with each finished perturbation, its number and the number of perturbations."""


def study_sensitivity(
    path: Path,
    options: SensitivityOptions | None = None,
    *,
    jobs: int = 2,
    out: Path | None = None,
    progress: runner.Progress = lambda step: None,
    tell: PerturbationCallback = lambda run, number, total: None,
) -> tuple[Path, tuple[PerturbationRun, ...], Mapping[str, Any]]:
    """Perturb a trial, write the results, and return their folder, all runs, and the content of sensitivity.json.

    The run folder is not changed. ``jobs`` perturbations run at the same time, in separate processes, which does not
    affect the results. The results are in ``out``, by default beside the run folder, with its name and
    ``-sensitivity``. ``progress`` is called with each step of the run that must come first, and ``tell`` with each
    finished perturbation.

    Raises
    ------
    ConfigError
        No perturbation is possible on this trial, or the results would go into its run folder.
    StoreError
        The trial is in space.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.workflows.sensitivity.perturbations.locate_trial`.
    """
    options = options or SensitivityOptions()
    source = locate_trial(path, progress)
    folder = out or source.folder.with_name(f"{source.folder.name}-sensitivity")
    if folder.resolve() == source.folder.resolve():
        raise ConfigError(f"--out {folder}: this is the trial's own run folder: choose a different folder")
    trial = read_rerun_inputs(source)
    Skeleton(trial.tree("chain.h5"))  # raises StoreError for a trial in space
    selections, left_out = _select_possible(options.selections, trial)
    perturbations = plan(selections, trial.joints, options.seed)
    numbers, share = count(1), options.tolerance
    with Folder(folder).locked():
        owner = find_owner_of_files(source.folder)
        check_owner(folder, owner, DOCUMENT)
        runs = run_perturbations(source, perturbations, jobs, lambda run: tell(run, next(numbers), len(perturbations)))
        note = "; ".join(filter(None, (left_out, describe_failures(runs))))
        own = read_estimates(trial)
        # The parameters with a tolerance: base parameters, or lengths if there are no base parameters.
        known = [one for one in own.parameters.values() if math.isfinite(one.value)]
        judged = tuple(one.name for one in known if bool(one.verdict) == bool(own.samples))
        rows = {
            "responses": (row for run in runs for row in _list_responses(own, run, share)),
            "perturbations": (_describe_run(own, run, judged, share) for run in runs),
            "tolerates": find_tolerances(own, runs, judged, share),
        }
        tables = {name: ResultTable.of(schema, rows[name]) for name, schema in TABLES.items()}

        def make_page() -> dict[str, bytes]:
            page = render_sensitivity_page(
                trial=trial.name,
                verdict=own.level,
                note=note,
                tolerance=share,
                seed=options.seed,
                parameters=[own.parameters[name] for name in judged],
                titles={run.perturbation.kind: run.perturbation.definition.title for run in runs},
                tables=tables,
            )
            return {PAGE: page}

        def describe(one: Parameter) -> dict[str, Any]:
            numbers = {name: to_finite(getattr(one, name)) for name in ("value", "sd", "size")}
            return asdict(one) | numbers | {"verdict": one.verdict or None}

        content = {
            "trial": trial.name,
            "product": __version__,
            "seed": options.seed,
            "tolerance": {"share_of_size": share, "or_stated_sd": 1.0},
            "note": note or None,
            "verdict": {"level": own.level, "codes": sorted(own.codes)},
            "condition_number": to_finite(own.condition),
            "parameters": [describe(one) for one in own.parameters.values()],
            "tolerates": tables["tolerates"].records,
            "perturbations": tables["perturbations"].records,
            "tables": {name: table.columns for name, table in tables.items()},
        }
        output = CommandResult("sensitivity", DOCUMENT, content, tables, make_page, hashed=True)
        output.write(folder)
        store_owner(folder, owner, DOCUMENT)
    return folder, runs, output.document


def _select_possible(selections: Sequence[KindSelection], trial: RerunInputs) -> tuple[tuple[KindSelection, ...], str]:
    """Return the selections that are possible on a trial, and a note on the selections that are left out."""
    name = f"trial {trial.name}"
    if has_no_markers(trial.long("planar.parquet").facts):
        raise ConfigError(
            f"{name} has only inertial sensors and takes its lengths from a calibration, so no perturbation can "
            "change them: choose a trial with markers"
        )
    if not trial.keys.imus:
        selections = tuple(one for one in selections if KINDS[one.kind].change_log is None)
        if not selections:
            raise ConfigError(f"{name} has no inertial sensors, so their errors cannot be studied")
    facts = trial.tree("dynamics.h5").facts
    if trial.has_plate and facts["samples"]:
        return tuple(selections), ""
    possible = tuple(one for one in selections if KINDS[one.kind].entry == FIRST)
    others = dict.fromkeys(KINDS[one.kind].title for one in selections if one not in possible)
    left_out = f"; left out, because they do not change lengths: {', '.join(others)}" if others else ""
    if not possible:
        missing = "no identified parameters" if trial.has_plate else "no force plate"
        raise ConfigError(f"{name} has {missing}, so there is nothing to study{left_out}")
    note = f"no parameters were identified ({facts['why']})" if trial.has_plate else "there is no force plate"
    return possible, f"{note}: only lengths and states are compared{left_out}"
