"""Runs of perturbed trials in parallel processes, and the response: changes of parameters, results and time series.

Perturbed trials are computed in memory; only the perturbed logs of inertial sensors are files, in a temporary folder.
The results do not depend on the number of processes.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import MocapIdError, NumericalError, Refused
from mocap_id.geometry.planar import rotate
from mocap_id.reporting.sensitivity import Parameter
from mocap_id.stages.base import Context
from mocap_id.store import Artefact, Table, Tree
from mocap_id.store.views import joint_columns
from mocap_id.verdict import Level, overall
from mocap_id.workflows.parallel import LocalBackend
from mocap_id.workflows.sensitivity.perturbations import (
    COMPONENTS,
    FIRST,
    Perturbation,
    RerunInputs,
    TrialSource,
    perturb_logs,
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
        outputs = stage.function(Context(trial.source.keys, trial.settings[stage.name], inputs))
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
    source: TrialSource, perturbations: Sequence[Perturbation], jobs: int, tell: Callable[[PerturbationRun], None]
) -> tuple[PerturbationRun, ...]:
    """Run all perturbations of a trial in parallel processes, and return the results in their order.

    ``tell`` is called with the result of each finished run. NumericalError is raised if a process was killed.
    """
    runs = {}
    # The long runs come first, so that no process waits for another at the end.
    entries = [stage.name for stage in repeated_stages()]
    order = sorted(perturbations, key=lambda one: entries.index(one.definition.entry))
    try:
        with LocalBackend(jobs).workers(len(order)) as workers:
            for future in as_completed([workers.executor.submit(_run_in_worker, source, one) for one in order]):
                run = future.result()
                tell(run)
                runs[run.perturbation] = run
    except BrokenProcessPool as error:
        message = "a process was killed, perhaps because memory ran out: run again with fewer --jobs"
        raise NumericalError(message) from error
    return tuple(runs[one] for one in perturbations)


_trials: dict[Path, RerunInputs] = {}
"""The trials that this worker process has read, by run folder."""


def _run_in_worker(source: TrialSource, perturbation: Perturbation) -> PerturbationRun:
    if source.folder not in _trials:
        _trials[source.folder] = read_rerun_inputs(source)
    return run_perturbation(_trials[source.folder], perturbation)
