"""Coverage of the stated intervals of the joint states, and steps at drop-outs, on simulated sit-to-stands.

The trials run through the stages up to ``ukf-smooth``. About two seconds per trial and core.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import harness
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation import Options
from mocap_id.simulation.options import FaultOptions
from mocap_id.store import Folder

ROWS: Mapping[str, Options] = {
    "ordinary": harness.SHORT,
    "hard": replace(harness.SHORT, soft_tissue=2, occlusions=2),
    "a third": replace(harness.SHORT, soft_tissue=0.33),
    "none": replace(harness.SHORT, soft_tissue=0),
    "filtered at 6 Hz": replace(harness.SHORT, faults=FaultOptions(filter_hz=6)),
    "filtered at 3 Hz": replace(harness.SHORT, faults=FaultOptions(filter_hz=3)),
    "wander of 1 mm": replace(harness.SHORT, faults=FaultOptions(wander_mm=1)),
    "wobble of 2 mm at 4 Hz": replace(harness.SHORT, faults=FaultOptions(wobble_mm=2)),
    "30 % of the frames repeated": replace(harness.SHORT, faults=FaultOptions(repeated_share=0.3)),
}
STRIDE = 0.05  # s: interval of the change at the edge of a drop-out


@dataclass(frozen=True)
class Result:
    """Of one trial: shares (n, 3) of samples inside, and mean square change (2, n, 2) at edges and elsewhere.

    A share is NaN if the states have no intervals.
    """

    inside: FloatArray
    change: FloatArray


def measure(options: Options) -> Result | None:
    """Simulate and run a trial and return its coverage; None without the true number of segments."""
    with tempfile.TemporaryDirectory() as place:
        run = harness.run_simulated(Path(place) / "trial", options)
        if run is None:
            return None
        states, markers = harness.read_artefacts(Folder(run[0].out), "states.parquet", "markers.parquet")
        if not harness.has_true_segments(states):
            return None
        truth = harness.read_true_arrays(run[1], states["time"], ("q", "qd", "qdd"))
    error = harness.state_arrays(states) - np.stack([truth[name] for name in ("q", "qd", "qdd")], axis=2)
    sd = harness.state_arrays(states, "sd_")
    error[..., 0] -= np.nanmedian(error[..., 0], axis=0)
    inside = np.where(np.isfinite(error + sd), np.abs(error) <= harness.QUANTILE * sd, np.nan)
    seen = np.isfinite(markers.values["residual"])
    return Result(np.nanmean(inside, axis=0), _change(error, seen, states["time"]))


def _change(error: FloatArray, seen: FloatArray, time: FloatArray) -> FloatArray:
    """Return (2, n, 2) mean square change of angle and velocity at the edges of drop-outs, and elsewhere."""
    half = max(1, round(STRIDE / 2 / float(np.median(np.diff(time)))))
    change = error[2 * half :, :, :2] - error[: -2 * half, :, :2]
    edge = np.append((seen[1:] != seen[:-1]).any(axis=1), False)[half:-half]
    near = np.convolve(edge, np.ones(2 * half + 1), mode="same") > 0
    parts = [change[edge], change[~near]]
    return np.stack([np.nanmean(part**2, axis=0) if len(part) else np.full((3, 2), np.nan) for part in parts])


def coverage_rows(row: str, results: Sequence[Result], refused: int) -> list[list[str]]:
    """Return the coverage of each joint and of all."""
    inside = 100 * np.array([result.inside for result in results])
    rows = []
    for name, share in zip(
        (*harness.JOINTS, "**all**"), [*np.moveaxis(inside, 1, 0), inside.mean(axis=1)], strict=True
    ):
        cells = [f"{s.mean():.1f} / {np.quantile(s, 0.1):.0f}" if np.isfinite(s).all() else "–" for s in share.T]
        trials = f"{len(results)}" + (f" ({refused} refused)" if refused else "")
        rows.append([row, trials, name, *cells])
    return rows


def step_rows(row: str, results: Sequence[Result]) -> list[list[str]]:
    """Return the change at the edges of drop-outs, elsewhere, and the excess of the former."""
    change = np.nanmean([result.change for result in results], axis=0)  # (2, n, 2)
    rows = []
    for d, (name, scale) in enumerate((("angle, °", 180 / np.pi), ("velocity, rad/s", 1.0))):
        parts = (*change, np.maximum(change[0] - change[1], 0))
        rows.append([row, name, *(f"{scale * np.sqrt(part[:, d]).max():.3f}" for part in parts)])
    return rows


def main() -> None:
    """Measure all rows."""
    arguments = harness.command_line(__doc__, parallel=True, trials=100, first=920_000).parse_args()
    first, others = arguments.first, max(1, round(0.4 * arguments.trials))
    coverage, steps = [], []
    for row, options in ROWS.items():
        count = arguments.trials if row == "ordinary" else others
        tasks = [replace(options, seed=seed) for seed in range(first, first + count)]
        found = [result for result in harness.run_all(measure, tasks, arguments.jobs) if result is not None]
        coverage += coverage_rows(row, found, count - len(found))
        steps += step_rows(row, found)
        first += count
        harness.progress(f"{row}: {len(found)} of {count} trials")
    source = f"{arguments.trials} ordinary and {others} other trials"
    sections = {
        "state-coverage": harness.measured_by(
            __file__, f"{source}, seeds from {arguments.first}, two repetitions each"
        ),
        "state-coverage-shares": harness.markdown(
            ["skin", "trials", "joint", "angle", "velocity", "acceleration"], coverage
        ),
        "state-coverage-steps": harness.markdown(["skin", "state", "at edges", "elsewhere", "excess"], steps),
    }
    harness.publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
