"""Sources of the errors of ``identify-dim``: one input has its true value, or one setting is changed.

Simulated trials go through all stages. Then ``identify-dim`` runs again for each variant. It takes about six seconds
per trial and core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import harness
import numpy as np
from dynamic_sweep import ROWS, compare
from dynamic_truth import NORMS, SERIES, UNITS, TrialWithTruth, find_last_frame_turn, read_true_centres, read_with_truth

from mocap_id.arrays import FloatArray
from mocap_id.simulation import Options
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.store import Table, Tree

DIFFICULTIES = ("ordinary", "hard")


@dataclass(frozen=True)
class Trial:
    """The inputs of ``identify-dim`` in one trial, and the truth."""

    context: Context
    done: TrialWithTruth

    def with_inputs(self, **changes: Table | Tree) -> Trial:
        """Replace inputs; in their names an underscore replaces the dot."""
        inputs = {name.replace("_", "."): artefact for name, artefact in changes.items()}
        return replace(self, context=replace(self.context, inputs={**self.context.inputs, **inputs}))


Variant = Callable[[Trial], Trial]


def _insert_states(*orders: int) -> Variant:
    """Return a variant with true angles (order 0), velocities (1) or accelerations (2)."""

    def changed(trial: Trial) -> Trial:
        table, done = trial.context.table("states.parquet"), trial.done
        columns = {}
        for order in orders:
            true = done.true[("q", "qd", "qdd")[order]].copy()
            true[:, -1] += find_last_frame_turn(done.truth, done.chain) if order == 0 else 0.0
            for j, column in enumerate(true.T, start=1):
                columns[f"{('theta', 'dtheta', 'ddtheta')[order]}_{j}"] = column
        return trial.with_inputs(states_parquet=table.with_columns(**columns))

    return changed


def _insert_centres(trial: Trial) -> Trial:
    tree = trial.context.tree("chain.h5")
    joints: Any = tree.data["joints"]
    data = {**tree.data, "joints": {**joints, "centre": read_true_centres(trial.done)}}
    return trial.with_inputs(chain_h5=replace(tree, data=data))


def _insert_wrench(trial: Trial) -> Trial:
    """Insert the true wrench at the times of the frames, on the clock of the markers."""
    table, done = trial.context.table("wrench.parquet"), trial.done
    columns = dict(zip(("Fx", "Fy", "tauz"), done.true["wrench"].T, strict=True))
    trial = replace(trial, done=replace(done, truth={**done.truth, "analog_offset_s": 0.0}))
    facts = {**table.facts, "analog_rate_hz": None}  # the true values are instantaneous, not means over a frame
    return trial.with_inputs(wrench_parquet=replace(table.with_columns(**columns), facts=facts))


def _insert_contact(trial: Trial) -> Trial:
    """Remove the samples on the chair, and choose a protocol without chair.

    The search for the clock offset drops samples at the ends of each interval, so its range is short.
    """
    table = trial.context.table("wrench.parquet")
    changed = table.with_columns(plate_ok=table["plate_ok"] & trial.done.off_seat)
    keys = trial.context.trial.model_copy(update={"protocol": "free"})
    trial = _change_settings(clock_offset_limit_s=0.01)(trial.with_inputs(wrench_parquet=changed))
    return replace(trial, context=replace(trial.context, trial=keys))


def _change_settings(**changes: object) -> Variant:
    def changed(trial: Trial) -> Trial:
        settings = trial.context.settings.model_copy(update=changes)
        return replace(trial, context=replace(trial.context, settings=settings))

    return changed


def _combine(*variants: Variant) -> Variant:
    def changed(trial: Trial) -> Trial:
        for variant in variants:
            trial = variant(trial)
        return trial

    return changed


REPLACED: Mapping[str, Variant] = {
    "unchanged": lambda trial: trial,
    "true accelerations": _insert_states(2),
    "true velocities": _insert_states(1),
    "true angles": _insert_states(0),
    "true states": _insert_states(0, 1, 2),
    "true joint centres": _insert_centres,
    "true wrench": _insert_wrench,
    "true contact": _insert_contact,
    "true states and centres": _combine(_insert_states(0, 1, 2), _insert_centres),
    "true states, centres and wrench": _combine(_insert_states(0, 1, 2), _insert_centres, _insert_wrench),
    "everything true": _combine(_insert_states(0, 1, 2), _insert_centres, _insert_wrench, _insert_contact),
}
CHANGED: Mapping[str, Variant] = {
    **{f"cutoff_hz: {cutoff}": _change_settings(cutoff_hz=float(cutoff)) for cutoff in (3, 6, 10)},
    "components: Fy, tauz": _change_settings(components=("Fy", "tauz")),
    "apply_clock_offset: false": _change_settings(apply_clock_offset=False),
    "plate_bias: false": _change_settings(plate_bias=False),
    "contact: weight": _change_settings(contact="weight"),
    "contact: knee": _change_settings(contact="knee"),
    "grid: 9, 17": _change_settings(grid=(9, 17)),
    "consistency: cone": _change_settings(consistency="cone"),
    "reference_pulls: true": _change_settings(reference_pulls=True),
}
COLUMNS = (*SERIES, *NORMS[2:], "offset")


def measure(options: Options) -> FloatArray | None:
    """Return (V, 14) errors of every variant; return None without four segments or without parameters."""
    with harness.simulated(options, harness.DYNAMIC) as run:
        if run is None or (done := read_with_truth(run)) is None:
            return None
        inputs = dict(zip(STAGE.inputs, run.read(*STAGE.inputs), strict=True))
    whole = Trial(Context(run.trial.keys, run.trial.settings[STAGE.name], inputs), done)
    return np.array([compute_errors(whole, variant) for variant in (*REPLACED.values(), *CHANGED.values())])


def compute_errors(trial: Trial, variant: Variant) -> FloatArray:
    """Return (14,) errors of :data:`COLUMNS`; NaN if nothing is identified."""
    changed = variant(trial)
    _, predicted, dynamics, _ = STAGE.function(changed.context)
    assert isinstance(predicted, Table)
    assert isinstance(dynamics, Tree)
    if dynamics.facts["why"] is not None and not dynamics.facts["untold"]:
        return np.full(len(COLUMNS), np.nan)
    done = replace(changed.done, chain=changed.context.tree("chain.h5"), predicted=predicted, dynamics=dynamics)
    result = compare(done)
    return np.abs([*result.rms, *result.norms[2:], result.offset])


def make_table(found: FloatArray) -> str:
    """Return quantiles of (T, V, 14) errors."""
    units = dict(zip(SERIES, UNITS, strict=True)) | {"offset": "ms"}
    head = ["", *(f"{name}, {units.get(name, '%')}" for name in COLUMNS)]
    names = (*REPLACED, *(f"`{name}`" for name in CHANGED))
    return harness.markdown(head, [[name, *harness.pairs(found[:, k], ".2g")] for k, name in enumerate(names)])


def main() -> None:
    """Measure ordinary and hard trials and publish the sections."""
    arguments = harness.command_line(__doc__, parallel=True, trials=30, first=950_000).parse_args()
    trials, first = arguments.trials, arguments.first
    text = f"{trials} simulated sit-to-stands per table, seeds from {first}, with two repetitions each"
    sections = {"dynamic-sources": harness.measured_by(__file__, text)}
    for k, row in enumerate(DIFFICULTIES):
        tasks = [replace(ROWS[row], seed=first + k * trials + j) for j in range(trials)]
        found = harness.measure_all(measure, tasks, arguments.jobs)
        harness.progress(f"{row}: {len(found)} of {trials} trials")
        sections[f"dynamic-sources-{row}"] = make_table(np.array(found))
    harness.publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
