"""``mocap-id sensitivity``: perturb a trial and write the levels that its parameters tolerate.

From top to bottom: the options and the perturbations to run; the tolerated levels; the tables; the study. A
perturbation is tolerated if no base parameter changes by more than a fraction of its size (5 % by default), or by its
stated standard deviation if that is larger, because a smaller change is within the uncertainty of the trial. Between
the tested levels, the level at which the first parameter exceeds this limit is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from mocap_id import __version__, runner
from mocap_id.arrays import FloatArray
from mocap_id.config.parsing import Source, parse, raise_mistakes, read, suggest_name
from mocap_id.errors import ConfigError
from mocap_id.reporting.numbers import show
from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import ResultTable, declare_tables, number, text, to_finite, whole
from mocap_id.reporting.results.result import Result
from mocap_id.reporting.sensitivity import Parameter, SensitivityData, render_sensitivity_page
from mocap_id.stages.base import Settings
from mocap_id.stages.calibration_trial import has_no_markers
from mocap_id.store import Folder
from mocap_id.store.ownership import check_owner, store_owner
from mocap_id.store.views import Skeleton
from mocap_id.workflows.run_folder import find_owner_of_files
from mocap_id.workflows.sensitivity.perturbations import (
    ALL,
    COMPONENTS,
    FIRST,
    JOINTS,
    KINDS,
    SEED,
    Kind,
    Perturbation,
    RerunInputs,
    locate_trial,
    read_rerun_inputs,
)
from mocap_id.workflows.sensitivity.runs import (
    STATE_NAMES,
    Estimates,
    PerturbationRun,
    largest_ratio,
    read_estimates,
    run_perturbations,
    tolerance_ratio,
)

# The perturbations to run, from the user's options: each kind with each of its levels on each of its targets.


@dataclass(frozen=True)
class KindSelection:
    """A kind of perturbation with levels and targets; an empty tuple means the defaults."""

    kind: str
    levels: tuple[float, ...] = ()
    targets: tuple[str, ...] = ()


ALL_KINDS = tuple(KindSelection(kind) for kind in KINDS)
"""All kinds with their default levels and targets."""


@dataclass(frozen=True)
class SensitivityOptions:
    """The options of a sensitivity study."""

    selections: tuple[KindSelection, ...] = ALL_KINDS
    seed: int = SEED
    tolerance: float = 0.05  # tolerated change of a base parameter, as a fraction of its size

    def only(self, kinds: Sequence[str]) -> SensitivityOptions:
        """Return the options with only the selections of ``kinds``; the same options if ``kinds`` is empty."""
        for name in kinds:
            if name not in KINDS:
                raise ConfigError(
                    f"--only {name}: there is no perturbation of this kind: {suggest_name(name, list(KINDS))}"
                )
        selections = tuple(one for one in self.selections if not kinds or one.kind in kinds)
        if not selections:
            raise ConfigError(f"--only {', '.join(kinds)}: the settings file does not contain these kinds")
        return replace(self, selections=selections)


class _Entry(Settings):
    kind: str = Field(description="what is perturbed")
    levels: tuple[float, ...] = Field((), description="levels to try, in the kind's unit; if not given, its defaults")
    on: tuple[str | float, ...] = Field((), description="joints, components or marker sd; if not given, the defaults")


class _File(Settings):
    seed: int = Field(SEED, ge=0, description="seed of the random numbers")
    tolerance: float = Field(5.0, gt=0, description="tolerated change of a base parameter, % of its size")
    perturbations: tuple[_Entry, ...] = Field((), description="perturbations to try; all kinds if not given")


def read_options(file: Path) -> SensitivityOptions:
    """Read and check a settings file; ConfigError has a line for each mistake."""
    source = read(file.absolute())
    if isinstance(source.data, list):
        moved = {("perturbations", *key): line for key, line in source.lines.items()}
        source = Source(source.file, {"perturbations": source.data}, {(): 1, **moved})
    parsed = parse(source, _File, "a list of perturbations, each with a `kind:`")
    selections = tuple(
        KindSelection(one.kind, one.levels, tuple(name if isinstance(name, str) else f"{name:g}" for name in one.on))
        for one in parsed.perturbations
    )
    raise_mistakes(line for number, one in enumerate(selections) for line in _find_mistakes(one, number, source))
    return SensitivityOptions(selections or ALL_KINDS, parsed.seed, parsed.tolerance / 100)


def _find_mistakes(entry: KindSelection, number: int, source: Source) -> Iterator[str]:
    """Yield a message for each mistake in an entry that the types of the settings do not exclude."""
    key = ("perturbations", number)
    kind = KINDS.get(entry.kind)
    if kind is None:
        where = source.where((*key, "kind"))
        yield f"{where}: there is no perturbation `{entry.kind}`: {suggest_name(entry.kind, list(KINDS))}"
        return
    for k, level in enumerate(entry.levels):
        if not kind.allowed(level):
            yield f"{source.where((*key, 'levels', k))}: {kind.name}: the level {level:g} is not {kind.expected}"
    for k, name in enumerate(entry.targets):
        where = source.where((*key, "on", k))
        if kind.free:
            try:
                is_positive = float(name) > 0
            except ValueError:
                is_positive = False
            if not is_positive:
                yield f"{where}: {kind.name}: `on` is {name!r}; expected a marker's standard deviation above 0, m"
        elif not kind.targets:
            yield f"{where}: {kind.name} acts on everything: leave out `on`"
        elif kind.targets != JOINTS and name not in kind.targets:
            yield f"{where}: {kind.name}: there is no {name!r}: {suggest_name(name, list(kind.targets))}"


def plan(selections: Sequence[KindSelection], joints: Sequence[str], seed: int = SEED) -> tuple[Perturbation, ...]:
    """Return the perturbations of a trial with these joints that the selections describe, without duplicates."""
    found: list[Perturbation] = []
    for one in selections:
        kind = KINDS[one.kind]
        possible = (*joints, ALL) if kind.targets == JOINTS else kind.targets
        wrong = [target for target in one.targets if target not in possible and not kind.free]
        if wrong:
            ways = f"expected one of {', '.join(possible)}" if possible else "this kind has no target: leave out `on`"
            raise ConfigError(f"{kind.name}: there is no {wrong[0]!r} to perturb in this trial; {ways}")
        usual = kind.usual or possible or ("",)
        if len(joints) == 1 and kind.targets == JOINTS:
            usual = tuple(joints)  # with a single joint, "all" would be the same target
        found += [
            Perturbation(one.kind, target, float(level), seed)
            for target in one.targets or usual
            for level in one.levels or kind.levels
        ]
    return tuple(dict.fromkeys(found))


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


def _list_responses(result: SensitivityResult, run: PerturbationRun) -> Iterator[dict[str, Any]]:
    """Yield the row of each parameter in the table `responses`."""
    parameters = {} if run.estimates is None else run.estimates.parameters
    for name, before in result.own.parameters.items():
        after = parameters.get(name)
        row = _describe_perturbation(run.perturbation) | {
            "parameter": name,
            "unit": before.unit,
            "own_value": before.value,
            "own_sd": before.sd,
            "ratio": tolerance_ratio(before, after, result.options.tolerance),
        }
        if after is not None:
            change = after.value - before.value
            row |= {"value": after.value, "sd": after.sd, "change": change, "judged": after.verdict}
            row |= {"change_percent": 100 * change / before.size} if before.size > 0 else {}
            row |= {"change_sd": change / before.sd} if before.sd > 0 else {}
        yield row


def _describe_run(result: SensitivityResult, run: PerturbationRun) -> dict[str, Any]:
    """Return the row of a run in the table `perturbations`."""

    def find_least(values: FloatArray) -> float:
        known = values[np.isfinite(values)]
        return float(known.min()) if len(known) else math.nan

    own, now, change = result.own, run.estimates, run.perturbation
    ratio, parameter = largest_ratio(own, now, result.judged_parameters, result.options.tolerance)
    row = _describe_perturbation(change) | {
        "enters": change.definition.entry,
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


@dataclass(frozen=True)
class SensitivityResult:
    """The result of a sensitivity study."""

    trial: str  # name of the trial
    options: SensitivityOptions
    own: Estimates  # estimates of the unperturbed trial
    runs: tuple[PerturbationRun, ...]
    note: str  # what could not be studied on this trial, and what failed; empty if all was studied
    folder: Path  # folder of the results
    document: Mapping[str, Any] = field(default_factory=dict)  # content of sensitivity.json

    @property
    def judged_parameters(self) -> tuple[str, ...]:
        """Names of the parameters with a tolerance: base parameters, or lengths if there are no base parameters."""
        known = [one for one in self.own.parameters.values() if math.isfinite(one.value)]
        return tuple(one.name for one in known if bool(one.verdict) == bool(self.own.samples))


def study_sensitivity(
    path: Path,
    options: SensitivityOptions | None = None,
    *,
    jobs: int = 2,
    out: Path | None = None,
    progress: runner.Progress = lambda step: None,
    tell: PerturbationCallback = lambda run, number, total: None,
) -> SensitivityResult:
    """Perturb a trial, write the results, and return them; the run folder is not changed.

    ``jobs`` perturbations run at the same time, in separate processes, which does not affect the results. The results
    are in ``out``, by default beside the run folder, with its name and ``-sensitivity``. ``progress`` is called with
    each step of the run that must come first, and ``tell`` with each finished perturbation.

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
    Skeleton.from_tree(trial.tree("chain.h5"))  # raises StoreError for a trial in space
    selections, note = _select_possible(options.selections, trial)
    perturbations = plan(selections, trial.joints, options.seed)
    numbers = count(1)
    with Folder(folder).locked():
        owner = find_owner_of_files(source.folder)
        check_owner(folder, owner, DOCUMENT)
        runs = run_perturbations(source, perturbations, jobs, lambda run: tell(run, next(numbers), len(perturbations)))
        notes = "; ".join(filter(None, (note, describe_failures(runs))))
        result = SensitivityResult(source.name, options, read_estimates(trial), runs, notes, folder)
        output = _make_output(result)
        output.write(folder)
        store_owner(folder, owner, DOCUMENT)
    return replace(result, document=output.document)


def _select_possible(selections: Sequence[KindSelection], trial: RerunInputs) -> tuple[tuple[KindSelection, ...], str]:
    """Return the selections that are possible on a trial, and a note on the selections that are left out."""
    name = f"trial {trial.source.name}"
    if has_no_markers(trial.long("planar.parquet").facts):
        raise ConfigError(
            f"{name} has only inertial sensors and takes its lengths from a calibration, so no perturbation can "
            "change them: choose a trial with markers"
        )
    if not trial.source.keys.imus:
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


def _make_output(result: SensitivityResult) -> Result:
    own, judged, share = result.own, result.judged_parameters, result.options.tolerance
    rows = {
        "responses": (row for run in result.runs for row in _list_responses(result, run)),
        "perturbations": (_describe_run(result, run) for run in result.runs),
        "tolerates": find_tolerances(own, result.runs, judged, share),
    }
    tables = {name: ResultTable.of(schema, rows[name]) for name, schema in TABLES.items()}

    def make_page() -> dict[str, bytes]:
        data = SensitivityData(
            trial=result.trial,
            verdict=own.level,
            note=result.note,
            tolerance=share,
            seed=result.options.seed,
            parameters=tuple(own.parameters[name] for name in judged),
            titles={run.perturbation.kind: run.perturbation.definition.title for run in result.runs},
            tables=tables,
        )
        return {PAGE: render_sensitivity_page(data)}

    def describe(one: Parameter) -> dict[str, Any]:
        numbers = {name: to_finite(getattr(one, name)) for name in ("value", "sd", "size")}
        return asdict(one) | numbers | {"verdict": one.verdict or None}

    content = {
        "trial": result.trial,
        "product": __version__,
        "seed": result.options.seed,
        "tolerance": {"share_of_size": share, "or_stated_sd": 1.0},
        "note": result.note or None,
        "verdict": {"level": own.level, "codes": sorted(own.codes)},
        "condition_number": to_finite(own.condition),
        "parameters": [describe(one) for one in own.parameters.values()],
        "tolerates": tables["tolerates"].records,
        "perturbations": tables["perturbations"].records,
        "tables": {name: table.columns for name, table in tables.items()},
    }
    return Result("sensitivity", DOCUMENT, content, tables, make_page, hashed=True)
