"""Sensors in addition to the cameras, on simulated trials: boards, sensors at the hand, inertial sensors.

Rows and limits are in docs/measured/sensors.md. It takes about five seconds per trial and core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import harness
import numpy as np
import sensor_arms
import sensor_conditions
import sensor_handle
from harness import QUANTILE, Comparison, Run, run_trial

from mocap_id.arrays import FloatArray
from mocap_id_simulation import Options, generate, simulate
from mocap_id_simulation.trial_files import c3d_bytes


@dataclass(frozen=True)
class Row:
    """A kind of trial."""

    name: str
    measure: Callable[..., Comparison]
    limits: Mapping[str, float]
    arguments: tuple[Any, ...] = ()


def measure_board(seed: int, given: bool) -> Comparison:
    """Simulate and run a trial on a balance board, whose position is given or not, and compare it with its truth."""
    offset = float(np.random.default_rng(seed).uniform(-0.1, 0.1))
    options = Options(
        seed=seed,
        repetitions=3,
        analog_rate=100,
        board=True,
        strategy=sensor_conditions.STRATEGIES[seed % 3],
        clock_offset=offset,
    )
    with harness.temporary_folder() as place:
        configuration = simulate("sit-to-stand", place / "trial", options)
        if given:
            _give_position(configuration, harness.read_truth(configuration))
        done = run_trial(configuration)
        base = done.summary["dynamics"]["base"]
        if not base or base[0]["value"] is None:
            return Comparison(done.codes)
        (dynamics,) = done.read("dynamics.parquet")
        error = dynamics["cop_x_model"] - done.true(dynamics["time"], "cop_x")[0]
        fit = dynamics["in_fit"]
        return _compare_board(done, error[fit], dynamics["sd_cop_x_model"][fit])


def _give_position(configuration: Path, truth: Mapping[str, Any]) -> None:
    """Add the true position and direction of the board to the configuration."""
    board, yaw = truth["board"], np.radians(truth["plane"]["yaw_deg"])
    forwards = -np.array([np.cos(yaw), np.sin(yaw)])
    centre = board["centre"][0] * forwards + board["centre"][1] * np.array([-forwards[1], forwards[0]])
    centre += np.array(truth["plate"]["centre_lab_mm"][:2]) / 1000
    height = truth["plate"]["centre_lab_mm"][2] / 1000
    more = f"board.csv, top: {board['top']}, centre_m: [{centre[0]:.4f}, {centre[1]:.4f}, {height:.4f}]"
    configuration.write_text(configuration.read_text("utf-8").replace("board.csv", more), "utf-8")


def _compare_board(done: Run, error: FloatArray, sd: FloatArray) -> Comparison:
    """Return the errors of the clock, the position, the centre of pressure, m, and the parameters."""
    clock = (done.summary["dynamics"]["clock_offset_s"] or np.nan) - done.truth["board"]["clock_offset"]
    values, deviations, right = done.base("value"), done.base("sd"), done.true_base
    first, inertia = [(2, 3), (5, 6), (8, 9)], [4, 7, 10]
    sizes = [(np.hypot(*values[list(pair)]), np.hypot(*right[list(pair)]), deviations[pair[1]]) for pair in first]
    scores = [abs(got - real) / spread for got, real, spread in sizes]
    scores += [abs(values[k] - right[k]) / deviations[k] for k in (0, *inertia)]
    errors = {
        "clock, ms": 1e3 * abs(clock),
        "centre of pressure at its own mean, mm": 1e3 * float(np.nanstd(error)),
        "place of the board, mm": 1e3 * abs(float(np.nanmean(error))),
        "first moments, %": 100 * max(abs(got / real - 1.0) for got, real, _ in sizes),
    }
    inside = {
        "centre of pressure": float(np.mean(np.abs(error) < QUANTILE * sd)),
        "parameters": float(np.mean(np.array(scores) < QUANTILE)),
    }
    return Comparison(done.codes, errors, inside)


def measure_wrist(seed: int, speed: Any, sensor: bool) -> Comparison:
    """Simulate and run a trial of the UR5's wrist, with or without a wrench sensor in the joint."""
    options = Options(seed=seed, joint="wrist", speed=speed, joint_sensor=sensor)
    with harness.temporary_folder() as place:
        done = run_trial(simulate("robot", place / "trial", options))
        found, sd, right, codes = done.base("value"), done.base("sd"), done.true_base, done.codes
    errors, stated, inside = {}, {}, {}
    for name, k in (("my2", 3), ("Izz2", 4)):
        error = abs(found[k] - right[k])
        errors[f"{name}, %"] = 100 * error / abs(right[k])
        stated[f"stated sd of {name}, %"] = 100 * sd[k] / right[k]
        inside[name] = float(error < QUANTILE * sd[k])
    return Comparison(codes, errors | stated, inside)


def measure_inertial(seed: int) -> Comparison:
    """Simulate a sit-to-stand with three inertial sensors, and run it with them, without them, and with a gap."""
    strategy = sensor_conditions.STRATEGIES[seed % 3]
    options = Options(seed=seed, repetitions=3, analog_rate=100, strategy=strategy, imus=True)
    with harness.temporary_folder() as place:
        configuration = simulate("sit-to-stand", place / "trial", options)
        text = configuration.read_text("utf-8")
        done, error, sd, time = _run_states(configuration)
        configuration.write_text(text.split("imus:")[0], "utf-8")
        without, alone, _, _ = _run_states(configuration)
        configuration.write_text(text, "utf-8")
        hidden = _hide(configuration, options)
        _, gap, gap_sd, _ = _run_states(configuration)
        right = done.true_base
    gap[..., 0] -= np.nanmean(np.delete(gap[..., 0], np.r_[hidden], axis=0), axis=0)
    clocks = sensor_conditions.compute_clock_errors(done, time.mean())
    shown = [abs(off) for off, _, observable in clocks if observable]
    inertia = [np.mean(np.abs(each.base("value")[[4, 7, 10]] / right[[4, 7, 10]] - 1)) for each in (done, without)]
    ratios = [float(np.mean(harness.rms(error[..., k]) / harness.rms(alone[..., k]))) for k in (2, 1)]
    errors = {
        "acceleration, share of that of markers alone": ratios[0],
        "velocity, share of that of markers alone": ratios[1],
        "clock where the motion shows it, ms": 1e3 * max(shown, default=0.0),
        "sensors whose clock is not shown": float(len(clocks) - len(shown)),
        "I2–I4, %": 100 * float(inertia[0]),
        "I2–I4 from markers alone, %": 100 * float(inertia[1]),
        "angle in 2 s without markers, degrees": float(np.degrees(np.abs(gap[hidden][..., 0]).max())),
    }
    within, angle = np.abs(error) < QUANTILE * sd, np.abs(gap[hidden][..., 0])
    inside = {
        "velocity": float(within[..., 1].mean()),
        "acceleration": float(within[..., 2].mean()),
        "angle without markers": float(np.mean(angle < QUANTILE * gap_sd[hidden][..., 0])),
        "clock": float(np.mean([abs(off) < QUANTILE * each for off, each, _ in clocks])),
    }
    return Comparison(done.codes, errors, inside)


def _run_states(configuration: Path) -> tuple[Run, FloatArray, FloatArray, FloatArray]:
    """Run a trial; return it, errors and standard deviations (F, n, 3) of its states, and the times (F,), s."""
    done = run_trial(configuration)
    done.summary  # noqa: B018 - a later run of the same configuration overwrites the file
    (states,) = done.read("states.parquet")
    return done, done.state_errors(states), harness.stack_states(states, "sd_"), states["time"]


def _hide(configuration: Path, options: Options) -> slice:
    """Hide all markers for 2 s, beginning in a movement, and return these frames."""
    trial = generate("sit-to-stand", options)
    hidden = harness.choose_gap(np.abs(trial.state.qd).sum(axis=1), options.rate, options.seed, (3.0, 5.0))
    points = trial.points.copy()
    points[hidden] = np.nan
    configuration.with_name("trial.c3d").write_bytes(c3d_bytes(options, replace(trial, points=points)))
    return hidden


_BOARD = {
    "clock, ms": 5.0,
    "centre of pressure at its own mean, mm": 4.0,
    "place of the board, mm": 8.0,
    "first moments, %": 4.0,
}
_WRIST = {"my2, %": 2.0, "Izz2, %": 5.0, "stated sd of my2, %": 2.0, "stated sd of Izz2, %": 5.0}
_INERTIAL = {
    "acceleration, share of that of markers alone": 0.6,
    "velocity, share of that of markers alone": 1.0,
    "clock where the motion shows it, ms": 2.0,
    "sensors whose clock is not shown": 0.0,
    "I2–I4, %": 3.0,
    "I2–I4 from markers alone, %": 3.0,
    "angle in 2 s without markers, degrees": 3.0,
}
_ALONE = {
    "joint angles, degrees": 1.5,
    "largest error of an angle, degrees": 3.0,
    "joint velocities, rad/s": 0.03,
    "joint accelerations, rad/s²": 0.15,
    "clock between sensors, ms": 10.0,
}
_ON = "sit-to-stand, sensors on shank, thigh and trunk"
TABLES: Mapping[str, Sequence[Row]] = {
    "boards": [
        Row("place found by the model", measure_board, _BOARD, (False,)),
        Row("place and direction given", measure_board, _BOARD, (True,)),
    ],
    "wrists": [
        Row(f"{speed}, {instruments}", measure_wrist, _WRIST, (speed, sensor))
        for speed in ("fast", "slow")
        for sensor, instruments in ((False, "plate alone"), (True, "plate and sensor in the joint"))
    ],
    "inertial": [Row(_ON, measure_inertial, _INERTIAL)],
    "arms": [
        Row(
            f"reaches, {preset} errors, a sensor on every segment",
            sensor_arms.measure,
            sensor_arms.list_limits(preset),
            (preset,),
        )
        for preset in sensor_arms.ACCELERATION
    ],
    "alone": [Row(f"{_ON}, no markers", sensor_conditions.run_alone, _ALONE)],
}


def measure_task(task: tuple[Row, int]) -> Comparison:
    """Measure a trial of a row."""
    row, seed = task
    return row.measure(seed, *row.arguments)


def make_table(row: Row, seeds: Sequence[int], jobs: int | None) -> str:
    """Measure a row and return its table."""
    every = harness.run_all(measure_task, [(row, seed) for seed in seeds], jobs)
    done = [each for each in every if each.errors]
    codes = harness.count_codes(code for each in every for code in each.codes)
    about = f"**{row.name}**, {len(every)} trials, identified {len(done)}. Cautions: {codes}."
    text = f"{about}\n\n{harness.make_limit_table(row.limits, done)}"
    harness.report_progress(text)
    return text


OTHERS: Mapping[str, Callable[[Sequence[int], int | None], str]] = {
    "handles": sensor_handle.make_table,
    "conditions": sensor_conditions.make_table,
}


def make_first(first: int) -> str:
    """Return the table of one trial on a board, as a test measures it again."""
    row = TABLES["boards"][0]
    found = measure_task((row, first))
    table = harness.make_limit_table(row.limits, [found])
    return f"One trial, {row.name}, seed {first}; cautions: {harness.count_codes(found.codes)}.\n\n{table}"


def main() -> None:
    """Measure all sections, or the sections in ``--only``, and publish them."""
    only = [*TABLES, *OTHERS]
    given = harness.make_parser(__doc__, parallel=True, only=only, trials=24, first=310_000).parse_args()
    about = harness.describe_source(__file__, f"{given.trials} trials a row, seeds from {given.first}")
    seeds, sections = range(given.first, given.first + given.trials), {}
    for name in given.only:
        if name in OTHERS:
            text = OTHERS[name](seeds, given.jobs)
        else:
            text = "\n\n".join(make_table(row, seeds, given.jobs) for row in TABLES[name])
        sections[f"sensors-{name}"] = f"{about}\n\n{text}"
        if name == "boards":
            sections["sensors-first"] = make_first(given.first)
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
