"""Joint states across gaps, on simulated sit-to-stands.

The trials run through the stages up to ``ukf-smooth``. Then markers are removed from the planar table, and
``ukf-smooth`` runs again for every length, set of markers and position of the gap. About a minute per trial.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import harness
import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.stages.base import Context
from mocap_id.stages.ukf_smooth import STAGE
from mocap_id.store import Artefact
from mocap_id_simulation.options import Options

LENGTHS = (0.1, 0.3, 0.5, 0.8, 1.5, 3.0)
WHICH = ("one marker", "shank", "thigh", "trunk", "all")
WHERE = ("start", "standing", "rising", "end")
NAMES = ("angle", "velocity", "acceleration")
LIMIT = 5.0  # stated standard deviations


@dataclass(frozen=True)
class Trial:
    context: Context
    truth: FloatArray  # (F, n, 3)
    time: FloatArray  # (F,) s
    markers: Mapping[str, BoolArray]  # (M,) markers of the planar table that are removed, for each set
    places: Mapping[str, float]  # middle of the gap, s; for start and end its edge


@dataclass(frozen=True)
class Case:
    error: FloatArray  # (F, n, 3) in stated standard deviations; NaN without a value
    gap: BoolArray  # (F,)
    observed: BoolArray  # (F, n)
    cautioned: bool

    @property
    def bridged(self) -> BoolArray:
        """(F, n) samples in the gap that their own frame does not determine."""
        return np.asarray(self.gap[:, None] & ~self.observed)

    def worst(self, inside: bool = True) -> FloatArray:
        """Return the largest error (3,) inside or outside the gap; 0 without values."""
        errors = np.abs(self.error[self.gap == inside])
        return np.asarray(np.nan_to_num(errors).max(axis=(0, 1), initial=0.0))


def prepare(place: Path, options: Options) -> Trial | None:
    """Simulate and run a trial; return None if the number of segments is wrong."""
    done = harness.run_simulated(place / "trial", options)
    if done is None:
        return None
    names = ("states.parquet", "planar.parquet", "segments.parquet", "chain.h5")
    states, planar, segments, chain = done.read(*names)
    if not harness.has_true_segments(states):
        return None
    time = states["time"]
    truth = np.stack(done.true(time, "q", "qd", "qdd"), axis=2)
    inputs: Mapping[str, Artefact] = {"planar.parquet": planar, "segments.parquet": segments, "chain.h5": chain}
    context = Context(done.trial.keys, STAGE.settings(), inputs)
    group = harness.read_group(chain, "markers")
    segment = dict(zip(map(str, group["name"]), map(int, group["segment"]), strict=True))
    own = np.array([segment.get(label, -1) for label in planar.labels])
    sets: dict[str, BoolArray] = {"one marker": np.arange(len(own)) == np.flatnonzero(own == 2)[0]}
    sets |= {name: own == k + 1 for k, name in enumerate(WHICH[1:4])} | {"all": own > 0}
    speed, knee = np.abs(truth[:, :, 1]).sum(axis=1), truth[:, 1, 0]
    straightening = np.sign(knee[np.argmin(np.abs(knee))] - knee[np.argmax(np.abs(knee))])  # sign of its velocity
    rising = np.where(truth[:, 1, 1] * straightening > 0, speed, 0.0)
    quiet = np.convolve(speed, np.ones(51) / 51, mode="same")
    stands = np.abs(knee) < np.quantile(np.abs(knee), 0.3)
    places = {
        "start": time[0],
        "standing": float(time[np.argmin(np.where(stands, quiet, np.inf))]),
        "rising": float(time[np.argmax(rising)]),
        "end": time[-1],
    }
    return Trial(context, truth, time, sets, places)


def find_gap(trial: Trial, where: str, length: float) -> BoolArray:
    time, count = trial.time, round(length / float(np.median(np.diff(trial.time))))
    middle = int(np.argmin(np.abs(time - trial.places[where])))
    first = {"start": 0, "end": len(time) - count}.get(where, middle - count // 2)
    first = min(max(first, 0), len(time) - count)
    gap: BoolArray = np.zeros(len(time), dtype=np.bool_)
    gap[first : first + count] = True
    return gap


def run_case(trial: Trial, which: str, where: str, length: float) -> Case:
    gap, gone = find_gap(trial, where, length), trial.markers[which]
    planar = harness.hide_samples(trial.context.long("planar.parquet"), gap[:, None] & gone[None])
    inputs = {**trial.context.inputs, "planar.parquet": planar}
    states: Any = STAGE.function(replace(trial.context, inputs=inputs))[0]
    observed = states.stack([f"observed_{j}" for j in (1, 2, 3)]).astype(np.bool_)
    error = harness.stack_states(states) - trial.truth
    error[..., 0] -= np.nanmedian(error[~gap, :, 0], axis=0)
    cautioned = any(reason.code == "gap" for reason in states.reasons)
    return Case(error / harness.stack_states(states, "sd_"), gap, observed, cautioned)


def list_cases(lengths: Sequence[float] = LENGTHS) -> Iterator[tuple[str, str, float]]:
    yield from product(WHICH, WHERE, lengths)


def measure_coverage(found: Sequence[Case], part: str) -> tuple[FloatArray, int]:
    """Return the share (3,) of samples inside the 95 % interval, and their number."""
    inside, total = np.zeros(3), 0
    for case in found:
        parts = {"all": np.ones_like(case.observed), "gap": case.gap[:, None] & case.observed, "bridged": case.bridged}
        errors = case.error[parts[part] & np.isfinite(case.error[..., 0])]
        inside += np.sum(np.abs(errors) <= harness.QUANTILE, axis=0)
        total += len(errors)
    return inside / max(total, 1), total


def _format_cell(found: Sequence[Case]) -> str:
    """Return the largest errors, and the share of the bridged samples without a value."""
    worst = np.max([case.worst() for case in found], axis=0)
    bridged = sum(np.count_nonzero(case.bridged) for case in found)
    flagged = sum(np.count_nonzero(case.bridged & np.isnan(case.error[..., 0])) for case in found)
    return " / ".join(f"{value:.1f}" for value in worst) + (f", {100 * flagged / bridged:.0f} %" if bridged else "")


def make_sections(found: Mapping[tuple[str, str, float], Sequence[Case]], failed: int) -> dict[str, str]:
    every = [case for each in found.values() for case in each]
    rows = [
        [which, f"{length:g} s", *(_format_cell(found[which, where, length]) for where in WHERE)]
        for which, length in product(WHICH, LENGTHS)
    ]
    shares = []
    for part, name in (("all", "all"), ("gap", "in gaps, observed"), ("bridged", "bridged")):
        share, total = measure_coverage(every, part)
        shares.append([name, str(total), *(f"{100 * s:.1f}" for s in share)])
    outside = np.max([case.worst(inside=False) for case in every], axis=0)
    largest = ", ".join(f"{value:.1f} ({name})" for value, name in zip(outside, NAMES, strict=True))
    beyond = np.mean(np.abs(np.concatenate([e.error[np.isfinite(e.error[..., 0])] for e in every])) > LIMIT)
    missing = [np.isnan(case.error[..., 0]) for case in every]
    silent = sum(int(np.sum(none & case.observed)) for none, case in zip(missing, every, strict=True))
    unsaid = sum(bool(none.any()) and not case.cautioned for none, case in zip(missing, every, strict=True))
    return {
        "gaps-worst": harness.format_table(["markers", "length", *WHERE], rows),
        "gaps-outside": f"Outside the gaps the largest errors are {largest}. Of all samples with a value, "
        f"{100 * beyond:.3f} % exceed {LIMIT:g}.",
        "gaps-coverage": harness.format_table(["samples", "number", *NAMES], shares),
        "gaps-failures": f"Exceptions: {failed}. Samples that are NaN although their own frame determines the angle: "
        f"{silent}. Runs with NaN but without the caution `gap`: {unsaid}.",
    }


def main() -> None:
    arguments = harness.make_parser(__doc__, trials=4, first=930_000).parse_args()
    found: dict[tuple[str, str, float], list[Case]] = {key: [] for key in list_cases()}
    trials = failed = 0
    for seed in range(arguments.first, arguments.first + arguments.trials):
        with harness.temporary_folder() as place:
            trial = prepare(place, replace(harness.SHORT, seed=seed))
            trials += trial is not None
            for key, results in found.items() if trial is not None else ():
                try:
                    results.append(run_case(trial, *key))
                except Exception as error:  # noqa: BLE001 - counting them is the purpose
                    failed += 1
                    harness.report_progress(f"{seed} {key}: {error!r}")
        harness.report_progress(seed)
    runs = sum(map(len, found.values()))
    text = f"{trials} trials of two repetitions, seeds from {arguments.first}: {runs} runs of `ukf-smooth`"
    harness.publish(
        {"gaps": harness.describe_source(__file__, text), **make_sections(found, failed)}, write=arguments.write
    )


if __name__ == "__main__":
    main()
