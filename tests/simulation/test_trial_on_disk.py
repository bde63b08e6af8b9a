"""Output of `simulate`: complete, repeatable, never overwriting, with the keys needed for scoring."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mocap_id.config import load
from mocap_id.errors import ConfigError, StoreError
from mocap_id_simulation import Options, simulate

QUICK = Options(seed=3, repetitions=1)
KINDS = ["sit-to-stand", "robot"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_options_give_the_same_files(tmp_path, kind):
    for name in ("first", "second"):
        simulate(kind, tmp_path / name / "trial", QUICK)
    files = sorted(path.name for path in (tmp_path / "first" / "trial").iterdir())
    expected = ["trial.c3d", "trial.yaml", "truth.json", "truth.npz"]
    assert files == (["encoder.csv"] if kind == "robot" else []) + expected
    for name in files:
        first, second = ((tmp_path / folder / "trial" / name).read_bytes() for folder in ("first", "second"))
        assert first == second, name


@pytest.mark.parametrize("kind", KINDS)
def test_the_configuration_is_ready_to_run(tmp_path, kind):
    path = simulate(kind, tmp_path / "1e3", QUICK)
    trial = load(path)
    assert trial.name == "1e3"
    assert trial.keys.recording.markers == tmp_path / "1e3" / "trial.c3d"
    assert trial.keys.protocol == ("robot-joint" if kind == "robot" else "sit-to-stand")


def test_a_folder_that_holds_a_trial_is_left_alone(tmp_path):
    simulate("robot", tmp_path / "trial", QUICK)
    before = (tmp_path / "trial" / "trial.c3d").read_bytes()
    with pytest.raises(StoreError, match="already contains a trial: remove the trial or choose a different folder"):
        simulate("robot", tmp_path / "trial", Options(seed=4, repetitions=1))
    assert (tmp_path / "trial" / "trial.c3d").read_bytes() == before


def test_a_file_in_the_way_is_said(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(StoreError, match="taken"):
        simulate("robot", tmp_path / "taken", QUICK)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seed", -1),
        ("repetitions", 0),
        ("strategy", "slow"),
        ("rate", 0.0),
        ("analog_rate", 1050.0),
        ("marker_noise", float("nan")),
        ("soft_tissue", -1.0),
        ("plate_sense", "both"),
        ("plate_noise", -0.1),
        ("plate_bias", float("inf")),
        ("clock_offset", 2.0),
    ],
)
def test_a_value_out_of_range_is_named(name, value):
    with pytest.raises(ConfigError, match=f"simulate: `{name}` is .* expected"):
        Options(**{name: value})


def test_an_unknown_kind_is_named(tmp_path):
    with pytest.raises(ConfigError, match="`kind` is 'jump'; expected one of sit-to-stand, robot"):
        simulate("jump", tmp_path / "trial", QUICK)


@pytest.mark.recordings
@pytest.mark.parametrize(("kind", "reference"), [("sit-to-stand", "sts-normal"), ("robot", "ur5-elbow-fast")])
def test_the_truth_has_the_keys_of_the_reference(tmp_path, recordings, kind, reference):
    folder = recordings / "simulated" / reference
    simulate(kind, tmp_path / "trial", QUICK)
    ours, theirs = (json.loads((path / "truth.json").read_text()) for path in (tmp_path / "trial", folder))
    of_one_robot = {"joint", "robot_yaw_deg", "bracket_mass", "expected_length_m", "table_5_2_reference"}
    assert set(theirs) - set(ours) <= of_one_robot
    for key in ("plane", "plate", "base_parameters"):
        assert set(theirs[key]) == set(ours[key])
    for key in ("segments", "markers", "reps"):
        assert set(theirs[key][0]) == set(ours[key][0])
    assert len(theirs["base_parameters"]["values"]) == len(ours["base_parameters"]["values"])
    with np.load(tmp_path / "trial" / "truth.npz") as mine, np.load(folder / "truth.npz") as other:
        assert set(other.files) <= set(mine.files)
        for name in other.files:
            assert mine[name].ndim == other[name].ndim, name
            assert len(mine[name]) == ours["n_frames"], name


def test_the_encoder_follows_the_joint_on_its_own_clock(tmp_path):
    simulate("robot", tmp_path / "trial", Options(seed=6, repetitions=3))
    truth = json.loads((tmp_path / "trial" / "truth.json").read_text())
    rows = np.genfromtxt(tmp_path / "trial" / "encoder.csv", delimiter=",", names=True)
    with np.load(tmp_path / "trial" / "truth.npz") as arrays:
        time = rows["time_s"] + truth["encoder"]["clock_offset_s"]
        inside = (time > 0) & (time < arrays["t"][-1])
        for column, name, sd in (
            ("position_rad", "q", "position_sd"),
            ("velocity_rad_s", "qd", "velocity_sd"),
            ("torque_Nm", "tau", "torque_sd"),
        ):
            exact = CubicSpline(arrays["t"], arrays[name][:, 0])(time[inside])
            error = float(np.std(rows[column][inside] - exact))
            assert error == pytest.approx(truth["encoder"][sd], rel=0.1)
