"""``mocap-id sensitivity``: perturb a trial and write the levels that its parameters tolerate."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any

from mocap_id import __version__, runner
from mocap_id.errors import ConfigError
from mocap_id.reporting.results.columns import ResultTable, to_finite
from mocap_id.reporting.results.result import Result
from mocap_id.reporting.sensitivity.page_data import ParameterEntry, SensitivityData
from mocap_id.stages.calibration_trial import has_no_markers
from mocap_id.store import Folder
from mocap_id.store.ownership import check_owner, store_owner
from mocap_id.store.views import Skeleton
from mocap_id.workflows.run_folder import find_owner_of_files
from mocap_id.workflows.sensitivity.kinds import KINDS
from mocap_id.workflows.sensitivity.plan import KindSelection, SensitivityOptions, plan
from mocap_id.workflows.sensitivity.responses import Estimates, Parameter, read_estimates
from mocap_id.workflows.sensitivity.runs import PerturbationRun, run_perturbations
from mocap_id.workflows.sensitivity.tables import make_tables
from mocap_id.workflows.sensitivity.tolerance import Tolerance, describe_failures, find_tolerances
from mocap_id.workflows.sensitivity.trial_inputs import TrialInputs, locate_trial, read_inputs

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

    @property
    def judged_parameters(self) -> tuple[str, ...]:
        """Names of the parameters with a tolerance: base parameters, or lengths if there are no base parameters."""
        known = [one for one in self.own.parameters.values() if math.isfinite(one.value)]
        return tuple(one.name for one in known if bool(one.verdict) == bool(self.own.samples))

    @cached_property
    def tolerances(self) -> tuple[Tolerance, ...]:
        """The tolerated levels of each kind on each target."""
        return find_tolerances(self.own, self.runs, self.judged_parameters, self.options.tolerance)


@dataclass(frozen=True)
class SensitivityOutput:
    """A sensitivity study with its folder and the content of sensitivity.json."""

    result: SensitivityResult
    folder: Path
    document: Mapping[str, Any]


def sensitivity(
    path: Path,
    options: SensitivityOptions | None = None,
    *,
    jobs: int = 2,
    out: Path | None = None,
    progress: runner.Progress = lambda step: None,
    tell: PerturbationCallback = lambda run, number, total: None,
) -> SensitivityOutput:
    """Perturb a trial, write the results, and return them.

    Parameters
    ----------
    path : Path
        The trial's YAML file or run folder. Perturbations do not change the run folder.
    options : SensitivityOptions, optional
        The perturbations; all of them by default.
    jobs : int
        Number of perturbations that run at the same time, in separate processes. It does not affect the results.
    out : Path, optional
        Folder of the results; by default beside the run folder, with the same name and ``-sensitivity``.
    progress : callable, optional
        Called with each step of the run that must come first.
    tell : callable, optional
        Called with each finished perturbation.

    Raises
    ------
    ConfigError
        No perturbation is possible on this trial, or the results would go into its run folder.
    StoreError
        The trial is in space.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.workflows.sensitivity.trial_inputs.locate_trial`.
    """
    options = options or SensitivityOptions()
    source = locate_trial(path, progress)
    folder = out or source.folder.with_name(f"{source.folder.name}-sensitivity")
    if folder.resolve() == source.folder.resolve():
        raise ConfigError(f"--out {folder}: this is the trial's own run folder: choose a different folder")
    trial = read_inputs(source)
    Skeleton.from_tree(trial.tree("chain.h5"))  # raises StoreError for a trial in space
    selections, note = _select_possible(options.selections, trial)
    perturbations = plan(selections, trial.joints, options.seed)
    numbers = count(1)
    with Folder(folder).locked():
        owner = find_owner_of_files(source.folder)
        check_owner(folder, owner, DOCUMENT)
        runs = run_perturbations(source, perturbations, jobs, lambda run: tell(run, next(numbers), len(perturbations)))
        notes = "; ".join(filter(None, (note, describe_failures(runs))))
        result = SensitivityResult(source.name, options, read_estimates(trial), runs, notes)
        output = _make_output(result)
        output.write(folder)
        store_owner(folder, owner, DOCUMENT)
    return SensitivityOutput(result, folder, output.document)


def _select_possible(selections: Sequence[KindSelection], trial: TrialInputs) -> tuple[tuple[KindSelection, ...], str]:
    """Return the selections that are possible on a trial, and a note on the selections that are left out."""
    name = f"trial {trial.source.name}"
    if has_no_markers(trial.long("planar.parquet").facts):
        raise ConfigError(
            f"{name} has only inertial sensors and takes its lengths from a calibration, so no perturbation can "
            "change them: choose a trial with markers"
        )
    if not trial.source.keys.imus:
        selections = tuple(one for one in selections if not KINDS[one.kind].needs_imus)
        if not selections:
            raise ConfigError(f"{name} has no inertial sensors, so their errors cannot be studied")
    facts = trial.tree("dynamics.h5").facts
    if trial.has_plate and facts["samples"]:
        return tuple(selections), ""
    possible = tuple(one for one in selections if KINDS[one.kind].changes_lengths)
    others = dict.fromkeys(KINDS[one.kind].title for one in selections if one not in possible)
    left_out = f"; left out, because they do not change lengths: {', '.join(others)}" if others else ""
    if not possible:
        missing = "no identified parameters" if trial.has_plate else "no force plate"
        raise ConfigError(f"{name} has {missing}, so there is nothing to study{left_out}")
    note = f"no parameters were identified ({facts['why']})" if trial.has_plate else "there is no force plate"
    return possible, f"{note}: only lengths and states are compared{left_out}"


def _make_output(result: SensitivityResult) -> Result:
    tables, own = make_tables(result), result.own

    def make_page() -> dict[str, bytes]:
        from mocap_id.reporting.sensitivity.page import render_sensitivity_page  # noqa: PLC0415  it loads the page's templates

        return {PAGE: render_sensitivity_page(_collect_page_data(result, tables))}

    content = {
        "trial": result.trial,
        "product": __version__,
        "seed": result.options.seed,
        "tolerance": {"share_of_size": result.options.tolerance, "or_stated_sd": 1.0},
        "note": result.note or None,
        "verdict": {"level": own.level, "codes": sorted(own.codes)},
        "condition_number": to_finite(own.condition),
        "parameters": [_describe_parameter(one) for one in own.parameters.values()],
        "tolerates": tables["tolerates"].records,
        "perturbations": tables["perturbations"].records,
        "tables": {name: table.columns for name, table in tables.items()},
    }
    return Result("sensitivity", DOCUMENT, content, tables, make_page, hashed=True)


def _describe_parameter(one: Parameter) -> dict[str, Any]:
    numbers = {name: to_finite(getattr(one, name)) for name in ("value", "sd", "size")}
    return asdict(one) | numbers | {"verdict": one.verdict or None}


def _collect_page_data(result: SensitivityResult, tables: Mapping[str, ResultTable]) -> SensitivityData:
    return SensitivityData(
        trial=result.trial,
        verdict=result.own.level,
        note=result.note,
        tolerance=result.options.tolerance,
        seed=result.options.seed,
        parameters=tuple(
            ParameterEntry(name, one.unit, one.value, one.sd, one.size)
            for name, one in result.own.parameters.items()
            if name in result.judged_parameters
        ),
        titles={run.perturbation.kind: run.perturbation.definition.title for run in result.runs},
        tables={name: table.frame for name, table in tables.items()},
    )
