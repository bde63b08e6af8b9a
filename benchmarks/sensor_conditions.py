"""The same simulated people in a full laboratory, with cameras and a balance board, and with inertial sensors alone.

Each person first does a calibration trial with markers and inertial sensors. The second trial has another strategy. Its
true motion is the same in all three conditions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import harness
import numpy as np
from harness import QUANTILE, Comparison, Run, run_trial
from scipy.interpolate import CubicSpline

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id_simulation import Options, simulate
from mocap_id_simulation.options import draw_subject

STRATEGIES = ("normal", "dynamic", "stable")
_ENDS = 20  # frames at either end without figures


def draw_options(seed: int) -> tuple[Options, Options]:
    """Return the calibration trial and the second trial of a person, both with inertial sensors."""
    person = draw_subject(seed, 1)
    first = Options(seed=2 * seed, repetitions=3, analog_rate=100, imus=True, subject=person)
    second = replace(first, seed=2 * seed + 1, strategy=STRATEGIES[(1 + seed // 3) % 3])
    return replace(first, strategy=STRATEGIES[seed % 3]), second


def remove_recording(configuration: Path, calibration: Path) -> Path:
    """Return the configuration of a trial with its inertial sensors alone."""
    lines = configuration.read_text("utf-8").splitlines()
    kept = [line for line in lines if not line.startswith("recording:")]
    alone = configuration.with_name("alone.yaml")
    alone.write_text("\n".join([*kept, f"calibration: {calibration}", "out: runs/alone", ""]), "utf-8")
    return alone


def run_alone(seed: int) -> Comparison:
    """Simulate both trials of a person, and run the second one with its inertial sensors alone."""
    with harness.temporary_folder() as place:
        return _run_alone(place, seed)


def _run_alone(place: Path, seed: int) -> Comparison:
    first, second = draw_options(seed)
    calibration = simulate("sit-to-stand", place / "calibration", first)
    configuration = simulate("sit-to-stand", place / "trial", second)
    alone = remove_recording(configuration, calibration)
    done = run_trial(alone)
    (shown,) = Run(calibration, load(calibration)).read("states.parquet")
    constant = np.nanmean(_compute_errors(calibration, shown, shown["time"])[..., 0], axis=0)
    (states,) = done.read("states.parquet")
    clock = done.truth["imu"]
    time = clock["shank"]["offset_s"] + states["time"] * (1 + 1e-6 * clock["shank"]["ppm"])
    away, sd = _compute_errors(alone, states, time), harness.stack_states(states, "sd_")
    away[..., 0] -= constant
    errors, inside = _summarise_states(away, sd)
    others = {name: each for name, each in done.summary["imus"].items() if name != "shank"}
    between = {name: each["offset_s"] - clock["shank"]["offset_s"] for name, each in clock.items()}
    off = {name: each["clock_offset_s"] - between[name] for name, each in others.items()}
    errors["largest error of an angle, degrees"] = float(np.degrees(np.abs(away[_ENDS:-_ENDS, :, 0]).max()))
    errors["clock between sensors, ms"] = 1e3 * max(abs(each) for each in off.values())
    errors["repetitions"] = _count_right(done)
    inside["clock"] = float(np.mean([abs(off[n]) < QUANTILE * each["sd_s"] for n, each in others.items()]))
    # the true rotation of each sensor about the vertical is zero
    turned = [abs(each["heading_deg"]) < QUANTILE * each["heading_sd_deg"] for each in done.summary["imus"].values()]
    inside["heading"] = float(np.mean(turned))
    return Comparison(done.codes, errors, inside)


def compute_clock_errors(done: Run, middle: float) -> list[tuple[float, float, bool]]:
    """Return for every clock its error in mid-trial and its standard deviation, s, and whether it is observable."""
    found = []
    for name, each in done.summary["imus"].items():
        if each["used"] and each["clock_offset_s"] is not None:
            right = done.truth["imu"][name]
            off = each["clock_offset_s"] - right["offset_s"] + 1e-6 * (each["ppm"] - right["ppm"]) * middle
            found.append((float(off), each["sd_s"], each["observable"]))
    return found


def run_cameras(place: Path, seed: int, *, board: bool) -> Comparison:
    """Simulate the second trial of a person with markers and a plate or a balance board, and run it."""
    options = replace(draw_options(seed)[1], imus=False, board=board)
    configuration = simulate("sit-to-stand", place / ("board" if board else "plate"), options)
    done = run_trial(configuration)
    (states,) = done.read("states.parquet")
    away, sd = _compute_errors(configuration, states, states["time"]), harness.stack_states(states, "sd_")
    away[..., 0] -= np.nanmean(away[..., 0], axis=0)
    errors, inside = _summarise_states(away, sd)
    errors["repetitions"] = _count_right(done)
    if done.summary["dynamics"]["base"] and done.summary["dynamics"]["base"][0]["value"] is not None:
        more, intervals = _summarise_dynamics(done)
        errors, inside = errors | more, inside | intervals
    return Comparison(done.codes, errors, inside)


def _count_right(done: Run) -> float:
    return float(sum(each["stand_s"] is not None for each in done.summary["repetitions"]) == 3)


def interpolate_truth(configuration: Path, time: FloatArray, names: Sequence[str]) -> dict[str, FloatArray]:
    """Return arrays of ``truth.npz`` at any times, s."""
    with np.load(configuration.with_name("truth.npz")) as arrays:
        return {name: np.asarray(CubicSpline(arrays["t"], arrays[name])(time)) for name in names}


def _compute_errors(configuration: Path, states: Any, time: FloatArray) -> FloatArray:
    """Return the errors (F, n, 3) of the states."""
    true = interpolate_truth(configuration, time, ["q", "qd", "qdd"])
    return harness.stack_states(states) - np.stack(list(true.values()), axis=2)


def _summarise_states(away: FloatArray, sd: FloatArray) -> tuple[dict[str, float], dict[str, float]]:
    away, sd = away[_ENDS:-_ENDS], sd[_ENDS:-_ENDS]
    size = harness.rms(away.reshape(-1, 3))
    errors = {
        "joint angles, degrees": float(np.degrees(size[0])),
        "joint velocities, rad/s": float(size[1]),
        "joint accelerations, rad/s²": float(size[2]),
    }
    within = np.mean(np.abs(away) < QUANTILE * sd, axis=(0, 1))
    return errors, {name: float(each) for name, each in zip(("angle", "velocity", "acceleration"), within, strict=True)}


def _summarise_dynamics(done: Run) -> tuple[dict[str, float], dict[str, float]]:
    (dynamics,) = done.read("dynamics.parquet")
    fit = dynamics["in_fit"]
    true = interpolate_truth(done.configuration, dynamics["time"], ["wrench", "cop_x", "tau"])
    value, right = done.base("value"), done.true_base
    first = [abs(np.hypot(*value[[k, k + 1]]) / np.hypot(*right[[k, k + 1]]) - 1) for k in (2, 5, 8)]
    torque = dynamics.stack([f"tau_{j}" for j in (1, 2, 3)]) - true["tau"]
    sd = dynamics.stack([f"sd_tau_{j}" for j in (1, 2, 3)])
    cop = dynamics["cop_x_model"] - true["cop_x"]
    errors = {
        "centre of pressure, mm": 1e3 * float(harness.rms(cop[fit])),
        "vertical force, N": float(harness.rms((dynamics["Fy_model"] - true["wrench"][:, 1])[fit])),
        "horizontal force, N": float(harness.rms((dynamics["Fx_model"] - true["wrench"][:, 0])[fit])),
        "torque of ankle, N·m": float(harness.rms(torque[fit, 0])),
        "torques of knee and hip, N·m": float(harness.rms(torque[fit, 1:].ravel())),
        "mass, %": 100 * abs(value[0] / right[0] - 1),
        "first moments, %": 100 * float(np.mean(first)),
        "moments of inertia, %": 100 * float(np.mean(np.abs(value[[4, 7, 10]] / right[[4, 7, 10]] - 1))),
    }
    inside = {
        "centre of pressure": np.nanmean(np.abs(cop[fit]) < QUANTILE * dynamics["sd_cop_x_model"][fit]),
        "torques": np.nanmean(np.abs(torque[fit]) < QUANTILE * sd[fit]),
    }
    return errors, {name: float(each) for name, each in inside.items()}


def measure(seed: int) -> dict[str, Comparison]:
    """Simulate and run the same trial of a person in three conditions, the most complete one first."""
    with harness.temporary_folder() as place:
        return {
            "cameras and force plate": run_cameras(place, seed, board=False),
            "cameras and balance board": run_cameras(place, seed, board=True),
            "inertial sensors alone": _run_alone(place, seed),
        }


def make_table(seeds: Sequence[int], jobs: int | None) -> str:
    """Return the median errors in each condition, and the shares of samples inside 95 % intervals."""
    rows = harness.run_all(measure, seeds, jobs)
    names, lines = list(rows[0]), []
    for quantity in dict.fromkeys(quantity for row in rows for quantity in row[names[0]].errors):
        cells = []
        for name in names:
            values = [row[name].errors[quantity] for row in rows if quantity in row[name].errors]
            if quantity == "repetitions":
                cells.append(f"{100 * np.mean(values):.0f} % right")
            else:
                cells.append(f"{np.median(values):.2g}" if values else "not known")
        lines.append([quantity, *cells])
    for quantity in dict.fromkeys(quantity for row in rows for quantity in row[names[0]].inside):
        every = [[row[name].inside.get(quantity, np.nan) for row in rows] for name in names]
        cells = [f"{np.nanmean(each):.2f}" if np.isfinite(each).any() else "–" for each in every]
        lines.append([f"inside 95 %: {quantity}", *cells])
    return harness.format_table(["median error", *names], lines, numbers_from=1)
