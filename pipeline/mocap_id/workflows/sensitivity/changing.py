"""A perturbed trial through the stages that see the perturbation: tables in, tables out, no file touched."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from mocap_id.geometry.planar import rotate
from mocap_id.stages.base import Context
from mocap_id.store import Artefact, Table, Tree
from mocap_id.workflows.sensitivity import markers, signals
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.subject import FIRST, Perturbed, again

CHANGES: Mapping[str, Callable[[Perturbed, Perturbation], Perturbed]] = {
    "filter-noise": signals.filter_noise,
    "angle-bias": signals.angle_bias,
    "angle-noise": markers.angle_noise,
    "clock-offset": signals.clock_offset,
    "clock-offset-ignored": signals.clock_offset_ignored,
    "wrench-bias": signals.wrench_bias,
    "wrench-noise": signals.wrench_noise,
    "camera-noise": markers.camera_noise,
    "marker-count": markers.marker_count,
    "drop-outs": markers.drop_outs,
    "soft-tissue": markers.soft_tissue,
    "frame-rate": markers.frame_rate,
}
"""What each kind does to the inputs."""


def perturbed(trial: Perturbed, change: Perturbation) -> Perturbed:
    """The trial's artefacts with one change, everything that depends on it computed again.

    Raises
    ------
    Refused, RecordingError, NumericalError, ConfigError
        What a stage makes of the changed trial.
    """
    return run_from(change.of.entry, CHANGES[change.kind](trial, change))


def run_from(entry: str, trial: Perturbed) -> Perturbed:
    """Run a stage and all after it, as far as dynamics go."""
    stages = again()
    first = next(k for k, stage in enumerate(stages) if stage.name == entry)
    own = trial
    for stage in stages[first:]:
        inputs = {file: trial.artefacts[file] for file in stage.inputs}
        made = stage.function(Context(trial.source.keys, trial.settings[stage.name], inputs))
        trial = trial.having(*(one for one in made if isinstance(one, Table | Tree)))
        if stage.name == FIRST:
            trial = trial.having(_as_before(trial.tree("chain.h5"), own.tree("chain.h5")))
    return trial


def _as_before(chain: Tree, own: Tree) -> Artefact:
    """The chain with the last segment's frame turned as it lies in the unperturbed one, by the markers in both.

    That frame points at the centroid of the markers that there are: with others it lies otherwise, and angle and
    first moments with it, though nothing has changed.
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
    """Local coordinates of the last segment's markers by label, m."""
    table = chain.data["markers"]
    assert isinstance(table, Mapping)
    names, segment, local = (np.asarray(table[name]) for name in ("name", "segment", "local"))
    return {str(names[k]): (local[k, 0], local[k, 1]) for k in np.flatnonzero(segment == segment.max())}
