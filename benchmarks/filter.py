"""Speed of the state filter, against filterpy in the same run: ``python benchmarks/filter.py``.

Prints a table: time per sample of filter and smoother on a chain of three joints and nine markers (12 states, 18
observations), how far the two engines differ, the time of the whole estimate (noise included) on 16,000 frames of 40
markers, and the time of a first call that finds no compiled code.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from time import perf_counter

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation import compiled, reference, smooth
from mocap_id.estimation.inverse import Chain, frame_angles
from mocap_id.estimation.problem import Problem, Track
from mocap_id.estimation.sigma_points import SigmaPoints
from mocap_id.geometry.planar import marker_positions

RATE, NOISE = 480.0, 1e-3

COLD = """
from time import perf_counter
import sys
sys.path.insert(0, {folder!r})
from filter import recording
from mocap_id.estimation import smooth
chain, markers = recording(100, 3)
start = perf_counter()
smooth(markers, 480.0, chain.centres, chain.segment, chain.local)
print(perf_counter() - start)
"""


def recording(frames: int, per_segment: int) -> tuple[Chain, FloatArray]:
    """Three joints that swing at 0.4 to 0.8 Hz, and their markers (F, M, 2) with 1 mm of noise."""
    rng = np.random.default_rng(0)
    time = np.arange(frames)[:, None] / RATE
    angles = np.array([0.2, 0.8, 0.9]) * np.sin(2 * np.pi * np.array([0.4, 0.6, 0.8]) * time + [0.0, 1.0, 2.0])
    centres = np.array([[0.0, 0.07], [0.0, 0.44], [0.0, 0.43]])
    segment: IntArray = np.repeat(np.arange(1, 4), per_segment)
    local = rng.uniform([-0.08, 0.05], [0.08, 0.4], (len(segment), 2))
    markers = marker_positions(angles, centres, segment, local)
    return Chain(centres, segment, local), markers + NOISE * rng.standard_normal(markers.shape)


def problem(chain: Chain, markers: FloatArray) -> Problem:
    """What both engines are given."""
    variance = np.full(len(chain.segment), NOISE**2)
    return Problem(
        observed=markers,
        dt=1.0 / RATE,
        centres=chain.centres,
        segment=chain.segment,
        local=chain.local,
        variance=variance,
        gate_variance=variance,
        gate=8.0,
        density=np.full(3, 1e3**2 / RATE),
        anchors=frame_angles(markers, chain, 8.0, 5e-5).anchors(NOISE),
        sigma_points=SigmaPoints(),
    )


def theirs(given: Problem) -> tuple[float, Track]:
    """Time and result of filterpy's predict, update and rts_smoother, given our start; no gate."""
    first = compiled.filter_forwards(given)
    ukf = reference._filterpy(given)
    ukf.x, ukf.P = first.mean[0].copy(), first.covariance[0].copy()
    mean, covariance = [ukf.x.copy()], [ukf.P.copy()]
    start = perf_counter()
    for z in given.observed[1:]:
        ukf.predict()
        seen = np.isfinite(z).all(axis=1)
        if seen.any():  # filterpy knows nothing of rows that are missing
            ukf.update(z[seen].ravel(), R=np.diag(np.repeat(given.variance[seen], 2)), markers=seen)
        mean.append(ukf.x.copy())
        covariance.append(ukf.P.copy())
    x, p, _ = ukf.rts_smoother(np.array(mean), np.array(covariance))
    seconds = perf_counter() - start
    return seconds, Track(x, p, first.used, first.restarted, 0.0)


def ours(given: Problem) -> tuple[float, Track]:
    """Time and result of the compiled engine."""
    start = perf_counter()
    track = compiled.smooth_backwards(given, compiled.filter_forwards(given))
    return perf_counter() - start, track


def best(function: Callable[[], float], times: int) -> float:
    """Shortest of several runs: what the machine's other work disturbs least."""
    return min(function() for _ in range(times))


def whole(frames: int) -> float:
    """Seconds for everything from markers to states."""
    chain, markers = recording(frames, 13)
    start = perf_counter()
    smooth(markers, RATE, chain.centres, chain.segment, chain.local)
    return perf_counter() - start


def cold() -> float:
    """Seconds of a first call in a process that finds no compiled code."""
    with tempfile.TemporaryDirectory() as folder:
        code = COLD.format(folder=os.path.dirname(os.path.abspath(__file__)))  # noqa: PTH100, PTH120
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        return float(done.stdout)


def main() -> None:
    """Measure and print."""
    short, long = problem(*recording(600, 3)), problem(*recording(12_000, 3))
    ours(short)
    per_sample = best(lambda: ours(long)[0], 5) / 12_000
    reference_seconds, reference_track = theirs(short)
    reference_per_sample = min(reference_seconds, theirs(short)[0]) / 600
    track = ours(short)[1]
    scale = np.abs(reference_track.mean).max(axis=0)
    difference = np.max(np.abs(track.mean - reference_track.mean) / scale)
    whole(2_000)
    rows = [
        ("filter + smoother, 12 states, 18 observations", f"{1e6 * per_sample:.1f} µs a sample"),
        ("the same with filterpy", f"{1e6 * reference_per_sample:.0f} µs a sample"),
        ("ratio", f"1/{reference_per_sample / per_sample:.0f}"),
        ("largest difference between the two, of each state's range", f"{difference:.0e}"),
        ("markers to states, 16,000 frames x 39 markers", f"{best(lambda: whole(16_000), 3):.2f} s"),
        ("the same, 32,000 frames", f"{best(lambda: whole(32_000), 2):.2f} s"),
        ("first call, nothing compiled", f"{cold():.1f} s"),
    ]
    width = max(len(name) for name, _ in rows)
    print("\n".join(f"| {name:<{width}} | {value} |" for name, value in rows))


if __name__ == "__main__":
    main()
