"""Simulated planar chains with known motion, for the tests of the filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation import FilterSettings, States, smooth
from mocap_id.estimation.filter_problem import FilterProblem, MarkerChain
from mocap_id.estimation.noise import find_frame_angles
from mocap_id.geometry.planar import marker_positions
from mocap_id.store import LongTable
from mocap_id.store.provenance import PLANAR


@dataclass(frozen=True)
class Moving:
    """A moving chain: true angle, velocity, acceleration, jerk (F, n, 4), and measured markers (F, M, 2)."""

    truth: FloatArray
    markers: FloatArray
    rate: float
    centres: FloatArray
    segment: IntArray
    local: FloatArray

    @property
    def chain(self) -> MarkerChain:
        return MarkerChain(self.centres, self.segment, self.local)

    def smoothed(self, **settings: object) -> States:
        return self.smoothed_from(self.markers, **settings)

    def smoothed_from(self, markers: FloatArray, **settings: object) -> States:
        given = FilterSettings(**settings)  # type: ignore[arg-type]
        return smooth(markers, self.rate, self.chain, settings=given)

    def problem(self, *, marker_sd: float, sigma_v: float, gate: float = 5.0) -> FilterProblem:
        """Return the engine's input as built by :func:`smooth`."""
        frames = find_frame_angles(self.markers, self.chain, gate, 5e-5)
        variance = np.full(len(self.segment), marker_sd**2)
        return FilterProblem(
            observed=self.markers,
            dt=1.0 / self.rate,
            chain=self.chain,
            variance=variance,
            gate_variance=np.fmax(variance, frames.scale**2),
            gate=gate,
            density=np.full(len(self.centres), sigma_v**2 / self.rate),
            anchors=frames.anchors(marker_sd),
        )


def swinging(
    *,
    joints: int = 3,
    per_segment: int = 4,
    seconds: float = 4.0,
    rate: float = 100.0,
    noise: float = 5e-4,
    seed: int = 0,
) -> Moving:
    """Return a chain with joints that swing by up to a radian at 0.4 to 0.9 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * rate))[:, None] / rate
    w = 2 * np.pi * rng.uniform(0.4, 0.9, joints)
    amplitude, phase, middle = rng.uniform(0.3, 1.0, joints), rng.uniform(-3, 3, joints), rng.uniform(-1, 1, joints)
    waves = [w**d * amplitude * np.sin(w * time + phase + d * np.pi / 2) for d in range(4)]
    truth = np.stack(waves, axis=-1)
    truth[..., 0] += middle
    return measured(truth, rate, noise, rng, per_segment)


def measured(truth: FloatArray, rate: float, noise: float, rng: np.random.Generator, per_segment: int = 4) -> Moving:
    """Return markers on a random chain with the given motion and white noise (m)."""
    joints = truth.shape[1]
    centres = rng.uniform([-0.05, 0.3], [0.05, 0.5], (joints, 2))
    segment = np.repeat(np.arange(1, joints + 1), per_segment)
    local = rng.uniform([-0.08, 0.05], [0.08, 0.4], (len(segment), 2))
    exact = marker_positions(truth[..., 0], centres, segment, local)
    return Moving(truth, exact + noise * rng.standard_normal(exact.shape), rate, centres, segment, local)


def kicked(*, rate: float = 100.0, seconds: float = 10.0, noise: float = 2e-5, width: float = 0.03) -> Moving:
    """Return a swinging chain of three joints whose second joint kicks in the middle, 1.5 rad there and back.

    ``width`` is the standard deviation of the bell-shaped kick, s. Slow movement and small ``noise``, m, as in a
    filtered export, make the process noise too small for the kick.
    """
    slow = swinging(joints=3, seconds=seconds, rate=rate, noise=noise, seed=1)
    u = (np.arange(len(slow.truth)) / rate - seconds / 2) / width
    bell = 1.5 * np.exp(-(u**2) / 2)
    truth = slow.truth.copy()
    for order, factor in enumerate((1, -u, u**2 - 1, 3 * u - u**3)):
        truth[:, 1, order] += bell * factor / width**order
    return measured(truth, rate, noise, np.random.default_rng(101))


def planar_table(frames: IntArray, time: FloatArray, labels: list[str], points: FloatArray, rate: float) -> LongTable:
    """Return the markers (F, M, 2), m, as a table of planarise."""
    values = {"x": points[..., 0], "y": points[..., 1], "z": np.zeros(points.shape[:2])}
    seen = np.isfinite(points[..., 0])
    return LongTable(PLANAR, frames, time, tuple(labels), {**values, "visible": seen}, {"rate_hz": rate})


def rms(error: FloatArray) -> FloatArray:
    """Return the rms over finite samples, (n, 4) from (F, n, 4)."""
    return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))
