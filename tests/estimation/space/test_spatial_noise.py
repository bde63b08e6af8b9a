"""The snap of a coordinate, from a movement that sinks into noise."""

from __future__ import annotations

import math

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.estimation.space.frame_poses import FramePoses, make_chain_model, make_track
from mocap_id.estimation.space.space_smoothing import estimate_snaps
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id_simulation.sit_to_stand import draw_sway, draw_tremor

DT, FRAMES, NOISE = 0.01, 1600, 0.015  # s, frames, rad
CHAIN = SpatialChain(
    (SpatialJoint("hinge", 0, np.zeros(3)),), np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0, dtype=np.bool_)
)


def found_snap(angle: FloatArray) -> float:
    """Return the snap of a hinge with angles (F,) measured frame by frame."""
    model = make_chain_model(CHAIN)
    track = make_track(model, len(angle))
    track.angle[:, 0, 0] = angle
    variance, nothing = np.full((len(angle), 7), NOISE**2), np.zeros((len(angle), 0))
    observed = np.ones((len(angle), 2), dtype=np.bool_)
    frames = FramePoses(track, variance, observed, nothing, nothing, nothing, nothing)
    return float(estimate_snaps(model, frames, DT)[0][6])


def acceleration_errors(angle: FloatArray, noise: FloatArray, snaps: FloatArray) -> FloatArray:
    """Return the rms errors of the accelerations that the smoother has with these snaps, rad/s²."""
    turning = 2 * np.pi * np.fft.rfftfreq(2 * len(angle), DT)
    movement, errors = (np.fft.rfft(np.concatenate([x, x[::-1]])) for x in (angle, noise))
    found = []
    for snap in snaps:
        passed = 1 / (1 + (turning / (snap / NOISE) ** 0.25) ** 8)
        off = np.fft.irfft(turning**2 * (passed * (movement + errors) - movement))[: len(angle)]
        found.append(np.sqrt(np.mean(off[100:-100] ** 2)))
    return np.array(found)


def test_acceleration_is_nearly_as_accurate_as_with_the_best_snap() -> None:
    time, loss = np.arange(FRAMES) * DT, []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        angle = (draw_tremor(rng, time, np.array([0.5])) + draw_sway(rng, time, np.array([0.6])))[:, 0]
        noise = NOISE * rng.normal(size=FRAMES)
        errors = acceleration_errors(angle, noise, np.append(np.geomspace(50, 5000, 60), found_snap(angle + noise)))
        loss.append(errors[-1] / errors[:-1].min())
    assert math.exp(np.mean(np.log(loss))) < 1.05
    assert max(loss) < 1.2
