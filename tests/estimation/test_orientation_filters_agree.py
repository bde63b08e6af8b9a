"""Tilt of a segment from inertial sensors alone, compared with the orientation filter VQF (`pip install vqf`)."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.estimation import smooth
from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.estimation.inertial import SensorSignals
from mocap_id.estimation.inertial_tracking import calibrate_chain, track_without_markers
from mocap_id_simulation import Options, SimulatedTrial, generate
from mocap_id_simulation.instruments import simulate_plane_sensors
from mocap_id_simulation.options import draw_subject

pytestmark = pytest.mark.external
PERSON = draw_subject(8, 1)


def _trial(seed: int) -> tuple[SimulatedTrial, dict[int, SensorSignals], list[float]]:
    trial = generate("sit-to-stand", Options(seed=seed, repetitions=2, analog_rate=100, subject=PERSON))
    found = simulate_plane_sensors(seed, trial.scene, trial.state, 1.0, PERSON.seed)
    sensors = {s: SensorSignals(each.time, each.gyro, each.acc) for s, (each, _) in enumerate(found.values(), start=1)}
    return trial, sensors, [float(truth["offset_s"]) for _, truth in found.values()]


def test_the_tilt_is_at_least_as_accurate_as_that_of_vqf() -> None:
    vqf = pytest.importorskip("vqf", reason="the orientation filter VQF is not installed")
    shown, worn, _ = _trial(81)
    body, markers = shown.scene.body, shown.scene.markers
    points = np.ascontiguousarray(shown.scene.plane.to_plane(shown.points)[..., :2])
    states = smooth(
        points, 100.0, MarkerChain(body.centres, markers.link.astype(np.int64), markers.local[:, :2].copy())
    )
    known = calibrate_chain(states, shown.state.time, worn, states.sigma_v**2 / 100.0)
    trial, sensors, offsets = _trial(82)
    first, last = max(each.time[0] for each in sensors.values()), min(each.time[-1] for each in sensors.values())
    time = np.arange(np.ceil(100 * first) + 30, 100 * last - 30) / 100
    mean, *_ = track_without_markers([sensors[s] for s in (1, 2, 3)], time, known)
    ours, theirs = np.cumsum(mean[..., 0], axis=1), np.empty((len(time), 3))
    true = np.empty_like(ours)
    for s, each in sensors.items():
        log = vqf.VQF(0.01).updateBatch(np.ascontiguousarray(each.gyro), np.ascontiguousarray(each.acc))
        w, x, y, z = log["quat6D"].T
        up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)], axis=1)
        in_segment = up @ known.calibrations[s - 1].mount.T
        stamps = time - offsets[0] + offsets[s - 1]
        tilt = np.unwrap(np.arctan2(in_segment[:, 0], in_segment[:, 1]))
        theirs[:, s - 1] = np.interp(2 * time - stamps, each.time, tilt)
        true[:, s - 1] = np.interp(time + offsets[0], trial.state.time, trial.state.seg_angle[:, s - 1])
    off = [np.degrees(np.std(angles - true, axis=0)[1:]) for angles in (ours, theirs)]  # but for the axes' definition
    assert (off[0] < 1.5).all()
    assert off[0].mean() < off[1].mean()
    assert np.degrees(np.std(ours - theirs, axis=0)).max() < 6
