"""Sensors beside the cameras, on simulated trials with exact truth: boards, sensors at the hand, inertial sensors.

Rows and limits are those of docs/measured/sensors.md. About five seconds per trial and core.
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import harness
import numpy as np
import sensor_arms
import sensor_conditions
import sensor_handle

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.runner import run
from mocap_id.simulation import Options, simulate
from mocap_id.simulation.arm.options import Preset
from mocap_id.simulation.simulated_trial import generate
from mocap_id.simulation.trial_files import c3d_bytes
from mocap_id.store import Folder

_MOVING = 0.5  # rad/s, sum of the joints
STRATEGIES = ("normal", "dynamic", "stable")
LIMITS = {
    "clock, ms": 5.0,
    "centre of pressure at its own mean, mm": 4.0,
    "place of the board, mm": 8.0,
    "first moments, %": 4.0,
}


@dataclass(frozen=True)
class Outcome:
    """What came of one trial: cautions, errors, and shares inside 95 % intervals."""

    codes: tuple[str, ...]
    errors: Mapping[str, float] = field(default_factory=dict)
    inside: Mapping[str, float] = field(default_factory=dict)


def measure_board(task: tuple[int, bool]) -> Outcome:
    """Simulate and run a trial on a balance board, whose place is given or not, and compare it with its truth."""
    seed, given = task
    offset = float(np.random.default_rng(seed).uniform(-0.1, 0.1))
    options = Options(
        seed=seed, repetitions=3, analog_rate=100, board=True, strategy=STRATEGIES[seed % 3], clock_offset=offset
    )
    with tempfile.TemporaryDirectory() as place:
        configuration = simulate("sit-to-stand", Path(place) / "trial", options)
        truth = harness.read_truth(configuration)
        if given:
            _give_place(configuration, truth)
        out = run(load(configuration)).folder
        summary: dict[str, Any] = json.loads((out / "summary.json").read_text("utf-8"))
        codes = tuple(reason["code"] for reason in summary["verdict"]["reasons"] if reason.get("level") != "ok")
        base = summary["dynamics"]["base"]
        if not base or base[0]["value"] is None:
            return Outcome(codes)
        dynamics = Folder(out).read("dynamics.parquet")
        true = harness.read_true_arrays(configuration, dynamics["time"], ["cop_x"])["cop_x"]
        return _compared(codes, summary, truth, dynamics, true)


def _give_place(configuration: Path, truth: Mapping[str, Any]) -> None:
    """Add the true place and direction of the board to the configuration."""
    board, yaw = truth["board"], np.radians(truth["plane"]["yaw_deg"])
    forwards = -np.array([np.cos(yaw), np.sin(yaw)])
    centre = board["centre"][0] * forwards + board["centre"][1] * np.array([-forwards[1], forwards[0]])
    centre += np.array(truth["plate"]["centre_lab_mm"][:2]) / 1000
    height = truth["plate"]["centre_lab_mm"][2] / 1000
    more = f"board.csv, top: {board['top']}, centre_m: [{centre[0]:.4f}, {centre[1]:.4f}, {height:.4f}]"
    configuration.write_text(configuration.read_text("utf-8").replace("board.csv", more), "utf-8")


def _compared(
    codes: tuple[str, ...], summary: Mapping[str, Any], truth: Mapping[str, Any], dynamics: Any, true: FloatArray
) -> Outcome:
    fit, found = dynamics["in_fit"], summary["dynamics"]
    away, sd = (dynamics["cop_x_model"] - true)[fit], dynamics["sd_cop_x_model"][fit]
    values, deviations = (np.array([each[key] for each in found["base"]]) for key in ("value", "sd"))
    right = np.array(truth["base_parameters"]["values"])
    first, inertia = [(2, 3), (5, 6), (8, 9)], [4, 7, 10]
    sizes = [(np.hypot(*values[list(pair)]), np.hypot(*right[list(pair)]), deviations[pair[1]]) for pair in first]
    moments = [abs(got / real - 1.0) for got, real, _ in sizes]
    scores = [abs(got - real) / spread for got, real, spread in sizes]
    scores += [abs(values[k] - right[k]) / deviations[k] for k in (0, *inertia)]
    errors = {
        "clock, ms": 1e3 * abs((found["clock_offset_s"] or np.nan) - truth["board"]["clock_offset"]),
        "centre of pressure at its own mean, mm": 1e3 * float(np.nanstd(away)),
        "place of the board, mm": 1e3 * abs(float(np.nanmean(away))),
        "first moments, %": 100 * max(moments),
    }
    inside = {
        "centre of pressure": float(np.mean(np.abs(away) < harness.QUANTILE * sd)),
        "parameters": float(np.mean(np.array(scores) < harness.QUANTILE)),
    }
    return Outcome(codes, errors, inside)


def table(name: str, outcomes: Sequence[Outcome], limits: Mapping[str, float] = LIMITS) -> str:
    """Return the table of a row: quantity, limit, share within it, median and 80 % quantile."""
    done = [each for each in outcomes if each.errors]
    codes = Counter(code for each in outcomes for code in each.codes)
    listed = ", ".join(f"`{code}` {count}" for code, count in codes.most_common()) or "none"
    rows = []
    for quantity, limit in limits.items():
        values = np.array([each.errors[quantity] for each in done])
        middle, high = np.quantile(values, (0.5, 0.8))
        share = f"{100 * np.mean(values <= limit):.0f} %"
        shown = (f"{value:.2f}" if value >= 1 or value == 0 else f"{value:.2g}" for value in (middle, high))
        rows.append([quantity, f"{limit:g}", share, *shown])
    for quantity in done[0].inside:
        values = np.array([each.inside[quantity] for each in done])
        low, high = np.quantile(values, (0.1, 0.9))
        rows.append([f"inside 95 %: {quantity}", "0.88–0.99", f"{np.mean(values):.3f}", f"{low:.3f}", f"{high:.3f}"])
    head = ["quantity", "limit", "within it", "median (10 %)", "80 % (90 %)"]
    about = f"**{name}**, {len(outcomes)} trials, identified {len(done)}. Cautions: {listed}."
    return about + "\n\n" + harness.markdown(head, rows, numbers_from=1)


def boards(first: int, trials: int, jobs: int | None) -> str:
    """Return the tables of the balance board."""
    tables = []
    for name, given in (("place found by the model", False), ("place and direction given", True)):
        tasks = [(seed, given) for seed in range(first, first + trials)]
        tables.append(table(name, harness.run_all(measure_board, tasks, jobs)))
        harness.progress(tables[-1])
    return "\n\n".join(tables)


def measure_wrist(task: tuple[int, str, bool]) -> Outcome:
    """Simulate and run a trial of the UR5's wrist, with or without a wrench sensor in the joint."""
    seed, speed, sensor = task
    options = Options(seed=seed, joint="wrist", speed="fast" if speed == "fast" else "slow", joint_sensor=sensor)
    with tempfile.TemporaryDirectory() as place:
        configuration = simulate("robot", Path(place) / "trial", options)
        truth = harness.read_truth(configuration)
        out = run(load(configuration)).folder
        summary: dict[str, Any] = json.loads((out / "summary.json").read_text("utf-8"))
        codes = tuple(reason["code"] for reason in summary["verdict"]["reasons"] if reason.get("level") != "ok")
        found, right = summary["dynamics"]["base"], truth["base_parameters"]["values"]
        pairs = {"my2": (3, 3), "Izz2": (4, 4)}
        away = {name: found[k]["value"] - right[j] for name, (k, j) in pairs.items()}
        errors = {f"{name}, %": 100 * abs(away[name] / right[j]) for name, (_, j) in pairs.items()}
        inside = {name: float(abs(away[name]) < harness.QUANTILE * found[k]["sd"]) for name, (k, _) in pairs.items()}
        stated = {f"stated sd of {name}, %": 100 * found[k]["sd"] / right[j] for name, (k, j) in pairs.items()}
        return Outcome(codes, errors | stated, inside)


def wrists(first: int, trials: int, jobs: int | None) -> str:
    """Return the tables of the UR5's wrist."""
    limits = {"my2, %": 2.0, "Izz2, %": 5.0, "stated sd of my2, %": 2.0, "stated sd of Izz2, %": 5.0}
    tables = []
    for speed in ("fast", "slow"):
        for sensor in (False, True):
            name = f"{speed}, {'plate and sensor in the joint' if sensor else 'plate alone'}"
            tasks = [(seed, speed, sensor) for seed in range(first, first + trials)]
            tables.append(table(name, harness.run_all(measure_wrist, tasks, jobs), limits))
            harness.progress(tables[-1])
    return "\n\n".join(tables)


def measure_inertial(seed: int) -> Outcome:
    """Simulate a sit-to-stand with three inertial sensors, and run it with them, without them, and with a gap."""
    options = Options(seed=seed, repetitions=3, analog_rate=100, strategy=STRATEGIES[seed % 3], imus=True)
    with tempfile.TemporaryDirectory() as place:
        configuration = simulate("sit-to-stand", Path(place) / "trial", options)
        text, truth = configuration.read_text("utf-8"), harness.read_truth(configuration)
        summary, away, sd, time = _run_states(configuration)
        configuration.write_text(text.split("imus:")[0], "utf-8")
        without, alone, _, _ = _run_states(configuration)
        configuration.write_text(text, "utf-8")
        hidden = _hide(configuration, options)
        _, gap, gap_sd, _ = _run_states(configuration)
    gap[..., 0] -= np.nanmean(np.delete(gap[..., 0], np.r_[hidden], axis=0), axis=0)
    codes = tuple(reason["code"] for reason in summary["verdict"]["reasons"] if reason.get("level") != "ok")
    off = {name: _clock_error(each, truth["imu"][name], time.mean()) for name, each in summary["imus"].items()}
    shown = [abs(off[name]) for name, each in summary["imus"].items() if each["observable"]]
    ratio = harness.rms(away[..., 2]) / harness.rms(alone[..., 2])
    right = truth["base_parameters"]["values"]
    inertia = [
        np.mean([abs(each["dynamics"]["base"][k]["value"] / right[k] - 1) for k in (4, 7, 10)])
        for each in (summary, without)
    ]
    errors = {
        "acceleration, share of that of markers alone": float(np.mean(ratio)),
        "velocity, share of that of markers alone": float(
            np.mean(harness.rms(away[..., 1]) / harness.rms(alone[..., 1]))
        ),
        "clock where the motion shows it, ms": 1e3 * max(shown, default=0.0),
        "sensors whose clock is not shown": float(len(off) - len(shown)),
        "I2–I4, %": 100 * float(inertia[0]),
        "I2–I4 from markers alone, %": 100 * float(inertia[1]),
        "angle in 2 s without markers, degrees": float(np.degrees(np.abs(gap[hidden][..., 0]).max())),
    }
    within = np.abs(away) < harness.QUANTILE * sd
    bridged = np.abs(gap[hidden][..., 0]) < harness.QUANTILE * gap_sd[hidden][..., 0]
    clocks = [abs(off[name]) < harness.QUANTILE * each["sd_s"] for name, each in summary["imus"].items()]
    inside = {
        "velocity": float(within[..., 1].mean()),
        "acceleration": float(within[..., 2].mean()),
        "angle without markers": float(bridged.mean()),
        "clock": float(np.mean(clocks)),
    }
    return Outcome(codes, errors, inside)


def _run_states(configuration: Path) -> tuple[dict[str, Any], FloatArray, FloatArray, FloatArray]:
    """Run a trial; return its summary, errors and standard deviations (F, n, 3) of its states, and the times (F,)."""
    out = run(load(configuration)).folder
    states = Folder(out).read("states.parquet")
    true = harness.read_true_arrays(configuration, states["time"], ["q", "qd", "qdd"])
    away = harness.state_arrays(states) - np.stack([true[name] for name in ("q", "qd", "qdd")], axis=2)
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text("utf-8"))
    return summary, away, harness.state_arrays(states, "sd_"), states["time"]


def _hide(configuration: Path, options: Options) -> slice:
    """Hide all markers for 2 s, beginning in a movement, and return these frames."""
    trial = generate("sit-to-stand", options)
    speed = np.abs(trial.state.qd).sum(axis=1)
    moving = np.flatnonzero(speed[300:-500] > _MOVING) + 300
    first = int(np.random.default_rng(options.seed).choice(moving)) - 50
    points = trial.points.copy()
    points[first : first + 200] = np.nan
    configuration.with_name("trial.c3d").write_bytes(c3d_bytes(options, replace(trial, points=points)))
    return slice(first, first + 200)


def _clock_error(found: Mapping[str, Any], truth: Mapping[str, Any], middle: float) -> float:
    """Return the error of a clock in the middle of the trial, s."""
    return float(found["clock_offset_s"] - truth["offset_s"] + 1e-6 * (found["ppm"] - truth["ppm"]) * middle)


def inertial(first: int, trials: int, jobs: int | None) -> str:
    """Return the table of inertial sensors in the plane."""
    limits = {
        "acceleration, share of that of markers alone": 0.6,
        "velocity, share of that of markers alone": 1.0,
        "clock where the motion shows it, ms": 2.0,
        "sensors whose clock is not shown": 0.0,
        "I2–I4, %": 3.0,
        "I2–I4 from markers alone, %": 3.0,
        "angle in 2 s without markers, degrees": 3.0,
    }
    outcomes = harness.run_all(measure_inertial, range(first, first + trials), jobs)
    found = table("sit-to-stand, sensors on shank, thigh and trunk", outcomes, limits)
    harness.progress(found)
    return found


def measure_arm(task: tuple[int, Preset]) -> Outcome:
    """Simulate an arm with inertial sensors, and run it with them, without them, and with a gap."""
    with tempfile.TemporaryDirectory() as place:
        return Outcome(*sensor_arms.measure(*task, Path(place)))


def arms(first: int, trials: int, jobs: int | None) -> str:
    """Return the tables of inertial sensors beside the markers of an arm."""
    tables = []
    for preset, limit in sensor_arms.LIMITS.items():
        limits = {
            "acceleration of the forearm, rad/s²": limit,
            "from markers alone, rad/s²": limit,
            "acceleration of the upper arm, rad/s²": limit,
            "of the upper arm from markers alone, rad/s²": limit,
            "clock where the motion shows it, ms": 2.0,
            "upper arm in 2 s without markers, degrees": 3.0,
            "forearm in 2 s without markers, degrees": 3.0,
            "upper arm in the same 2 s with markers, degrees": 3.0,
            "forearm in the same 2 s with markers, degrees": 3.0,
        }
        outcomes = harness.run_all(measure_arm, [(seed, preset) for seed in range(first, first + trials)], jobs)
        tables.append(table(f"reaches, {preset} errors, a sensor on every segment", outcomes, limits))
        harness.progress(tables[-1])
    return "\n\n".join(tables)


def measure_alone(seed: int) -> Outcome:
    """Simulate two trials of a person, and run the second one with its inertial sensors alone."""
    with tempfile.TemporaryDirectory() as place:
        found = sensor_conditions.run_alone(Path(place), seed)
    return Outcome(found.codes, found.errors, found.inside)


def alone(first: int, trials: int, jobs: int | None) -> str:
    """Return the table of inertial sensors without markers."""
    limits = {
        "joint angles, degrees": 1.5,
        "largest error of an angle, degrees": 3.0,
        "joint velocities, rad/s": 0.03,
        "joint accelerations, rad/s²": 0.15,
        "clock between sensors, ms": 10.0,
    }
    outcomes = harness.run_all(measure_alone, range(first, first + trials), jobs)
    found = table("sit-to-stand, sensors on shank, thigh and trunk, no markers", outcomes, limits)
    harness.progress(found)
    return found


def measure_conditions(seed: int) -> dict[str, sensor_conditions.Result]:
    """Simulate and run the same trial of a person in three conditions."""
    with tempfile.TemporaryDirectory() as place:
        return {
            "cameras and force plate": sensor_conditions.run_cameras(Path(place), seed, board=False),
            "cameras and balance board": sensor_conditions.run_cameras(Path(place), seed, board=True),
            "inertial sensors alone": sensor_conditions.run_alone(Path(place), seed),
        }


def conditions(first: int, trials: int, jobs: int | None) -> str:
    """Return the table of the three conditions."""
    rows = harness.run_all(measure_conditions, range(first, first + trials), jobs)
    found = sensor_conditions.conditions_table(rows)
    harness.progress(found)
    return found


SECTIONS = {
    "boards": boards,
    "wrists": wrists,
    "handles": sensor_handle.handles,
    "inertial": inertial,
    "arms": arms,
    "alone": alone,
    "conditions": conditions,
}


def main() -> None:
    """Measure all sections, or those given by ``--only``."""
    parser = harness.command_line(__doc__, parallel=True, trials=24, first=310_000)
    parser.add_argument("--only", nargs="*", default=list(SECTIONS), choices=list(SECTIONS), help="sections to measure")
    given = parser.parse_args()
    about = harness.measured_by(__file__, f"{given.trials} trials a row, seeds from {given.first}")
    sections = {f"sensors-{name}": SECTIONS[name](given.first, given.trials, given.jobs) for name in given.only}
    harness.publish({name: f"{about}\n\n{text}" for name, text in sections.items()}, write=given.write)


if __name__ == "__main__":
    main()
