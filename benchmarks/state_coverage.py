"""Coverage of the stated intervals of the joint states, and steps at drop-outs, on simulated sit-to-stands.

The trials run through the stages up to ``ukf-smooth``. About two seconds per trial and core.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import harness
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id_simulation import Options
from mocap_id_simulation.options import FaultOptions

ROWS: Mapping[str, Options] = {
    "ordinary": harness.SHORT,
    "hard": harness.HARD,
    "a third": replace(harness.SHORT, soft_tissue=0.33),
    "none": replace(harness.SHORT, soft_tissue=0),
    "filtered at 6 Hz": replace(harness.SHORT, faults=FaultOptions(filter_hz=6)),
    "filtered at 3 Hz": replace(harness.SHORT, faults=FaultOptions(filter_hz=3)),
    "wander of 1 mm": replace(harness.SHORT, faults=FaultOptions(wander_mm=1)),
    "wobble of 2 mm at 4 Hz": replace(harness.SHORT, faults=FaultOptions(wobble_mm=2)),
    "30 % of the frames repeated": replace(harness.SHORT, faults=FaultOptions(repeated_share=0.3)),
}
STRIDE = 0.05  # s: interval of the change at the edge of a drop-out


class Result(NamedTuple):
    inside: FloatArray  # (n, 3) shares of samples inside the intervals; NaN without intervals
    change: FloatArray  # (2, n, 2) mean square change of angle and velocity at the edges of drop-outs and elsewhere


def measure(options: Options) -> Result | None:
    """Simulate and run a trial and return its coverage; return None if the number of segments is wrong."""
    with harness.open_simulated(options) as done:
        if done is None:
            return None
        states, markers = done.read("states.parquet", "markers.parquet")
        if not harness.has_true_segments(states):
            return None
        error = done.state_errors(states)
    sd = harness.stack_states(states, "sd_")
    error[..., 0] -= np.nanmedian(error[..., 0], axis=0)
    inside = np.where(np.isfinite(error + sd), np.abs(error) <= harness.QUANTILE * sd, np.nan)
    # changes of the error over STRIDE, at the edges of drop-outs and elsewhere
    seen, time = np.isfinite(markers.values["residual"]), states["time"]
    half = max(1, round(STRIDE / 2 / float(np.median(np.diff(time)))))
    change = error[2 * half :, :, :2] - error[: -2 * half, :, :2]
    edge = np.append((seen[1:] != seen[:-1]).any(axis=1), False)[half:-half]
    near = np.convolve(edge, np.ones(2 * half + 1), mode="same") > 0
    parts = [change[edge], change[~near]]
    means = [np.nanmean(part**2, axis=0) if len(part) else np.full((3, 2), np.nan) for part in parts]
    return Result(np.nanmean(inside, axis=0), np.stack(means))


def main() -> None:
    given = harness.make_parser(__doc__, parallel=True, trials=100, first=920_000).parse_args()
    first, others = given.first, max(1, round(0.4 * given.trials))
    coverage, steps = [], []
    for row, options in ROWS.items():
        count = given.trials if row == "ordinary" else others
        tasks = [replace(options, seed=seed) for seed in range(first, first + count)]
        results = harness.measure_all(measure, tasks, given.jobs)
        refused = count - len(results)
        trials = f"{len(results)}" + (f" ({refused} refused)" if refused else "")
        inside = 100 * np.array([result.inside for result in results])  # (trials, n, 3)
        every = [*np.moveaxis(inside, 1, 0), inside.mean(axis=1)]
        for name, shares in zip((*harness.JOINTS, "**all**"), every, strict=True):
            cells = [f"{s.mean():.1f} / {np.quantile(s, 0.1):.0f}" if np.isfinite(s).all() else "–" for s in shares.T]
            coverage.append([row, trials, name, *cells])
        change = np.nanmean([result.change for result in results], axis=0)  # (2, n, 2)
        parts = (*change, np.maximum(change[0] - change[1], 0))
        for d, (name, scale) in enumerate((("angle, °", 180 / np.pi), ("velocity, rad/s", 1.0))):
            steps.append([row, name, *(f"{scale * np.sqrt(part[:, d]).max():.3f}" for part in parts)])
        first += count
        harness.report_progress(f"{row}: {len(results)} of {count} trials")
    source = f"{given.trials} ordinary and {others} other trials, seeds from {given.first}, two repetitions each"
    head = ["skin", "trials", "joint", "angle", "velocity", "acceleration"]
    sections = {
        "state-coverage": harness.describe_source(__file__, source),
        "state-coverage-shares": harness.format_table(head, coverage),
        "state-coverage-steps": harness.format_table(["skin", "state", "at edges", "elsewhere", "excess"], steps),
    }
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
