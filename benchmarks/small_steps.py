"""Time of steps that are to cost next to nothing, each beside the plainest pass over the same data in the same run.

    python benchmarks/small_steps.py

A workspace of 10,000 postures (alpha shape, its radius included) beside the triangulation that it rests on; the spring
of one joint beside a search over a grid of 100 by 100 springs; exchanged labels in 17,000 frames of 50 markers beside
one pass of differences over them. What is printed is the least of several times, and the ratio.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from time import process_time

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from scipy.spatial import Delaunay

from mocap_id.kinematics.swaps import find_swaps
from mocap_id.prescription.alpha_shape import alpha_shape, covering_radius
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.one_spring import prescribe
from mocap_id.prescription.reach import PlanarArm
from mocap_id.prescription.sampling import sample_box, sobol

REPEATS = 7
SAMPLES = 10_000
LOWER, UPPER = np.array([0.98, -2.0]), np.array([3.05, -0.1])


def least(call: Callable[[], object]) -> float:
    """Least processor time of several calls, ms, after one that compiles."""
    call()
    times = []
    for _ in range(REPEATS):
        start = process_time()
        call()
        times.append(process_time() - start)
    return 1e3 * min(times)


def workspace() -> tuple[Callable[[], object], Callable[[], object]]:
    """The area that a two-link arm reaches, and the triangulation of its points."""
    arm = PlanarArm.exact(np.array([[0.1, 1.4], [0.0, 0.31]]), np.array([0.0, 0.28]))
    points = arm.tips(sample_box(LOWER, UPPER, SAMPLES, 0, 2))

    def whole() -> float:
        sampled = arm.tips(sample_box(LOWER, UPPER, SAMPLES, 0, 2))
        others = arm.tips(LOWER + sobol(SAMPLES, 2, 1) * (UPPER - LOWER))
        return alpha_shape(sampled, 2 * covering_radius(sampled, others)).measure

    return whole, lambda: Delaunay(points)


def spring() -> tuple[Callable[[], object], Callable[[], object]]:
    """The best spring of a joint with a fifth of the strength that it needs, and trying 10,000 springs."""
    joint = OneJoint(1.0, 0.0, *np.radians([-60.0, 180.0]).tolist(), -0.2, 0.2)
    angle = np.linspace(joint.lower, joint.upper, 721)

    def tried() -> int:
        most = 0
        for stiffness in np.linspace(0.0, 1.0, 100):
            for rest in np.linspace(-2 * np.pi, 2 * np.pi, 100):
                most = max(most, int(np.count_nonzero(np.abs(joint.torque(angle, stiffness, rest)) <= 0.2)))
        return most

    return lambda: prescribe(joint), tried


def swaps() -> tuple[Callable[[], object], Callable[[], object]]:
    """Exchanged labels where nothing moves but one marker is lost for a while, and differences of all coordinates."""
    points = np.random.default_rng(0).normal(size=(1, 50, 3)) + np.zeros((17_000, 1, 1))
    points[5000:5100, 7] = np.nan
    return lambda: find_swaps(points, 480.0), lambda: np.abs(np.diff(points, axis=0)).max()


def main() -> None:
    """Print the table."""
    print("| step | ms | plainest pass | ms | ratio |\n|---|--:|---|--:|--:|")
    rows = (
        ("workspace of 10,000 postures", "triangulation", workspace),
        ("spring of one joint", "10,000 springs tried", spring),
        ("exchanged labels, 17,000 frames of 50 markers", "differences", swaps),
    )
    for name, beside, calls in rows:
        own, plain = map(least, calls())
        print(f"| {name} | {own:.1f} | {beside} | {plain:.1f} | {own / plain:.2g} |")


if __name__ == "__main__":
    main()
