"""Errors of the identified dynamics on simulated sit-to-stands: parameters, wrench, torques and their intervals.

Every trial has a new body, motion, plane, skin movement, plate and drop-outs. It is written as a C3D file and run
through the stages up to ``identify-dim``. About two seconds per trial and core. benchmarks/dynamic_sources.py measures
where the errors come from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

import harness
import numpy as np
from harness import JOINTS, SEGMENTS, Run, format_numbers, mark_coverage, read_group, rms, stack_states
from kinematic_sweep import ROWS as KINEMATIC

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics import identification
from mocap_id.dynamics.consistency import fit_consistent
from mocap_id.dynamics.regressor import planar_regressor, structural_base
from mocap_id.geometry import planar
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.store import Table, Tree
from mocap_id_simulation.options import Options, Strategy

BASE = ("Σm", "mx1", "mx2", "my2", "I2", "mx3", "my3", "I3", "mx4", "my4", "I4")
NORMS = ("mass", "mx1", "(mx, my)2", "I2", "(mx, my)3", "I3", "(mx, my)4", "I4")
WRENCH = ("Fx", "Fy", "tauz")
SERIES = (*WRENCH, "CoP", *JOINTS)
TITLES = (*WRENCH, "CoP", *(f"{joint} torque" for joint in JOINTS))
UNITS = ("N", "N", "N·m", "mm", "N·m", "N·m", "N·m")
SCALE = np.array([1, 1, 1, 1e3, 1, 1, 1])


@dataclass(frozen=True)
class TrialWithTruth:
    """A simulated trial that went through ``identify-dim``, and its truth."""

    time: FloatArray  # (F,) s
    chain: Tree
    dynamics: Tree
    states: Table
    predicted: Table  # dynamics.parquet
    truth: Mapping[str, Any]  # truth.json
    true: Mapping[str, FloatArray]  # truth.npz at ``time``

    @property
    def off_seat(self) -> BoolArray:
        """(F,) samples from a seat-off to its seat-on, where the force of the chair is exactly zero."""
        return find_off_seat(self.time, self.truth)

    @property
    def base(self) -> Mapping[str, FloatArray]:
        node: Any = self.dynamics.data["base"]
        return {key: np.asarray(node[key], dtype=np.float64) for key in ("value", "sd", "regrouping")}

    @property
    def markers(self) -> Mapping[str, tuple[int, FloatArray]]:
        """Segment of every marker, and its position in the segment's frame, m."""
        node = read_group(self.chain, "markers")
        rows = zip(node["name"], node["segment"], node["local"], strict=True)
        return {str(name): (int(segment), local) for name, segment, local in rows}


def find_off_seat(time: FloatArray, truth: Mapping[str, Any]) -> BoolArray:
    """Return which samples (F,) are between a seat-off and its seat-on."""
    inside = [(time >= one["seat_off"]) & (time <= one["seat_on"]) for one in truth["reps"]]
    return np.asarray(np.any(inside, axis=0))


def read_with_truth(done: Run) -> TrialWithTruth | None:
    """Read a simulated trial and its truth; return None without four segments or without parameters."""
    names = ("chain.h5", "dynamics.h5", "states.parquet", "dynamics.parquet")
    chain, dynamics, states, predicted = done.read(*names)
    if len(read_group(chain, "joints")["centre"]) != SEGMENTS - 1 or dynamics.facts["why"] is not None:
        return None
    keys, time = ("q", "qd", "qdd", "wrench", "tau"), states["time"]
    true = dict(zip(keys, done.true(time, *keys), strict=True))
    return TrialWithTruth(time, chain, dynamics, states, predicted, done.truth, true)


def find_last_frame_turn(truth: Mapping[str, Any], chain: Tree) -> float:
    """Return the angle, rad, from the true frame of the last segment to the frame whose y points to its markers."""
    markers, last = read_group(chain, "markers"), len(truth["segments"]) - 1
    local = {marker["label"]: marker["local_xyz_m"][:2] for marker in truth["markers"]}
    own = [local[str(name)] for name, k in zip(markers["name"], markers["segment"], strict=True) if k == last]
    x, y = np.mean(own, axis=0)
    return float(np.arctan2(-x, y))


def read_true_centres(truth: Mapping[str, Any]) -> FloatArray:
    """Return (n, 2) true joint centres, m."""
    return np.array([segment["p_in_parent_m"] for segment in truth["segments"][1:]])


def regroup_truth(truth: Mapping[str, Any], turn: float, side: int = 1) -> FloatArray:
    """Return (b,) true base parameters, regrouped with the true lengths, in the frames of the chain.

    ``turn`` is that of :func:`find_last_frame_turn`; ``side`` is -1 if x of the plane is opposite to x of the truth.
    """
    full = np.array([[s["m"], s["mx"], s["my"], s["Izz"]] for s in truth["segments"]])
    full[-1, 1:3] = planar.rotate(np.array(-turn), full[-1, 1:3])
    full[:, 1] *= side
    return np.asarray(structural_base(read_true_centres(truth) * [side, 1]).regrouping @ full.reshape(-1))


def compute_true_base(done: TrialWithTruth) -> FloatArray:
    return regroup_truth(done.truth, find_last_frame_turn(done.truth, done.chain))


def compute_norms(base: FloatArray) -> FloatArray:
    """Return (8,) mass, mx1, and |(mx, my)| and I of each moving segment, independent of rotations of frames."""
    blocks = base[2:].reshape(-1, 3)
    return np.append(base[:2], np.column_stack([np.hypot(blocks[:, 0], blocks[:, 1]), blocks[:, 2]]))


def stack_true_series(true: Mapping[str, FloatArray]) -> FloatArray:
    """Return (F, 7) true wrench, N and N·m, centre of pressure, m, and torques, N·m."""
    wrench = true["wrench"]
    return np.column_stack([wrench, wrench[:, 2] / wrench[:, 1], true["tau"]])


def stack_series(predicted: Table, prefix: str = "") -> FloatArray:
    """Return (F, 7) wrench, centre of pressure and torques of the model, or with ``sd_`` their standard deviations."""
    names = [f"{name}_model" for name in (*WRENCH, "cop_x")] + [f"tau_{j}" for j in range(1, SEGMENTS)]
    return predicted.stack([prefix + name for name in names])


def transfer_parameters(fitted: TrialWithTruth, other: TrialWithTruth) -> FloatArray:
    """Return (4(n + 1),) full parameters of one trial of a person in the frames of another trial.

    The common markers of a moving segment give its rotation and shift. The base does not change, since both plane
    frames lie in the plate and the feet do not move.
    """
    node: Any = fitted.dynamics.data["full"]
    full = np.array(node["value"], dtype=np.float64).reshape(-1, 4)
    here, there = fitted.markers, other.markers
    for k in range(1, len(full)):
        both = [name for name in here if here[name][0] == k and there.get(name, (-1,))[0] == k]
        own, theirs = (np.array([side[name][1] for name in both]) @ [1, 1j] for side in (here, there))
        turn = float(np.angle(np.sum(np.conj(own - own.mean()) * (theirs - theirs.mean()))))
        shift = theirs.mean() - np.exp(1j * turn) * own.mean()
        mass, first = full[k, 0], (full[k, 1] + 1j * full[k, 2]) * np.exp(1j * turn)
        full[k, 3] += 2 * (np.conj(shift) * first).real + mass * abs(shift) ** 2
        full[k, 1:3] = (first + mass * shift).real, (first + mass * shift).imag
    return full.reshape(-1)


def compute_wrench_errors(done: TrialWithTruth, base: FloatArray) -> FloatArray:
    """Return (4,) rms errors off the seat of Fx, Fy, tauz and centre of pressure (mm) with base parameters (b,)."""
    q, dq, ddq = np.moveaxis(stack_states(done.states), 2, 0)
    centres = read_group(done.chain, "joints")["centre"]
    regressor = planar_regressor(centres, q, dq, ddq, done.truth["g"])
    wrench = regressor[:, :, structural_base(centres).kept] @ base
    model = np.column_stack([wrench, wrench[:, 2] / wrench[:, 1]])
    return np.asarray(rms((model - stack_true_series(done.true)[:, :4])[done.off_seat]) * SCALE[:4])


ANALOG = 1000.0  # Hz
ROWS: Mapping[str, Options] = {
    "clean": replace(KINEMATIC["clean"], analog_rate=ANALOG, plate_noise=0),
    "ordinary": replace(KINEMATIC["ordinary"], analog_rate=ANALOG),
    "hard": replace(KINEMATIC["hard"], analog_rate=ANALOG, plate_bias=1, plate_moved=True, clock_offset=0.004),
}
STRATEGIES: tuple[Strategy, ...] = ("normal", "dynamic", "stable")
TIMED_FRAMES, CALLS = 16_000, 10
LONG = Options(rate=480, analog_rate=480, repetitions=5)  # has more than TIMED_FRAMES frames


@dataclass(frozen=True)
class Result:
    norms: FloatArray  # (8,) of NORMS, %
    rms: FloatArray  # (7,) of SERIES in UNITS
    offset: float  # of the clock, ms; NaN without a clock offset
    error: FloatArray  # (11,) of the base parameters, SI
    sd: FloatArray  # (11,)
    inside: FloatArray  # (7,) share of the samples inside the stated interval
    relative_error: FloatArray  # (7,) rms error in stated standard deviations

    @property
    def all(self) -> FloatArray:
        """(16,) absolute errors: norms, series and offset."""
        return np.abs([*self.norms, *self.rms, self.offset])


def run_trial(place: Path, options: Options) -> TrialWithTruth | None:
    """Simulate and run a trial; return None if it is refused, has wrong segments, or is not identified."""
    done = harness.run_simulated(place, options, harness.DYNAMIC, settings=f"identify-dim: {{{harness.EXACT}}}")
    return None if done is None else read_with_truth(done)


def measure(options: Options) -> Result | None:
    with harness.temporary_folder() as place:
        done = run_trial(place / "trial", options)
    return None if done is None else compare(done)


def compare(done: TrialWithTruth) -> Result:
    base, true = done.base, compute_true_base(done)
    off = (stack_series(done.predicted) - stack_true_series(done.true))[done.off_seat]
    relative = off / stack_series(done.predicted, "sd_")[done.off_seat]
    offset = done.dynamics.facts["clock_offset_s"]
    return Result(
        norms=100 * (compute_norms(base["value"]) / compute_norms(true) - 1),
        rms=harness.rms(off) * SCALE,
        offset=np.nan if offset is None else 1e3 * (offset - done.truth["analog_offset_s"]),
        error=base["value"] - true,
        sd=base["sd"],
        inside=np.mean(np.abs(relative) <= harness.QUANTILE, axis=0),
        relative_error=harness.rms(relative),
    )


def measure_transfer(options: Options) -> FloatArray | None:
    """Return errors (3, 4, 6) of one person: parameters transferred, unchanged, own; quantity; pair of strategies."""
    with harness.temporary_folder() as place:
        trials = [run_trial(place / name, replace(options, strategy=name)) for name in STRATEGIES]
    errors = []
    for fitted, other in permutations(trials, 2):
        if fitted is None or other is None:
            return None
        moved = other.base["regrouping"] @ transfer_parameters(fitted, other)
        errors.append(
            [compute_wrench_errors(other, base) for base in (moved, fitted.base["value"], other.base["value"])]
        )
    return np.moveaxis(np.array(errors), 0, -1)


def list_limits(row: str) -> Iterator[tuple[str, str, float, str, int]]:
    """Yield each quantity of a row: name, unit, limit, required share (– without a requirement), column."""
    clean, hard = row == "clean", row == "hard"
    rms_of, offset = len(NORMS), len(NORMS) + len(SERIES)
    for k, name in enumerate(NORMS):
        limit = 1.0 if clean else 15.0 if hard else 7.0 if name.startswith("I") else 2.0
        if clean or (name not in NORMS[:2] and (name.startswith("I") or not hard)):
            yield name, "%", limit, "100 %" if clean else "90 %", k
    if clean or hard:
        yield "CoP", "mm", 0.2 if clean else 7.0, "100 %" if clean else "–", rms_of + 3
    else:
        for name, limit in (("Fy", 2.5), ("tauz", 2.0), ("CoP", 4.0), ("ankle", 6.0), ("knee", 3.0), ("hip", 2.0)):
            k = SERIES.index(name)
            yield TITLES[k], UNITS[k], limit, "–", rms_of + k
    if not hard:
        yield "clock offset", "ms", 0.2 if clean else 1.0, "100 %" if clean else "–", offset


def make_limit_table(found: Mapping[str, Sequence[Result | None]]) -> str:
    """Return the share of trials within each limit, and quantiles of the errors."""
    head = ["trials", "quantity", "limit", "required share", "share within the limit", "95 % interval"]
    head += ["median", "90th percentile", "largest"]
    rows = []
    for row, results in found.items():
        errors = np.array([np.full(len(NORMS) + len(SERIES) + 1, np.nan) if r is None else r.all for r in results])
        for name, unit, limit, required, column in list_limits(row):
            own = errors[:, column]
            shares = harness.format_share_with_interval(int(np.sum(own <= limit)), len(own))
            known = harness.format_quantiles(own[np.isfinite(own)])
            rows.append([row, name, f"{limit:g} {unit}", required, *shares, *known])
    return harness.format_table(head, rows)


def make_parameter_table(found: Mapping[str, Sequence[Result]]) -> str:
    head = ["parameter", *(f"{row}: {part}" for row in found for part in ("inside", "error / sd", "rms error", "sd"))]
    columns: list[list[str]] = []
    for results in found.values():
        error, sd = np.array([r.error for r in results]), np.array([r.sd for r in results])
        inside = np.mean(np.abs(error) <= harness.QUANTILE * sd, axis=0)
        columns.append([mark_coverage(100 * share, f"{100 * share:.0f}") for share in inside])
        columns += [
            format_numbers(harness.rms(error / sd)),
            format_numbers(harness.rms(error), ".2g"),
            format_numbers(np.median(sd, axis=0), ".2g"),
        ]
    return harness.format_table(head, [[name, *row] for name, *row in zip(BASE, *columns, strict=True)])


def make_sample_table(found: Mapping[str, Sequence[Result]]) -> str:
    head = ["", *(f"{row}: {part}" for row in found for part in ("inside", "error / sd"))]
    columns = []
    for results in found.values():
        inside = 100 * np.array([r.inside for r in results])
        low = np.quantile(inside, 0.1, axis=0)
        shares = zip(inside.mean(axis=0), low, strict=True)
        columns.append([f"{mark_coverage(mean, f'{mean:.1f}')} / {least:.0f}" for mean, least in shares])
        columns.append(format_numbers(harness.rms(np.array([r.relative_error for r in results]))))
    return harness.format_table(head, [[name, *row] for name, *row in zip(TITLES, *columns, strict=True)])


def make_transfer_table(errors: FloatArray) -> str:
    """Return quantiles of (subjects, 3, 4, 6) errors."""
    names = [f"{SERIES[k]}, {UNITS[k]}" for k in range(4)]
    rows = []
    for k, how in enumerate(("transferred", "unchanged", "own")):
        rows.append([how, "all", *harness.format_pairs(np.moveaxis(errors[:, k], 1, -1).reshape(-1, 4))])
    for pair, (one, other) in enumerate(permutations(STRATEGIES, 2)):
        rows.append(["transferred", f"{one} → {other}", *harness.format_pairs(errors[:, 0, :, pair])])
    return harness.format_table(["parameters", "from → to", *names], rows)


def make_first(first: int) -> str:
    """Return the errors of one ordinary person who rises with three strategies, as a test measures them again."""
    options = replace(ROWS["ordinary"], repetitions=2, seed=first)
    found = measure(options)
    assert found is not None
    names = [
        *(f"{name}, %" for name in NORMS),
        *(f"{title}, {unit}" for title, unit in zip(TITLES, UNITS, strict=True)),
    ]
    rows = zip([*names, "clock offset, ms"], format_numbers(found.all, ".2g"), strict=True)
    moved = measure_transfer(options)
    assert moved is not None
    table = harness.format_table(["quantity", "error"], rows)
    return f"One ordinary person, seed {first}:\n\n{table}\n\n{make_transfer_table(moved[None])}"


def measure_times(seed: int) -> dict[str, FloatArray]:
    """Return the shortest wall and processor time, s, of ``identify-dim`` and of its constrained fit."""
    with harness.temporary_folder() as place:
        done = harness.run_simulated(place / "trial", replace(LONG, seed=seed))
        assert done is not None
        inputs: Any = dict(zip(STAGE.inputs, done.read(*STAGE.inputs), strict=True))
    for name in ("states.parquet", "wrench.parquet", "poses.parquet"):
        columns = {key: values[:TIMED_FRAMES] for key, values in inputs[name].columns.items()}
        inputs[name] = replace(inputs[name], columns=columns)
    calls: dict[str, list[tuple[float, float]]] = {"the whole stage": [], "its constrained fit": []}

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            wall, own = perf_counter(), process_time()
            result = function(*arguments, **named)
            calls[name].append((perf_counter() - wall, process_time() - own))
            return result

        return call

    stage, solve = (timed(*each) for each in zip(calls, (STAGE.function, fit_consistent), strict=True))
    with patch.object(identification, "fit_consistent", solve):
        for _ in range(CALLS):
            stage(Context(done.trial.keys, done.trial.settings[STAGE.name], inputs))
    return {name: np.min(each, axis=0) for name, each in calls.items()}


def main() -> None:
    given = harness.make_parser(__doc__, parallel=True, trials=100, repetitions=2, first=980_000).parse_args()
    trials, first, subjects = given.trials, given.first, max(1, given.trials // 3)
    times = [[name, *format_numbers(pair, ".3f")] for name, pair in measure_times(first).items()]
    rows = {row: replace(options, repetitions=given.repetitions) for row, options in ROWS.items()}
    found: dict[str, list[Result | None]] = {}
    for row, options in rows.items():
        found[row] = harness.run_all(measure, [replace(options, seed=first + k) for k in range(trials)], given.jobs)
        first += trials
        harness.report_progress(f"{row}: {trials} trials, {sum(r is None for r in found[row])} without parameters")
    people = [replace(rows["ordinary"], seed=first + k) for k in range(subjects)]
    moved = np.array(harness.measure_all(measure_transfer, people, given.jobs))
    known = {row: [r for r in results if r is not None] for row, results in found.items()}
    source = f"{trials} trials per difficulty, seeds from {given.first}, with {given.repetitions} repetitions each"
    about = harness.describe_source(__file__, source)
    persons = f"{subjects} persons who rise with three strategies (`normal`, `dynamic`, `stable`; ordinary trials)"
    sections = {
        "dynamic-sweep": about,
        "dynamic-limits": make_limit_table(found),
        "dynamic-coverage": about,
        "dynamic-parameters": make_parameter_table(known),
        "dynamic-samples": make_sample_table(known),
        "dynamic-transfer-trials": harness.describe_source(__file__, persons),
        "dynamic-transfer": make_transfer_table(moved),
        "dynamic-first": make_first(given.first),
        "dynamic-times-trial": f"`identify-dim` on {TIMED_FRAMES:,} frames of a person, fastest of {CALLS} runs, with "
        "tables in memory. Required of the whole stage: at most 0.5 s.",
        "dynamic-times": harness.format_table(["", "wall time, s", "processor time, s"], times),
    }
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
