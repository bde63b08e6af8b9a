"""Tables 6.1 to 6.3 on a simulated cohort, beside the thesis's.

``mocap-id simulate cohort`` makes the recordings. Every trial goes through the stages up to ``identify-dim``, and every
model of a person is applied to every trial of that person, as ``mocap-id transfer`` does. About three seconds per trial
and core, and as much for the variants.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
from cohort_tables import (
    events,
    lengths,
    other_events,
    people,
    requirements,
    strategies,
    table_6_3,
    true_torques,
    variants,
)
from cohort_truth import configure, models, read_done, repetitions, run, skeletons
from harness import command_line, measured_by, progress, publish, run_all

from mocap_id.simulation import Cohort, Options, simulate_cohort

ORDINARY = Options(clock_offset=0.005)
HARD = replace(ORDINARY, soft_tissue=2, occlusions=2, plate_bias=1)
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "unchanged": {},
    "`components: [Fy, tauz]`": {"components": ["Fy", "tauz"]},
    "`apply_clock_offset: false`": {"apply_clock_offset": False},
    "`contact: weight` (72 %)": {"contact": "weight"},
    "`contact: knee` (−0.8 rad)": {"contact": "knee"},
    "`contact: weight`, `seat_off_share: 0.5`": {"contact": "weight", "seat_off_share": 0.5},
    "`contact: weight`, `seat_off_share: 0.3`": {"contact": "weight", "seat_off_share": 0.3},
}


@dataclass(frozen=True)
class Outcome:
    """Rows of :mod:`cohort_truth`, and the trials without a model."""

    models: pd.DataFrame
    skeletons: pd.DataFrame
    repetitions: pd.DataFrame
    lost: tuple[str, ...]


def measure(study: Path, place: Path, settings: Mapping[str, Any], jobs: int) -> Outcome:
    """Run a cohort with settings of ``identify-dim`` and compare it with the truth."""
    files = configure(study, place, settings)
    refused = run_all(run, [file for _, file in files], jobs)
    trials = [None if code else read_done(study, *each) for each, code in zip(files, refused, strict=True)]
    good = [each for each in trials if each is not None]
    lost = tuple(trial.name for (trial, _), each in zip(files, trials, strict=True) if each is None)
    return Outcome(models(good), skeletons(good), repetitions(good), lost)


def vary(study: Path, place: Path, jobs: int) -> dict[str, pd.DataFrame]:
    """Run the cohort with each variant of ``identify-dim``; the earlier stages' artefacts are used again."""
    found = {}
    for k, (name, settings) in enumerate(VARIANTS.items()):
        other = place.with_name(f"variant-{k}")
        shutil.copytree(place, other)
        found[name] = measure(study, other, settings, jobs).models
        shutil.rmtree(other)
    return found


def main() -> None:
    """Measure the ordinary and the hard cohort."""
    arguments = command_line(__doc__, parallel=True, subjects=12, repetitions=5, first=970_000).parse_args()
    found, varied = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for k, (name, options) in enumerate((("ordinary", ORDINARY), ("hard", HARD))):
            own = replace(options, seed=arguments.first + k, repetitions=arguments.repetitions)
            study = simulate_cohort(Path(folder) / name, Cohort(arguments.subjects, options=own))
            found[name] = measure(study, study.parent / "trials", {}, arguments.jobs)
            progress(f"{name}: {len(found[name].lost)} trials without a model {found[name].lost}")
            if name == "ordinary":
                varied = vary(study, study.parent / "trials", arguments.jobs)
    first = found["ordinary"]
    source = (
        f"{arguments.subjects} persons with three strategies, one trial of {arguments.repetitions} sit-to-stands each: "
        f"an ordinary cohort (seed {arguments.first}) and a hard one (seed {arguments.first + 1})"
    )
    sections = {
        "cohort": measured_by(__file__, source),
        "cohort-requirements": requirements(found),
        "cohort-people": people(first.models),
        "cohort-models": table_6_3(first.models),
        "cohort-truth": true_torques(first.models),
        "cohort-lengths": lengths(first.skeletons),
        "cohort-strategies": strategies(first.skeletons),
        "cohort-events": events(first.repetitions),
        "cohort-other-events": f"Median difference, found minus scheduled: {other_events(first.repetitions)}.",
        "cohort-variants": variants(varied),
    }
    publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
