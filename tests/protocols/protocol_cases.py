"""Synthetic sit-to-stand and squat trials with smooth unloading and loading of the chair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.geometry import planar

RATE = 100.0
CENTRES = np.array([[-0.02, 0.08], [0.0, 0.43], [0.0, 0.41]])
BODY = np.array([[2.1, -0.15, 0.08, 0.03], [6.5, 0.05, 1.55, 0.5], [14.2, 0.1, 3.4, 1.1], [55.0, -0.6, 16.5, 8.6]])
WEIGHT = 9.81 * float(BODY[:, 0].sum())
LOW, FLEXED, HIGH = np.array([0.35, -1.8, 1.5]), np.array([0.42, -1.8, 0.9]), np.array([0.02, -0.05, 0.03])
RISE, SIT, STAND, PAUSE = 2.0, 2.0, 1.0, 1.0


@dataclass(frozen=True)
class Truth:
    """Events of the repetitions, s."""

    start: list[float]
    seat_off: list[float]
    stand: list[float]
    seat_on: list[float]
    end: list[float]


def smooth(x: np.ndarray) -> np.ndarray:
    """Quintic step from 0 to 1 over x in 0 … 1."""
    x = np.clip(x, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x * x)


def sit_to_stand(
    repetitions: int,
    *,
    chair: bool = True,
    begins_upright: bool = False,
    noise: float = 0.5,
    seed: int = 0,
    heights: tuple[float, ...] | None = None,
    attempt: tuple[float, float] | None = None,
) -> tuple[TrialData, Truth]:
    """Make a trial with rises and descents of 2 s each; the chair is released halfway through a rise.

    With ``begins_upright`` the trial also ends upright. ``heights`` are the heights of the rises as shares of a full
    rise. ``attempt`` is the time, s, and height of a failed attempt that lasts 1.2 s.
    """
    cycle = PAUSE + RISE + STAND + SIT
    time = np.arange(0, repetitions * cycle + PAUSE, 1 / RATE)
    start = np.array([k * cycle + PAUSE for k in range(repetitions)])
    top, down = start + RISE, start + RISE + STAND
    far = (1.0,) * repetitions if heights is None else heights
    up = sum(
        h * (smooth((time - s) / RISE) - smooth((time - d) / SIT)) for h, s, d in zip(far, start, down, strict=True)
    )
    if attempt is not None:
        at, height = attempt
        up = up + height * (smooth((time - at + 0.6) / 0.6) - smooth((time - at) / 0.6))
    lean = sum(smooth((time - s) / (RISE / 2)) - smooth((time - s - RISE / 2) / (RISE / 2)) for s in start) + sum(
        smooth((time - d) / (SIT / 2)) - smooth((time - d - SIT / 2) / (SIT / 2)) for d in down
    )
    if begins_upright:
        up = 1 - up
    q = LOW + up[:, None] * (HIGH - LOW) + lean[:, None] * (FLEXED - LOW) / 4
    dq, ddq = (np.gradient(q, time, axis=0), np.gradient(np.gradient(q, time, axis=0), time, axis=0))
    wrench = planar_regressor(CENTRES, q, dq, ddq) @ BODY.ravel()
    off, on = start + 0.35 * RISE, down + 0.65 * SIT
    seat = 1 - sum(smooth((time - o + 0.3) / 0.3) - smooth((time - n) / 0.3) for o, n in zip(off, on, strict=True))
    if chair:
        _, origin = planar.segment_poses(q, CENTRES)
        force = 0.8 * WEIGHT * seat
        wrench = wrench - np.column_stack([0 * force, force, origin[:, 3, 0] * force])
    wrench = wrench + noise * np.random.default_rng(seed).normal(size=wrench.shape) * [1, 1, 0.3]
    observed = np.ones(len(time), dtype=bool)
    recorded = TrialData(time, q, dq, ddq, np.zeros_like(q), observed, wrench, CENTRES)
    return recorded, Truth(*(list(map(float, x)) for x in (start, off, top, on, down + SIT)))
