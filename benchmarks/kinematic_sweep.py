"""Errors of the recovered chain, and the confidence of its segments, on simulated sit-to-stands.

Every trial has a new body, motion, skin movement, plane and drop-outs. It is written as a C3D file and run through the
stages up to ``ukf-smooth``. About two seconds per trial and core.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import harness
import numpy as np

from mocap_id.config import load
from mocap_id.geometry import planar
from mocap_id.runner import run_stage
from mocap_id_simulation import Options, simulate

ROWS: Mapping[str, Options] = {
    "clean": harness.CLEAN,
    "ordinary": harness.SHORT,
    "hard": harness.HARD,
}
DEGRADED = "degraded"
SCORED = ("shank", "thigh")
LENGTHS: Mapping[str, tuple[float, ...]] = {"clean": (0.001, 0.001), "ordinary": (1.2, 0.8), "hard": (4, 1.5)}  # %
CENTRES: Mapping[str, tuple[float, ...]] = {"clean": (0.01,) * 3, "ordinary": (5, 3.5, 2.5), "hard": (12, 7, 5)}  # mm
BINS = ((0, 0.2), (0.2, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 1.01))


@dataclass(frozen=True)
class Result:
    """Errors of one trial; None where the number of segments is wrong."""

    refused: str | None = None
    count: int = 0
    wrong: int = 0  # markers
    confidence: float = 0.0
    unsure: bool = False
    error: tuple[float, ...] | None = None  # (2,) of the lengths of shank and thigh, %
    relative_error: tuple[float, ...] | None = None  # (2,) the same in stated standard deviations
    centre: tuple[float, ...] | None = None  # (3,) rms distance of ankle, knee and hip from the truth, mm

    @property
    def right(self) -> bool:
        """Whether the number of segments and the assignment of markers are right."""
        return self.refused is None and self.count == harness.SEGMENTS and self.wrong == 0


def measure(task: tuple[str, int]) -> Result:
    row, seed = task
    options, removed = draw_degraded(seed) if row == DEGRADED else (replace(ROWS[row], seed=seed), ())
    with harness.temporary_folder() as place:
        configuration = simulate("sit-to-stand", place / "trial", options)
        truth = harness.read_truth(configuration)
        if removed:
            names = [name for name, gone in zip(truth["assignment"], removed, strict=False) if gone]
            with configuration.open("a") as file:
                file.write(f"planarise: {{ignore: {json.dumps(names)}}}\n")
        trial = load(configuration)
        for name in harness.KINEMATIC:
            outcome = run_stage(trial, name)
            if outcome.refused is not None:
                return Result(refused=outcome.refused.code)
        return compare(harness.Run(configuration, trial))


def draw_degraded(seed: int) -> tuple[Options, tuple[bool, ...]]:
    """Return options of random difficulty, and which markers are removed."""
    rng = np.random.default_rng(seed)
    options = Options(
        seed=seed,
        soft_tissue=float(np.exp(rng.uniform(np.log(0.5), np.log(8)))),
        marker_noise=float(np.exp(rng.uniform(np.log(2e-4), np.log(3e-3)))),
        repetitions=int(rng.integers(1, 3)),
        strategy=("normal", "dynamic", "stable")[rng.integers(3)],
        analog_rate=100,
    )
    return options, tuple(bool(gone) for gone in rng.uniform(size=100) > rng.uniform(0.4, 1))


def compare(done: harness.Run) -> Result:
    segments, chain, states = done.read("segments.parquet", "chain.h5", "states.parquet")
    truth = done.truth
    named = segments.frame.dropna(subset="segment")
    wrong = sum(truth["assignment"][str(m)] != k for m, k in zip(named["marker"], named["segment"], strict=True))
    result = Result(
        count=segments.facts["count"],
        wrong=int(wrong),
        confidence=segments.facts["confidence"],
        unsure=any(reason.code == "segments-unsure" for reason in segments.reasons),
    )
    if result.count != harness.SEGMENTS:
        return result
    true = np.array([truth["segment_lengths_m"][name] for name in SCORED])
    joints, lengths = harness.read_group(chain, "joints"), harness.read_group(chain, "segments")
    length, sd = lengths["length"], lengths["length_sd"]
    _, origins = planar.segment_poses(harness.stack_states(states)[..., 0], joints["centre"])
    distance = origins[:, 1:] - done.true(states["time"], "joint_xy")[0]
    return replace(
        result,
        error=tuple(100 * (length / true - 1)),
        relative_error=tuple((length - true) / np.maximum(sd, 1e-12)),
        centre=tuple(1e3 * np.sqrt(np.nanmean(np.sum(distance**2, axis=2), axis=0))),
    )


def list_requirements(row: str, results: Sequence[Result]) -> Iterator[tuple[str, str, int, float]]:
    """Yield each quantity of a row: name, limit, number of trials within the limit, required share."""
    clean, hard = row == "clean", row == "hard"
    share = {"clean": 1.0, "ordinary": 0.97, "hard": 0.9}[row]
    yield "count", "4", sum(r.refused is None and r.count == harness.SEGMENTS for r in results), share
    if hard:
        flagged = sum(r.count == harness.SEGMENTS or r.unsure or bool(r.refused) for r in results)
        yield "count, or flagged unsure", "4", flagged, 1
        yield "wrong markers", "≤ 2", sum(r.count == harness.SEGMENTS and r.wrong <= 2 for r in results), 1.0
    yield "wrong markers", "0", sum(r.right for r in results), 0.8 if hard else share
    for k, (name, limit) in enumerate(zip(SCORED, LENGTHS[row], strict=True)):
        within = sum(r.error is not None and abs(r.error[k]) <= limit for r in results)
        yield f"{name} length", f"{limit:g} %", within, 1.0 if clean else 0.9
    for k, (name, limit) in enumerate(zip(harness.JOINTS, CENTRES[row], strict=True)):
        within = sum(r.centre is not None and r.centre[k] <= limit for r in results)
        yield f"{name} centre", f"{limit:g} mm", within, {"clean": 1.0, "ordinary": 0.9, "hard": 0.8}[row]
    if not clean:
        for k, name in enumerate(SCORED):
            inside = sum(r.relative_error is not None and abs(r.relative_error[k]) <= harness.QUANTILE for r in results)
            yield f"{name}'s 95 % interval", "covers", inside, 0.95


def make_confidence_table(results: Sequence[Result]) -> str:
    """Return the share of trials with the right segments for each range of the stated confidence."""
    rows = []
    for low, high in BINS:
        here = [r for r in results if r.refused is None and low <= r.confidence < high]
        if here:
            good = sum(r.right for r in here)
            interval = harness.format_interval_of_share(good, len(here), ".2f", unit=1.0)
            mean = np.mean([r.confidence for r in here])
            numbers = [f"{len(here)}", f"{mean:.2f}", f"{good / len(here):.2f}", interval]
            rows.append([f"{low:g} … {min(high, 1):g}", *numbers])
    return harness.format_table(["confidence", "trials", "mean confidence", "share right", "95 % interval"], rows)


def make_first(first: int) -> str:
    """Return the errors of one ordinary and one hard trial, as a test measures them again."""
    rows = []
    for row in ("ordinary", "hard"):
        found = measure((row, first))
        assert found.error is not None
        assert found.centre is not None
        numbers = harness.format_numbers([found.confidence, *found.error, *found.centre], ".3g")
        rows.append([row, str(found.count), str(found.wrong), *numbers])
    head = ["trial", "segments", "wrong markers", "confidence", *(f"{k}, %" for k in SCORED)]
    table = harness.format_table([*head, *(f"{k} centre, mm" for k in harness.JOINTS)], rows)
    return f"One ordinary and one hard trial, seed {first}:\n\n{table}"


def main() -> None:
    arguments = harness.make_parser(__doc__, parallel=True, trials=100, first=700_000).parse_args()
    trials, first, found = arguments.trials, arguments.first, {}
    for row in [*ROWS, DEGRADED]:
        count = 2 * trials if row == DEGRADED else trials
        found[row] = harness.run_all(measure, [(row, seed) for seed in range(first, first + count)], arguments.jobs)
        first += trials
        harness.report_progress(f"{row}: {count} trials")
    exact = [r for r in found["clean"] if r.error and r.centre]
    length, centre = max(max(map(abs, r.error)) for r in exact), max(max(r.centre) for r in exact)
    refused = sum(r.refused is not None for r in found[DEGRADED])
    degraded = f"{2 * trials} trials, seeds from {arguments.first + len(ROWS) * trials}; {refused} of them were refused"
    limits = []
    for row in ROWS:
        for name, limit, good, share in list_requirements(row, found[row]):
            required = "88–99 %" if limit == "covers" else f"{100 * share:.0f} %"
            limits.append([row, name, limit, required, *harness.format_share_with_interval(good, len(found[row]))])
    quantiles = []
    for row in ("ordinary", "hard"):
        errors = np.array([[*np.abs(r.error), *r.centre] for r in found[row] if r.error and r.centre])
        for q in (0.5, 0.8, 0.9, 1.0):
            name = "largest" if q == 1 else f"{100 * q:.0f} %"
            quantiles.append([row, name, *harness.format_numbers(np.quantile(errors, q, axis=0))])
    head = ["trials", "quantity", "limit", "required share", "share within the limit", "95 % interval"]
    columns = ["trials", "quantile", *(f"{k}, %" for k in SCORED), *(f"{k}, mm" for k in harness.JOINTS)]
    sections = {
        "kinematic-sweep": harness.describe_source(__file__, f"{trials} trials per row, seeds from {arguments.first}"),
        "kinematic-limits": harness.format_table(head, limits),
        "kinematic-clean": f"Largest error in any clean trial: {length:.1g} % of a length, {centre:.1g} mm of a joint "
        "centre.",
        "kinematic-first": make_first(arguments.first),
        "kinematic-quantiles": harness.format_table(columns, quantiles),
        "kinematic-degraded": harness.describe_source(__file__, degraded),
        "kinematic-confidence": make_confidence_table(found[DEGRADED]),
    }
    harness.publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
