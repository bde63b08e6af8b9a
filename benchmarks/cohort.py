"""Table 6.3 on a simulated cohort, beside the thesis's: ``python benchmarks/cohort.py [--write PAGE]``.

`mocap-id simulate cohort` makes the recordings; every trial goes through the stages up to ``identify-dim``, and every
model of a person is applied to every trial of that person as ``mocap-id transfer`` does. Prints docs/cohort.md, and
with ``--write docs/cohort.md`` replaces that page. About three seconds a trial and core, and as much for the variants.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
from cohort_page import TEXT, events, figures, lengths, others, people, strategies, table_6_3, true_torques, variants
from cohort_truth import configure, done, models, repetitions, run, skeletons

from mocap_id.simulation import Cohort, Options, simulate_cohort

FRESH = 970_000  # the first seed; nothing was tuned on these
ORDINARY = Options(clock_offset=0.005)
HARD = replace(ORDINARY, soft_tissue=2, occlusions=2, plate_bias=1)
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "as it is": {},
    "`components: [Fy, tauz]`": {"components": ["Fy", "tauz"]},
    "`apply_clock_offset: false`": {"apply_clock_offset": False},
    "`contact: weight` (72 %)": {"contact": "weight"},
    "`contact: knee` (−0.8 rad)": {"contact": "knee"},
    "`contact: weight`, `seat_off_share: 0.5`": {"contact": "weight", "seat_off_share": 0.5},
    "`contact: weight`, `seat_off_share: 0.3`": {"contact": "weight", "seat_off_share": 0.3},
}


@dataclass(frozen=True)
class Outcome:
    """What came of a cohort: rows of :mod:`cohort_truth`, and the trials that gave no model."""

    models: pd.DataFrame
    skeletons: pd.DataFrame
    repetitions: pd.DataFrame
    lost: tuple[str, ...]


def measure(study: Path, place: Path, settings: Mapping[str, Any], pool: ProcessPoolExecutor) -> Outcome:
    """Run a cohort with settings of ``identify-dim`` and compare."""
    files = configure(study, place, settings)
    refused = list(pool.map(run, [file for _, file in files]))
    trials = [None if why else done(study, *each) for each, why in zip(files, refused, strict=True)]
    good = [each for each in trials if each is not None]
    lost = tuple(trial.name for (trial, _), each in zip(files, trials, strict=True) if each is None)
    return Outcome(models(good), skeletons(good), repetitions(good), lost)


def vary(study: Path, place: Path, pool: ProcessPoolExecutor) -> dict[str, pd.DataFrame]:
    """The same cohort with ``identify-dim`` done otherwise; what earlier stages made in ``place`` is used again."""
    found = {}
    for k, (name, settings) in enumerate(VARIANTS.items()):
        other = place.with_name(f"variant-{k}")
        shutil.copytree(place, other)
        found[name] = measure(study, other, settings, pool).models
        shutil.rmtree(other)
    return found


def main() -> None:
    """Measure, print and perhaps write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--subjects", type=int, default=12, help="persons of each cohort")
    parser.add_argument("--repetitions", type=int, default=5, help="sit-to-stands a trial")
    parser.add_argument("--first", type=int, default=FRESH, help="seed of the cohort; the harder one has the next")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--write", type=Path, help="page to replace")
    arguments = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # for the processes: as many threads as cores each would get in the way
    found, varied = {}, {}
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(arguments.jobs) as pool:
        for k, (name, options) in enumerate((("ordinary", ORDINARY), ("hard", HARD))):
            own = replace(options, seed=arguments.first + k, repetitions=arguments.repetitions)
            study = simulate_cohort(Path(folder) / name, Cohort(arguments.subjects, options=own))
            found[name] = measure(study, study.parent / "trials", {}, pool)
            sys.stderr.write(f"{name}: {len(found[name].lost)} trials without a model {found[name].lost}\n")
            if name == "ordinary":
                varied = vary(study, study.parent / "trials", pool)
    first = found["ordinary"]
    text = TEXT.format(
        subjects=arguments.subjects,
        first=arguments.first,
        second=arguments.first + 1,
        repetitions=arguments.repetitions,
        figures=figures(found),
        table=table_6_3(first.models),
        torques=true_torques(first.models),
        people=people(first.models),
        lengths=lengths(first.skeletons),
        strategies=strategies(first.skeletons),
        events=events(first.repetitions),
        others=others(first.repetitions),
        variants=variants(varied),
    )
    sys.stdout.write(text)
    if arguments.write:
        arguments.write.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
