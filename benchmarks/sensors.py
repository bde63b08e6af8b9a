"""Sensors in addition to the cameras, on simulated trials: boards, sensors at the hand, inertial sensors.

Rows and limits are in docs/measured/sensors.md. It takes about five seconds per trial and core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
import sensor_handle
from harness import QUANTILE, Comparison, Run, run_trial
from scipy.interpolate import CubicSpline
from space import TO_TRIAL, compute_rms_length, stack_columns

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.geometry import so3
from mocap_id_simulation import simulate
from mocap_id_simulation.arm import generate_arm
from mocap_id_simulation.arm_files import write_arm
from mocap_id_simulation.options import ArmOptions, Options, Preset, draw_subject
from mocap_id_simulation.scene import generate
from mocap_id_simulation.trial_files import c3d_bytes, points_bytes

STRATEGIES = ("normal", "dynamic", "stable")
PERSON = Options(repetitions=3, analog_rate=100)
INERTIA = [4, 7, 10]
"""Moments of inertia among the base parameters."""
_ENDS = 20  # frames at either end without figures


def draw_person(seed: int) -> tuple[Options, Options]:
    """Return the calibration trial and the second trial of a person, both with inertial sensors."""
    first = replace(PERSON, seed=2 * seed, imus=True, subject=draw_subject(seed, 1))
    second = replace(first, seed=2 * seed + 1, strategy=STRATEGIES[(1 + seed // 3) % 3])
    return replace(first, strategy=STRATEGIES[seed % 3]), second


def run_alone(seed: int) -> Comparison:
    """Simulate both trials of a person, and run the second one with its inertial sensors alone."""
    with harness.temporary_folder() as place:
        first, second = draw_person(seed)
        calibration = simulate("sit-to-stand", place / "calibration", first)
        configuration = simulate("sit-to-stand", place / "trial", second)
        lines = configuration.read_text("utf-8").splitlines()
        kept = [line for line in lines if not line.startswith("recording:")]
        alone = configuration.with_name("alone.yaml")
        alone.write_text("\n".join([*kept, f"calibration: {calibration}", "out: runs/alone", ""]), "utf-8")
        done = run_trial(alone)
        (shown,) = Run(calibration, load(calibration)).read("states.parquet")
        constant = np.nanmean(_compute_errors(calibration, shown, shown["time"])[..., 0], axis=0)
        (states,) = done.read("states.parquet")
        clock = done.truth["imu"]
        time = clock["shank"]["offset_s"] + states["time"] * (1 + 1e-6 * clock["shank"]["ppm"])
        away, sd = _compute_errors(alone, states, time), harness.stack_states(states, "sd_")
        away[..., 0] -= constant
        errors, inside = _summarise_states(away, sd)
        sensors = done.summary["imus"]
        others = {name: each for name, each in sensors.items() if name != "shank"}
        between = {name: each["offset_s"] - clock["shank"]["offset_s"] for name, each in clock.items()}
        off = {name: each["clock_offset_s"] - between[name] for name, each in others.items()}
        errors["largest error of an angle, degrees"] = float(np.degrees(np.abs(away[_ENDS:-_ENDS, :, 0]).max()))
        errors["clock between sensors, ms"] = 1e3 * max(abs(each) for each in off.values())
        errors["repetitions"] = _count_right(done)
        inside["clock"] = float(np.mean([abs(off[n]) < QUANTILE * each["sd_s"] for n, each in others.items()]))
        # the true rotation of each sensor about the vertical is zero
        turned = [abs(each["heading_deg"]) < QUANTILE * each["heading_sd_deg"] for each in sensors.values()]
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


def run_cameras(seed: int, *, board: bool) -> Comparison:
    """Simulate the second trial of a person with markers and a plate or a balance board, and run it."""
    with harness.temporary_folder() as place:
        configuration = simulate(
            "sit-to-stand", place / "trial", replace(draw_person(seed)[1], imus=False, board=board)
        )
        done = run_trial(configuration)
        (states,) = done.read("states.parquet")
        away, sd = _compute_errors(configuration, states, states["time"]), harness.stack_states(states, "sd_")
        away[..., 0] -= np.nanmean(away[..., 0], axis=0)
        errors, inside = _summarise_states(away, sd)
        errors["repetitions"] = _count_right(done)
        if done.identified:
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
        "moments of inertia, %": 100 * float(np.mean(np.abs(value[INERTIA] / right[INERTIA] - 1))),
    }
    inside = {
        "centre of pressure": np.nanmean(np.abs(cop[fit]) < QUANTILE * dynamics["sd_cop_x_model"][fit]),
        "torques": np.nanmean(np.abs(torque[fit]) < QUANTILE * sd[fit]),
    }
    return errors, {name: float(each) for name, each in inside.items()}


def measure_conditions(seed: int) -> dict[str, Comparison]:
    """Simulate and run the same trial of a person in three conditions, the most complete one first."""
    return {
        "cameras and force plate": run_cameras(seed, board=False),
        "cameras and balance board": run_cameras(seed, board=True),
        "inertial sensors alone": run_alone(seed),
    }


def make_condition_table(seeds: Sequence[int], jobs: int | None) -> str:
    """Return the median errors in each condition, and the shares of samples inside 95 % intervals."""
    rows = harness.run_all(measure_conditions, seeds, jobs)
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


ACCELERATION: Mapping[Preset, float] = {"default": 0.26, "hard": 0.30}
"""Largest angular acceleration error of the forearm with sensors, rad/s²."""
_ON = ("thorax", "upper_arm", "forearm")


class _Errors(NamedTuple):
    """Errors of a run, of thorax, upper arm and forearm in the axes of the trial."""

    done: Run
    turn: FloatArray  # (F, 3, 3) of the rotation, rad, without its constant
    rate: FloatArray  # (F, 3, 3) of the angular velocity, rad/s
    gain: FloatArray  # (F, 3, 3) of the angular acceleration, rad/s²
    sd: FloatArray  # (3, F, 3) standard deviations of these per axis


def list_arm_limits(preset: Preset) -> dict[str, float]:
    """Return the limits of the errors of :func:`measure_arm`."""
    accelerations = (
        "acceleration of the forearm, rad/s²",
        "from markers alone, rad/s²",
        "acceleration of the upper arm, rad/s²",
        "of the upper arm from markers alone, rad/s²",
    )
    rotations = [
        f"{name} in {gap}, degrees"
        for gap in ("2 s without markers", "the same 2 s with markers")
        for name in ("upper arm", "forearm")
    ]
    clock = {"clock where the motion shows it, ms": 2.0}
    return dict.fromkeys(accelerations, ACCELERATION[preset]) | clock | dict.fromkeys(rotations, 3.0)


def measure_arm(seed: int, preset: Preset) -> Comparison:
    """Simulate an arm and run it with inertial sensors, without them, and with a gap of all markers."""
    options = ArmOptions(seed=seed, preset=preset, cycles=1, imus=True)
    with harness.temporary_folder() as place:
        configuration = write_arm(place / "trial", options)
        text = configuration.read_text("utf-8")
        configuration.write_text(text.split("imus:")[0], "utf-8")
        alone = _run_arm(configuration)
        if alone is None:
            return Comparison(("no arm found",))
        configuration.write_text(text, "utf-8")
        try:
            both = _run_arm(configuration)
        except ConfigError:
            return Comparison(("segment of a sensor not found",))
        assert both is not None  # the markers are the same
        # all markers are hidden for 2 s, beginning in a movement
        trial = generate_arm(options)
        hidden = harness.choose_gap(np.linalg.norm(trial.omega[:, 2], axis=1), trial.rate, options.seed, (2.0, 4.0))
        points = trial.positions.copy()
        points[hidden] = np.nan
        configuration.with_name("trial.c3d").write_bytes(points_bytes(trial.labels, points, trial.rate))
        gap = _run_arm(configuration)
        truth = both.done.truth

    def find_largest(of: _Errors | None, k: int) -> float:
        """Return the largest error of a rotation in the gap, degrees; infinity if a rotation is missing."""
        if of is None:
            return float("inf")
        size = np.degrees(np.linalg.norm(of.turn[hidden, k], axis=1))
        return float(np.where(np.isfinite(size), size, np.inf).max())

    def share(error: FloatArray, sd: FloatArray) -> float:
        return harness.compute_share_inside(error, np.repeat(sd[:, None], 3, axis=1))

    sizes = [compute_rms_length(each.gain[:, k]) for k in (2, 1) for each in (both, alone)]
    clocks = compute_clock_errors(both.done, truth["n_frames"] / truth["point_rate_hz"] / 2)
    clock = 1e3 * max((abs(off) for off, _, observable in clocks if observable), default=0.0)
    rotations = [find_largest(each, k) for each in (gap, both) for k in (1, 2)]
    inside = {"clock": float(np.mean([abs(off) < QUANTILE * sd for off, sd, _ in clocks]))}
    for k, name in ((1, "upper arm"), (2, "forearm")):
        inside[f"velocity of the {name}"] = share(both.rate[:, k], both.sd[1, :, k])
        inside[f"acceleration of the {name}"] = share(both.gain[:, k], both.sd[2, :, k])
        if gap is not None:
            inside[f"rotation of the {name} without markers"] = share(gap.turn[hidden, k], gap.sd[0, hidden, k])
    errors = dict(zip(list_arm_limits(preset), [*sizes, clock, *rotations], strict=True))
    return Comparison(both.done.codes, errors, inside)


def _run_arm(configuration: Path) -> _Errors | None:
    """Run a trial and compare it with its truth; return None if it is refused or has no arm."""
    done = run_trial(configuration)
    if done.summary["verdict"]["level"] == "refused":
        return None
    (poses,) = done.read("poses.parquet")
    if f"{_ON[-1]}_qw" not in poses.names:
        return None
    keys = ("seg_R", "omega", "alpha")
    true = dict(zip(keys, done.true(poses["time"], *keys), strict=True))
    turns = []
    for k, name in enumerate(_ON):  # errors of the rotation without their constant, a convention of the axes
        rotation = TO_TRIAL @ true["seg_R"][:, k]
        scalar, cross = poses[f"{name}_qw"], so3.hat(stack_columns(poses, name, ["qx", "qy", "qz"]))
        found = np.eye(3) + 2 * scalar[:, None, None] * cross + 2 * cross @ cross
        known = np.isfinite(scalar)
        u, _, v = np.linalg.svd(np.mean(np.swapaxes(rotation[known], 1, 2) @ found[known], axis=0))
        turns.append(np.full((len(found), 3), np.nan))
        turns[-1][known] = so3.log(found[known] @ np.swapaxes(rotation[known] @ (u @ v), 1, 2))
    rate, gain = (
        np.stack([stack_columns(poses, name, [f"{key}_{axis}" for axis in "xyz"]) for name in _ON], axis=1)
        - true[key][:, : len(_ON)] @ TO_TRIAL.T
        for key in ("omega", "alpha")
    )
    sd = np.stack([poses.stack([f"sd_{name}_{key}" for name in _ON]) for key in ("rotation", "omega", "alpha")])
    return _Errors(done, np.stack(turns, axis=1), rate, gain, sd)


@dataclass(frozen=True)
class Row:
    name: str
    measure: Callable[..., Comparison]
    limits: Mapping[str, float]
    arguments: tuple[Any, ...] = ()


def measure_board(seed: int, given: bool) -> Comparison:
    """Simulate and run a trial on a balance board, whose position is given or not, and compare it with its truth."""
    offset = float(np.random.default_rng(seed).uniform(-0.1, 0.1))
    options = replace(PERSON, seed=seed, board=True, strategy=STRATEGIES[seed % 3], clock_offset=offset)
    with harness.temporary_folder() as place:
        configuration = simulate("sit-to-stand", place / "trial", options)
        if given:
            truth = harness.read_truth(configuration)
            board, yaw = truth["board"], np.radians(truth["plane"]["yaw_deg"])
            forwards = -np.array([np.cos(yaw), np.sin(yaw)])
            centre = board["centre"][0] * forwards + board["centre"][1] * np.array([-forwards[1], forwards[0]])
            centre += np.array(truth["plate"]["centre_lab_mm"][:2]) / 1000
            height = truth["plate"]["centre_lab_mm"][2] / 1000
            more = f"board.csv, top: {board['top']}, centre_m: [{centre[0]:.4f}, {centre[1]:.4f}, {height:.4f}]"
            configuration.write_text(configuration.read_text("utf-8").replace("board.csv", more), "utf-8")
        done = run_trial(configuration)
        if not done.identified:
            return Comparison(done.codes)
        (dynamics,) = done.read("dynamics.parquet")
        fit = dynamics["in_fit"]
        error = (dynamics["cop_x_model"] - done.true(dynamics["time"], "cop_x")[0])[fit]
        sd = dynamics["sd_cop_x_model"][fit]
        clock = (done.summary["dynamics"]["clock_offset_s"] or np.nan) - done.truth["board"]["clock_offset"]
    values, deviations, right = done.base("value"), done.base("sd"), done.true_base
    sizes = [
        (np.hypot(*values[[k, k + 1]]), np.hypot(*right[[k, k + 1]]), deviations[k + 1]) for k in (2, 5, 8)
    ]  # of the first moments
    scores = [abs(got - real) / spread for got, real, spread in sizes]
    scores += [abs(values[k] - right[k]) / deviations[k] for k in (0, *INERTIA)]
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
    options = replace(PERSON, seed=seed, strategy=STRATEGIES[seed % 3], imus=True)
    with harness.temporary_folder() as place:
        configuration = simulate("sit-to-stand", place / "trial", options)

        def run_states() -> tuple[Run, FloatArray, FloatArray, FloatArray]:
            """Run the trial; return it, errors and standard deviations (F, n, 3) of its states, and the times (F,)."""
            done = run_trial(configuration)
            done.summary  # noqa: B018 - a later run of the same configuration overwrites the file
            (states,) = done.read("states.parquet")
            return done, done.state_errors(states), harness.stack_states(states, "sd_"), states["time"]

        text = configuration.read_text("utf-8")
        done, error, sd, time = run_states()
        configuration.write_text(text.split("imus:")[0], "utf-8")
        without, alone, _, _ = run_states()
        configuration.write_text(text, "utf-8")
        # all markers are hidden for 2 s, beginning in a movement
        trial = generate("sit-to-stand", options)
        hidden = harness.choose_gap(np.abs(trial.state.qd).sum(axis=1), options.rate, options.seed, (3.0, 5.0))
        points = trial.points.copy()
        points[hidden] = np.nan
        configuration.with_name("trial.c3d").write_bytes(c3d_bytes(options, replace(trial, points=points)))
        _, gap, gap_sd, _ = run_states()
        right = done.true_base
    gap[..., 0] -= np.nanmean(np.delete(gap[..., 0], np.r_[hidden], axis=0), axis=0)
    clocks = compute_clock_errors(done, time.mean())
    shown = [abs(off) for off, _, observable in clocks if observable]
    inertia = [np.mean(np.abs(each.base("value")[INERTIA] / right[INERTIA] - 1)) for each in (done, without)]
    ratios = [float(np.mean(harness.rms(error[..., k]) / harness.rms(alone[..., k]))) for k in (2, 1)]
    within, angle = np.abs(error) < QUANTILE * sd, np.abs(gap[hidden][..., 0])
    errors = {
        "acceleration, share of that of markers alone": ratios[0],
        "velocity, share of that of markers alone": ratios[1],
        "clock where the motion shows it, ms": 1e3 * max(shown, default=0.0),
        "sensors whose clock is not shown": float(len(clocks) - len(shown)),
        "I2–I4, %": 100 * float(inertia[0]),
        "I2–I4 from markers alone, %": 100 * float(inertia[1]),
        "angle in 2 s without markers, degrees": float(np.degrees(angle.max())),
    }
    inside = {
        "velocity": float(within[..., 1].mean()),
        "acceleration": float(within[..., 2].mean()),
        "angle without markers": float(np.mean(angle < QUANTILE * gap_sd[hidden][..., 0])),
        "clock": float(np.mean([abs(off) < QUANTILE * each for off, each, _ in clocks])),
    }
    return Comparison(done.codes, errors, inside)


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
_SENSED = "sit-to-stand, sensors on shank, thigh and trunk"
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
    "inertial": [Row(_SENSED, measure_inertial, _INERTIAL)],
    "arms": [
        Row(
            f"reaches, {preset} errors, a sensor on every segment",
            measure_arm,
            list_arm_limits(preset),
            (preset,),
        )
        for preset in ACCELERATION
    ],
    "alone": [Row(f"{_SENSED}, no markers", run_alone, _ALONE)],
}


def measure_task(task: tuple[Row, int]) -> Comparison:
    row, seed = task
    return row.measure(seed, *row.arguments)


def make_table(row: Row, seeds: Sequence[int], jobs: int | None) -> str:
    every = harness.run_all(measure_task, [(row, seed) for seed in seeds], jobs)
    done = [each for each in every if each.errors]
    codes = harness.count_codes(code for each in every for code in each.codes)
    about = f"**{row.name}**, {len(every)} trials, identified {len(done)}. Cautions: {codes}."
    text = f"{about}\n\n{harness.make_limit_table(row.limits, done)}"
    harness.report_progress(text)
    return text


OTHERS: Mapping[str, Callable[[Sequence[int], int | None], str]] = {
    "handles": sensor_handle.make_table,
    "conditions": make_condition_table,
}


def make_first(first: int) -> str:
    """Return the table of one trial on a board, as a test measures it again."""
    row = TABLES["boards"][0]
    found = measure_task((row, first))
    table = harness.make_limit_table(row.limits, [found])
    return f"One trial, {row.name}, seed {first}; cautions: {harness.count_codes(found.codes)}.\n\n{table}"


def main() -> None:
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
