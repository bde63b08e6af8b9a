"""Runs of the stages that depend on a perturbation, in memory; only logs of inertial sensors are temporary files."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_id.geometry.planar import rotate
from mocap_id.stages.base import Context
from mocap_id.store import Artefact, Table, Tree
from mocap_id.workflows.sensitivity import marker_perturbations, signal_perturbations
from mocap_id.workflows.sensitivity.inertial_perturbations import with_perturbed_logs
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.trial_inputs import FIRST, TrialInputs, repeated_stages

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
"""The function of each kind that changes the inputs; those of inertial sensors change their logs."""


def perturb(trial: TrialInputs, perturbation: Perturbation) -> TrialInputs:
    """Perturb a trial's artefacts and compute everything that depends on the change again.

    Raises
    ------
    Refused, RecordingError, NumericalError, ConfigError
        A stage cannot treat the perturbed trial.
    """
    entry = perturbation.definition.entry
    if perturbation.definition.needs_imus:
        with tempfile.TemporaryDirectory(prefix="mocap-id-") as folder:
            return run_from(entry, with_perturbed_logs(trial, perturbation, Path(folder)))
    return run_from(entry, CHANGES[perturbation.kind](trial, perturbation))


def run_from(entry: str, trial: TrialInputs) -> TrialInputs:
    """Run a stage and those after it, up to the dynamics."""
    stages = repeated_stages()
    first = next(k for k, stage in enumerate(stages) if stage.name == entry)
    own = trial
    for stage in stages[first:]:
        inputs = {file: trial.artefacts[file] for file in stage.inputs}
        made = stage.function(Context(trial.source.keys, trial.settings[stage.name], inputs))
        trial = trial.with_artefacts(*(one for one in made if isinstance(one, Table | Tree)))
        if stage.name == FIRST:
            trial = trial.with_artefacts(_aligned(trial.tree("chain.h5"), own.tree("chain.h5")))
    return trial


def _aligned(chain: Tree, own: Tree) -> Artefact:
    """Return the chain whose last frame is aligned with the unperturbed one by the common markers.

    The frame points at the centroid of the markers. With other markers it has another direction, which changes angle
    and first moments although the body is the same.
    """
    now, before = (_last_segment(tree) for tree in (chain, own))
    both = [label for label in now if label in before]
    if not both:
        return chain
    here, there = (np.array([markers[label] for label in both]) for markers in (now, before))
    cross = float(np.sum(here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0]))
    angle = math.atan2(cross, float(np.sum(here * there)))
    data = {group: dict(nodes) if isinstance(nodes, Mapping) else nodes for group, nodes in chain.data.items()}
    table = data["markers"]
    assert isinstance(table, dict)
    segment, local = np.asarray(table["segment"]), np.asarray(table["local"], dtype=np.float64)
    table["local"] = np.where((segment == segment.max())[:, None], rotate(np.array(angle), local), local)
    return replace(chain, data=data)


def _last_segment(chain: Tree) -> dict[str, tuple[float, float]]:
    """Return the local coordinates of the last segment's markers by label, m."""
    names, segment, local = (chain.array(f"markers/{name}") for name in ("name", "segment", "local"))
    return {str(names[k]): (local[k, 0], local[k, 1]) for k in np.flatnonzero(segment == segment.max())}
