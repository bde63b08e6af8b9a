"""Time of the state filter and smoother and of filterpy's, in the same run; their results must agree.

The chain has three joints and nine markers (12 states, 18 observations). ``filter.py --frames N`` prints JSON instead:
the seconds of both on N frames of 39 markers, for benchmarks/scale.py.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
from harness import format_table, make_parser, publish

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation import filter_problem, filterpy_engine, smooth
from mocap_id.estimation.filter_problem import FilterProblem, MarkerChain, Track
from mocap_id.estimation.noise import find_frame_angles
from mocap_id.geometry.planar import marker_positions

RATE, NOISE = 480.0, 1e-3
PER_SEGMENT = 13

COLD = """
from time import perf_counter
import sys
sys.path.insert(0, {folder!r})
from filter import make_recording
from mocap_id.estimation import smooth
chain, markers = make_recording(100, 3)
start = perf_counter()
smooth(markers, 480.0, chain)
print(perf_counter() - start)
"""


def make_recording(frames: int, per_segment: int) -> tuple[MarkerChain, FloatArray]:
    """Return a chain whose three joints swing at 0.4 to 0.8 Hz, and markers (F, M, 2) with 1 mm of noise."""
    rng = np.random.default_rng(0)
    time = np.arange(frames)[:, None] / RATE
    angles = np.array([0.2, 0.8, 0.9]) * np.sin(2 * np.pi * np.array([0.4, 0.6, 0.8]) * time + [0.0, 1.0, 2.0])
    centres = np.array([[0.0, 0.07], [0.0, 0.44], [0.0, 0.43]])
    segment: IntArray = np.repeat(np.arange(1, 4), per_segment)
    local = rng.uniform([-0.08, 0.05], [0.08, 0.4], (len(segment), 2))
    markers = marker_positions(angles, centres, segment, local)
    return MarkerChain(centres, segment, local), markers + NOISE * rng.standard_normal(markers.shape)


def make_problem(
    chain: MarkerChain, markers: FloatArray, rate: float = RATE, sd: float = NOISE, gate: float = 8.0
) -> FilterProblem:
    variance = np.full(len(chain.segment), sd**2)
    return FilterProblem(
        observed=markers,
        dt=1.0 / rate,
        chain=chain,
        variance=variance,
        gate_variance=variance,
        gate=gate,
        density=np.full(len(chain.centres), 1e3**2 / rate),
        anchors=find_frame_angles(markers, chain, 8.0, 5e-5).anchors(sd),
    )


def run_filterpy(given: FilterProblem) -> tuple[float, Track]:
    """Return time and result of filterpy's predict, update and rts_smoother, with our initial state and no gate."""
    first = filter_problem.filter_forwards(given)
    ukf = filterpy_engine._make_filter(given)
    ukf.x, ukf.P = first.mean[0].copy(), first.covariance[0].copy()
    mean, covariance = [ukf.x.copy()], [ukf.P.copy()]
    start = perf_counter()
    for z in given.observed[1:]:
        ukf.predict()
        seen = np.isfinite(z).all(axis=1)
        if seen.any():  # filterpy does not handle missing rows
            ukf.update(z[seen].ravel(), R=np.diag(np.repeat(given.variance[seen], 2)), markers=seen)
        mean.append(ukf.x.copy())
        covariance.append(ukf.P.copy())
    x, p, _ = ukf.rts_smoother(np.array(mean), np.array(covariance))
    seconds = perf_counter() - start
    return seconds, Track(x, p, first.used, first.restarted, 0.0)


def run_compiled(given: FilterProblem) -> tuple[float, Track]:
    start = perf_counter()
    track = filter_problem.smooth_backwards(given, filter_problem.filter_forwards(given))
    return perf_counter() - start, track


def time_whole(frames: int) -> float:
    """Return the seconds from markers to states, including the noise estimate."""
    chain, markers = make_recording(frames, PER_SEGMENT)
    start = perf_counter()
    smooth(markers, RATE, chain)
    return perf_counter() - start


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--frames", type=int, help="print the times for so many frames of 39 markers as JSON")
    given = parser.parse_args()
    short, long = make_problem(*make_recording(600, 3)), make_problem(*make_recording(12_000, 3))
    run_compiled(short)  # compiles
    if given.frames:
        large = make_problem(*make_recording(given.frames, PER_SEGMENT))
        time_whole(500)
        own = min(run_compiled(large)[0] for _ in range(3))
        times = {
            "frames": given.frames,
            "filterpy": run_filterpy(large)[0],
            "ours": own,
            "noise too": time_whole(given.frames),
        }
        print(json.dumps(times))
        return
    own = min(run_compiled(long)[0] for _ in range(5)) / 12_000
    seconds, reference_track = run_filterpy(short)
    other = min(seconds, run_filterpy(short)[0]) / 600
    scale = np.abs(reference_track.mean).max(axis=0)
    difference = np.max(np.abs(run_compiled(short)[1].mean - reference_track.mean) / scale)
    time_whole(2_000)
    with tempfile.TemporaryDirectory() as folder:
        code = COLD.format(folder=str(Path(__file__).parent))
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    rows = [
        ["filter + smoother, 12 states, 18 observations", f"{1e6 * own:.1f} µs per sample"],
        ["the same with filterpy", f"{1e6 * other:.0f} µs per sample"],
        ["ratio", f"1/{other / own:.0f}"],
        ["largest difference between the two, of each state's range", f"{difference:.0e}"],
        ["markers to states, 16,000 frames × 39 markers", f"{min(time_whole(16_000) for _ in range(3)):.2f} s"],
        ["the same, 32,000 frames", f"{min(time_whole(32_000) for _ in range(2)):.2f} s"],
        ["first call, nothing compiled", f"{float(done.stdout):.1f} s"],
    ]
    publish({"filter": format_table(["", ""], rows)}, write=given.write)


if __name__ == "__main__":
    main()
