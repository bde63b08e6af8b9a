"""The chair on its own plate: its readings, and unchanged results otherwise."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.geometry import PlaneFrame
from mocap_id.recording import read
from mocap_id_simulation import Options, generate, simulate

QUIET = {"seed": 8, "repetitions": 1, "plate_noise": 0.0, "clock_offset": 0.05}


@pytest.mark.parametrize("sense", ["reaction", "action"])
@pytest.mark.parametrize("moved", [False, True])
def test_the_reader_recovers_the_chairs_wrench_and_weight(tmp_path, sense, moved):
    options = Options(**QUIET, plate_sense=sense, plate_moved=moved, seat_plate=True, chair_mass=5.0)
    simulate("sit-to-stand", tmp_path / "trial", options)
    recording = read(tmp_path / "trial" / "trial.c3d")
    assert len(recording.plates) == 2
    scene, plate = generate("sit-to-stand", options).scene, recording.plates[1]
    state = scene.at(np.arange(len(plate.force)) / plate.rate + 0.05)
    frame = PlaneFrame(scene.plane.yaw, scene.plane.origin)
    found = frame.wrench_to_plane(plate.force, plate.moment)
    ground = frame.wrench_to_plane(recording.plates[0].force, recording.plates[0].moment)
    weight = 5.0 * 9.81
    place = frame.to_plane(scene.seat_plate.centre)[0]
    np.testing.assert_allclose(found - [0.0, weight, weight * place], state.wrench_total - state.wrench, atol=0.02)
    np.testing.assert_allclose(ground, state.wrench, atol=0.01)
    off_chair = np.abs(state.chair_force[:, 1]) == 0
    np.testing.assert_allclose(found[off_chair, 1], weight, atol=1e-3)


def test_without_noise_or_load_the_plate_is_where_the_seated_person_presses():
    scene = generate("sit-to-stand", Options(**QUIET, seat_plate=True)).scene
    state = scene.at(np.array([0.5]))
    force, moment = scene.load_on_seat_plate(state)
    across = moment @ scene.plane.axes[2] / force[:, 2]
    assert abs(across[0]) < 0.02


def test_the_seed_keeps_its_trial():
    plain, seated = (generate("sit-to-stand", Options(seed=5, repetitions=1, seat_plate=on)) for on in (False, True))
    np.testing.assert_array_equal(plain.points, seated.points)
    np.testing.assert_array_equal(plain.signals.channels, seated.signals.channels)
    assert plain.seat_signals is None


def test_a_robot_has_no_chair():
    assert generate("robot", Options(seed=5, repetitions=1, seat_plate=True)).seat_signals is None


def test_truth_and_configuration_tell_of_it(tmp_path):
    yaml = simulate("sit-to-stand", tmp_path / "trial", Options(seed=8, repetitions=1, seat_plate=True))
    truth = json.loads((tmp_path / "trial" / "truth.json").read_text())
    assert truth["seat_plate"]["chair_weight_N"] == pytest.approx(6 * 9.81)
    assert set(truth["plate"]) < set(truth["seat_plate"])
    assert "the chair stands on plate 2" in yaml.read_text()
    assert load(yaml).keys.plates.seat == ()
