"""Sources of the errors of ``identify-dim``: one input has its true value, or one setting is changed.

Simulated trials go through all stages. Then ``identify-dim`` runs again for each variant. It takes about six seconds
per trial and core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import harness
import numpy as np
from dynamic_sweep import (
    NORMS,
    ROWS,
    SERIES,
    UNITS,
    TrialWithTruth,
    compare,
    find_last_frame_turn,
    read_true_centres,
    read_with_truth,
)

from mocap_id.arrays import FloatArray
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.store import Table, Tree
from mocap_id_simulation import Options

DIFFICULTIES = ("ordinary", "hard")


@dataclass(frozen=True)
class Trial:
    context: Context
    done: TrialWithTruth

    def with_inputs(self, **changes: Table | Tree) -> Trial:
        """Replace inputs; in their names an underscore replaces the dot."""
        inputs = {name.replace("_", "."): artefact for name, artefact in changes.items()}
        return replace(self, context=replace(self.context, inputs={**self.context.inputs, **inputs}))

    def with_settings(self, **changes: object) -> Trial:
        settings = self.context.settings.model_copy(update=changes)
        return replace(self, context=replace(self.context, settings=settings))


def _insert_states(trial: Trial, order: int) -> Trial:
    """Insert the true angles (order 0), velocities (1) or accelerations (2)."""
    table, done = trial.context.table("states.parquet"), trial.done
    true = done.true[("q", "qd", "qdd")[order]].copy()
    true[:, -1] += find_last_frame_turn(done.truth, done.chain) if order == 0 else 0.0
    name = ("theta", "dtheta", "ddtheta")[order]
    columns = {f"{name}_{j}": column for j, column in enumerate(true.T, start=1)}
    return trial.with_inputs(states_parquet=table.with_columns(**columns))


def _insert_centres(trial: Trial) -> Trial:
    tree = trial.context.tree("chain.h5")
    joints: Any = tree.data["joints"]
    data = {**tree.data, "joints": {**joints, "centre": read_true_centres(trial.done.truth)}}
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
    trial = trial.with_inputs(wrench_parquet=changed).with_settings(clock_offset_limit_s=0.01)
    return replace(trial, context=replace(trial.context, trial=keys))


_ANGLES, _VELOCITIES, _ACCELERATIONS = (partial(_insert_states, order=order) for order in range(3))
_STATES = (_ANGLES, _VELOCITIES, _ACCELERATIONS)
REPLACED: Mapping[str, Sequence[Callable[[Trial], Trial]]] = {
    "unchanged": (),
    "true accelerations": (_ACCELERATIONS,),
    "true velocities": (_VELOCITIES,),
    "true angles": (_ANGLES,),
    "true states": _STATES,
    "true joint centres": (_insert_centres,),
    "true wrench": (_insert_wrench,),
    "true contact": (_insert_contact,),
    "true states and centres": (*_STATES, _insert_centres),
    "true states, centres and wrench": (*_STATES, _insert_centres, _insert_wrench),
    "everything true": (*_STATES, _insert_centres, _insert_wrench, _insert_contact),
}
CHANGED: Mapping[str, Mapping[str, object]] = {
    **{f"cutoff_hz: {cutoff}": {"cutoff_hz": float(cutoff)} for cutoff in (3, 6, 10)},
    "components: Fy, tauz": {"components": ("Fy", "tauz")},
    "apply_clock_offset: false": {"apply_clock_offset": False},
    "plate_bias: false": {"plate_bias": False},
    "contact: weight": {"contact": "weight"},
    "contact: knee": {"contact": "knee"},
    "grid: 9, 17": {"grid": (9, 17)},
    "consistency: cone": {"consistency": "cone"},
    "reference_pulls: true": {"reference_pulls": True},
}
COLUMNS = (*SERIES, *NORMS[2:], "offset")


def measure(options: Options) -> FloatArray | None:
    """Return (V, 14) errors of every variant; return None without four segments or without parameters.

    The columns are :data:`COLUMNS`; they are NaN if nothing is identified.
    """
    with harness.open_simulated(options, harness.DYNAMIC) as run:
        if run is None or (done := read_with_truth(run)) is None:
            return None
        inputs = dict(zip(STAGE.inputs, run.read(*STAGE.inputs), strict=True))
    whole = Trial(Context(run.trial.keys, run.trial.settings[STAGE.name], inputs), done)
    variants = [reduce(lambda trial, insert: insert(trial), inserts, whole) for inserts in REPLACED.values()]
    variants += [whole.with_settings(**settings) for settings in CHANGED.values()]
    errors = np.full((len(variants), len(COLUMNS)), np.nan)
    for row, changed in zip(errors, variants, strict=True):
        _, predicted, dynamics, _ = STAGE.function(changed.context)
        assert isinstance(predicted, Table)
        assert isinstance(dynamics, Tree)
        if dynamics.facts["why"] is None or dynamics.facts["untold"]:
            chain = changed.context.tree("chain.h5")
            result = compare(replace(changed.done, chain=chain, predicted=predicted, dynamics=dynamics))
            row[:] = np.abs([*result.rms, *result.norms[2:], result.offset])
    return errors


def main() -> None:
    arguments = harness.make_parser(__doc__, parallel=True, trials=30, first=950_000).parse_args()
    trials, first = arguments.trials, arguments.first
    text = f"{trials} simulated sit-to-stands per table, seeds from {first}, with two repetitions each"
    sections = {"dynamic-sources": harness.describe_source(__file__, text)}
    units = dict(zip(SERIES, UNITS, strict=True)) | {"offset": "ms"}
    head = ["", *(f"{name}, {units.get(name, '%')}" for name in COLUMNS)]
    names = (*REPLACED, *(f"`{name}`" for name in CHANGED))
    for k, row in enumerate(DIFFICULTIES):
        tasks = [replace(ROWS[row], seed=first + k * trials + j) for j in range(trials)]
        found = harness.measure_all(measure, tasks, arguments.jobs)
        harness.report_progress(f"{row}: {len(found)} of {trials} trials")
        quantiles = np.moveaxis(np.array(found), 1, 0)  # (variants, trials, columns)
        rows = [[name, *harness.format_pairs(each, ".2g")] for name, each in zip(names, quantiles, strict=True)]
        sections[f"dynamic-sources-{row}"] = harness.format_table(head, rows)
    harness.publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
