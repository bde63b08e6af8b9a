"""Accuracy and time of every method for the joint states and of filterpy.

It takes about twenty seconds per trial, mostly for filterpy. Without MOCAP_ID_RECORDINGS a simulated trial replaces the
reference recording of the first table. benchmarks/filter.py compares the time of the filters alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import ezc3d
import numpy as np
from filter import make_problem, run_filterpy
from harness import (
    JOINTS,
    SHORT,
    describe_source,
    find_recordings,
    format_table,
    make_parser,
    publish,
    report_progress,
    rms,
)
from scipy.optimize import minimize_scalar

from mocap_id.arrays import FloatArray
from mocap_id.estimation import FilterSettings, filter_problem, smooth
from mocap_id.estimation.filter_problem import FilterProblem, MarkerChain
from mocap_id.estimation.noise import estimate_marker_noise, find_frame_angles
from mocap_id.kinematics.bundle import fit_chain, frames_along_motion
from mocap_id.kinematics.chain_fit import orient_frames
from mocap_id_simulation import Options, generate

FITTED = 400  # frames, as in fit-joints
OURS, FILTERPY = "ours: filter and smoother", "filterpy's UKF + RTS, tuned on the truth"
METHODS: Mapping[str, FilterSettings] = {
    OURS: FilterSettings(),
    "two-filter": FilterSettings(method="two-filter"),
    "Butterworth 6 Hz": FilterSettings(method="butterworth", butterworth_hz=6.0),
    "Butterworth 10 Hz": FilterSettings(method="butterworth", butterworth_hz=10.0),
    "spline": FilterSettings(method="spline"),
}
LIMITS = (0.5, 0.012, 0.08, 0.995)
QUANTITIES = ("angle, °", "velocity, rad/s", "acceleration, rad/s²", "r² of acceleration")


@dataclass(frozen=True)
class Moving:
    """Markers (F, M, 2) in the true plane, m, their chain, and the true states (F, n, 4)."""

    points: FloatArray
    rate: float
    chain: MarkerChain
    truth: FloatArray


@dataclass(frozen=True)
class Scored:
    error: FloatArray  # (n, 4) angle, °, velocity, acceleration, and r² of the acceleration
    time: float  # µs per sample

    @property
    def worst(self) -> FloatArray:
        """(4,) errors of the worst joint."""
        return np.append(self.error[:, :3].max(axis=0), self.error[:, 3].min())


def read_recording(folder: Path) -> Moving:
    """Read the simulated reference recording with its true plane and chain."""
    truth = json.loads((folder / "truth.json").read_text())
    file = ezc3d.c3d(str(folder / "trial.c3d"))
    labels = [label.split(":")[-1] for label in file["parameters"]["POINT"]["LABELS"]["value"]]
    markers, plane = truth["markers"], truth["plane"]
    points = file["data"]["points"][:3, [labels.index(marker["label"]) for marker in markers]]
    lab = 1e-3 * (np.moveaxis(points, 0, -1).swapaxes(0, 1) - plane["origin_lab_mm"])
    with np.load(folder / "truth.npz") as arrays:
        states = np.stack([arrays[name] for name in ("q", "qd", "qdd", "qddd")], axis=-1).astype(np.float64)
    return Moving(
        np.stack([lab @ plane["x_axis_lab"], lab @ plane["y_axis_lab"]], axis=-1),
        truth["point_rate_hz"],
        MarkerChain(
            np.array([segment["p_in_parent_m"] for segment in truth["segments"][1:]]),
            np.array([marker["segment"] for marker in markers]),
            np.array([marker["local_xyz_m"][:2] for marker in markers]),
        ),
        states,
    )


def simulate_trial(options: Options) -> Moving:
    made = generate("sit-to-stand", options)
    markers, state = made.scene.markers, made.state
    centres = np.array([link.centre for link in made.scene.body.links[1:]])
    return Moving(
        made.scene.plane.to_plane(made.points)[..., :2],
        options.rate,
        MarkerChain(centres, markers.link, markers.local[:, :2]),
        np.stack([state.q, state.qd, state.qdd, state.qddd], axis=-1),
    )


def refit_chain(moving: Moving) -> Moving:
    """Replace the true chain by the chain that ``fit-joints`` finds."""
    flat = moving.points[..., 0] + 1j * moving.points[..., 1]
    fit = orient_frames(fit_chain(flat[frames_along_motion(flat, FITTED)], moving.chain.segment))

    def pair(values: FloatArray) -> FloatArray:
        return np.stack([values.real, values.imag], axis=1)

    return replace(moving, chain=MarkerChain(pair(fit.centres), moving.chain.segment, pair(fit.local)))


def compute_errors(moving: Moving, states: FloatArray, seconds: float) -> Scored:
    """Return the errors of states (F, n, 4)."""
    error = states - moving.truth
    error[..., 0] -= np.nanmean(error[..., 0], axis=0)
    size = rms(error)
    r2 = 1.0 - np.nanmean(error[..., 2] ** 2, axis=0) / moving.truth[..., 2].var(axis=0)
    figures = np.column_stack([np.degrees(size[:, 0]), size[:, 1], size[:, 2], r2])
    return Scored(figures, 1e6 * seconds / len(states))


def measure_method(moving: Moving, settings: FilterSettings) -> Scored:
    start = perf_counter()
    states = smooth(moving.points, moving.rate, moving.chain, settings=settings)
    return compute_errors(moving, states.mean, perf_counter() - start)


def measure_filterpy(moving: Moving) -> Scored:
    """Return the errors of filterpy's filter and smoother, with the process noise that fits the truth best.

    The search for this noise uses the compiled engine, which is the same filter.
    """
    moves, segment = moving.chain.segment > 0, moving.chain.segment
    chain = MarkerChain(moving.chain.centres, segment[moves], moving.chain.local[moves])
    points = np.ascontiguousarray(moving.points[:, moves])
    # its anchors, at 5 standard deviations, differ from those of filter.problem
    frames = find_frame_angles(points, chain, 5.0, 5e-5)
    marker_sd = estimate_marker_noise(frames, 5e-5)
    plain = make_problem(chain, points, moving.rate, marker_sd, gate=1e3)  # filterpy has no gate
    plain = replace(plain, anchors=frames.anchors(marker_sd))

    def tuned(log_sigma: float) -> FilterProblem:
        return replace(plain, density=np.full(len(chain.centres), np.exp(2.0 * log_sigma) / moving.rate))

    def miss(log_sigma: float) -> float:
        given = tuned(log_sigma)
        mean, _ = filter_problem.smooth_backwards(given, filter_problem.filter_forwards(given)).by_joint()
        return float(np.mean((mean[..., 2] - moving.truth[..., 2]) ** 2))

    best = minimize_scalar(miss, bounds=(np.log(10.0), np.log(1e5)), method="bounded", options={"xatol": 0.02})
    seconds, track = run_filterpy(tuned(float(best.x)))
    return compute_errors(moving, track.by_joint()[0], seconds)


def measure_methods(moving: Moving, *, filterpy: bool) -> dict[str, Scored]:
    found = {name: measure_method(moving, settings) for name, settings in METHODS.items()}
    return {**found, FILTERPY: measure_filterpy(moving)} if filterpy else found


def make_limit_table(found: Mapping[str, Sequence[Mapping[str, Scored]]]) -> str:
    """Return the share of trials in which the worst joint of our method is within each limit."""
    rows = []
    for k, (quantity, limit) in enumerate(zip(QUANTITIES, LIMITS, strict=True)):
        rows.append([quantity, f"{'≥' if k == 3 else '≤'} {limit:g}"])
        for trials in found.values():
            each = np.array([trial[OURS].worst[k] for trial in trials])
            kept, extreme = (each >= limit, each.min()) if k == 3 else (each <= limit, each.max())
            rows[-1].append(f"{100 * kept.mean():.0f} % (worst {format_figure(extreme, k)})")
    return format_table(["worst joint", "required", *(f"{chain} chain" for chain in found)], rows)


def format_figure(value: float, quantity: int) -> str:
    return f"{value:.{(3, 4, 4, 5)[quantity]}f}"


def make_quantile_table(found: Sequence[Mapping[str, Scored]]) -> str:
    """Return a row for each method: median and worst decile."""
    rows = []
    for name in found[0]:
        each = np.array([trial[name].worst for trial in found])
        cells = []
        for k, decile in enumerate((0.9, 0.9, 0.9, 0.1)):
            middle, outer = np.quantile(each[:, k], (0.5, decile))
            cells.append(f"{format_figure(middle, k)} / {format_figure(outer, k)}")
        rows.append([name, *cells, f"{np.median([trial[name].time for trial in found]):.0f}"])
    return format_table(["method", *QUANTITIES, "µs per sample"], rows)


def make_joint_table(found: Mapping[str, Sequence[Mapping[str, Scored]]]) -> str:
    rows = []
    for chain, trials in found.items():
        for name in trials[0]:
            middle = np.median([trial[name].error for trial in trials], axis=0)  # (n, 4)
            cells = [" / ".join(format_figure(value, k) for value in middle[:, k]) for k in range(4)]
            rows.append([chain, name, *cells])
    return format_table(["chain", f"{' / '.join(JOINTS)}", *QUANTITIES], rows)


def main() -> None:
    given = make_parser(__doc__, trials=30, first=910_000).parse_args()
    trials, first, folder = given.trials, given.first, find_recordings()
    if folder:
        what, one = "the reference recording simulated/sts-normal", read_recording(folder / "simulated" / "sts-normal")
    else:
        what, one = f"the simulated trial of seed {first - 1}", simulate_trial(replace(SHORT, seed=first - 1))
    for settings in METHODS.values():  # compiles, and fills the caches
        measure_method(one, settings)
    alone = []
    for name, scored in measure_methods(one, filterpy=True).items():
        cells = [format_figure(value, k) for k, value in enumerate(scored.worst)]
        alone.append([name, *cells, format_figure(rms(scored.error[:, 2]), 2), f"{scored.time:.0f}"])
    found: dict[str, list[dict[str, Scored]]] = {"true": [], "fitted": []}
    for seed in range(first, first + trials):
        moving = simulate_trial(replace(SHORT, seed=seed))
        found["true"].append(measure_methods(moving, filterpy=True))
        found["fitted"].append(measure_methods(refit_chain(moving), filterpy=False))
        report_progress(seed)
    duels = []  # how often, and by how much, our errors are smaller than those of each other method
    for name in [name for name in found["true"][0] if name != OURS]:
        ratio = np.array([trial[OURS].error[:, :3] / trial[name].error[:, :3] for trial in found["true"]])
        share, middle = np.mean(ratio <= 1.0, axis=(0, 1)), np.median(ratio, axis=(0, 1))
        duels.append([name, *(f"{100 * s:.0f} % ({m:.2f})" for s, m in zip(share, middle, strict=True))])
    sections = {
        "states": describe_source(__file__, f"{what} and on {trials} ordinary trials at 100 Hz, seeds from {first}"),
        "states-one": format_table(["method", *QUANTITIES, "acceleration, all", "µs per sample"], alone),
        "states-true": make_quantile_table(found["true"]),
        "states-fitted": make_quantile_table(found["fitted"]),
        "states-joints": make_joint_table(found),
        "states-limits": make_limit_table(found),
        "states-duels": format_table(["other", *(name.split(",")[0] for name in QUANTITIES[:3])], duels),
    }
    publish(sections, write=given.write)


if __name__ == "__main__":
    main()
