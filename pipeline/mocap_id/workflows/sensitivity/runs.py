"""Runs of perturbed trials in memory and in parallel processes; the results do not depend on the number of processes.

Only the perturbed logs of inertial sensors are files, in a temporary folder.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from mocap_id.errors import MocapIdError, NumericalError, Refused
from mocap_id.geometry.planar import rotate
from mocap_id.stages.base import Context
from mocap_id.store import Artefact, Table, Tree
from mocap_id.workflows.parallel.backends import LocalBackend
from mocap_id.workflows.sensitivity import marker_perturbations, signal_perturbations
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.responses import Estimates, SeriesChanges, compare_series, read_estimates
from mocap_id.workflows.sensitivity.trial_inputs import FIRST, TrialInputs, TrialSource, read_inputs, repeated_stages

CHANGES: Mapping[str, Callable[[TrialInputs, Perturbation], TrialInputs]] = {
    "filter-noise": signal_perturbations.filter_noise,
    "angle-bias": signal_perturbations.angle_bias,
    "angle-noise": marker_perturbations.angle_noise,
    "clock-offset": signal_perturbations.clock_offset,
    "clock-offset-ignored": signal_perturbations.clock_offset_ignored,
    "wrench-bias": signal_perturbations.wrench_bias,
    "wrench-noise": signal_perturbations.wrench_noise,
    "board-steps": signal_perturbations.board_steps,
    "stamp-jitter": signal_perturbations.stamp_jitter,
    "camera-noise": marker_perturbations.camera_noise,
    "marker-count": marker_perturbations.marker_count,
    "drop-outs": marker_perturbations.drop_outs,
    "soft-tissue": marker_perturbations.soft_tissue,
    "frame-rate": marker_perturbations.frame_rate,
}
"""The function that changes the inputs, by kind; the kinds for inertial sensors change logs instead."""


@dataclass(frozen=True)
class PerturbationRun:
    """The result of one perturbation."""

    perturbation: Perturbation
    estimates: Estimates | None  # estimates of the perturbed trial; None if it was refused or failed
    changes: SeriesChanges  # changes from the unperturbed trial; empty if there are no estimates
    why: str  # reason why there are no estimates; empty if there are estimates
    refused: bool  # whether the perturbed trial was refused, rather than failed
    seconds: float  # processor time, s


RunCallback: TypeAlias = Callable[[PerturbationRun], None]


def perturb(trial: TrialInputs, perturbation: Perturbation) -> TrialInputs:
    """Perturb a trial, compute the dependent artefacts again, and return the trial with these artefacts.

    Raises
    ------
    Refused, RecordingError, NumericalError, ConfigError
        A stage refuses the perturbed trial or fails.
    """
    entry = perturbation.definition.entry
    if perturbation.definition.needs_imus:
        with tempfile.TemporaryDirectory(prefix="mocap-id-") as folder:
            return run_from(entry, signal_perturbations.perturb_logs(trial, perturbation, Path(folder)))
    return run_from(entry, CHANGES[perturbation.kind](trial, perturbation))


def run_from(entry: str, trial: TrialInputs) -> TrialInputs:
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
    now, before = (_read_last_segment(tree) for tree in (chain, own))
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


def _read_last_segment(chain: Tree) -> dict[str, tuple[float, float]]:
    """Return the local coordinates of the last segment's markers by label, m."""
    names, segment, local = (chain.array(f"markers/{name}") for name in ("name", "segment", "local"))
    return {str(names[k]): (local[k, 0], local[k, 1]) for k in np.flatnonzero(segment == segment.max())}


def run_perturbation(trial: TrialInputs, perturbation: Perturbation) -> PerturbationRun:
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
    source: TrialSource, perturbations: Sequence[Perturbation], jobs: int, tell: RunCallback
) -> tuple[PerturbationRun, ...]:
    """Run all perturbations of a trial in parallel, and return the results in the order of the perturbations.

    Parameters
    ----------
    source : TrialSource
    perturbations : sequence of Perturbation
    jobs : int
        Number of parallel processes; the libraries in each process use one thread.
    tell : callable
        Called with the result of each finished run.

    Raises
    ------
    NumericalError
        A process was killed.
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


_trials: dict[Path, TrialInputs] = {}
"""The trials that this worker process has read, by run folder."""


def _run_in_worker(source: TrialSource, perturbation: Perturbation) -> PerturbationRun:
    if source.folder not in _trials:
        _trials[source.folder] = read_inputs(source)
    return run_perturbation(_trials[source.folder], perturbation)
