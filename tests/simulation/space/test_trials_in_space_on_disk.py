"""Trials in space on disk: complete, repeatable, and equal to the truth in memory."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.errors import StoreError
from mocap_id.recording import read
from mocap_id_simulation import ArmOptions, ChainOptions, generate_arm, write_arm, write_chain

ARM = ArmOptions(seed=3, movement="curl", repetitions=1, preset="hard", anonymous=True, side="left")
CASES = {"arm": (write_arm, ARM), "chain": (write_chain, ChainOptions(seed=3, kinds="SH", duration=4.0))}


@pytest.mark.parametrize("kind", CASES)
def test_the_same_options_give_the_same_files(tmp_path, kind):
    write, options = CASES[kind]
    for name in ("first", "second"):
        write(tmp_path / name / "trial", options)
    files = sorted(path.name for path in (tmp_path / "first" / "trial").iterdir())
    assert files == ["trial.c3d", "trial.yaml", "truth.json", "truth.npz"]
    for name in files:
        first, second = ((tmp_path / folder / "trial" / name).read_bytes() for folder in ("first", "second"))
        assert first == second, name


def test_the_file_holds_what_was_seen(tmp_path):
    write_arm(tmp_path / "trial", ARM)
    trial, recording = generate_arm(ARM), read(tmp_path / "trial" / "trial.c3d")
    assert recording.labels == trial.labels
    assert trial.labels[9:] == tuple(f"M{k:03d}" for k in range(15))
    np.testing.assert_allclose(recording.positions, trial.positions, atol=1e-6)


def test_the_truth_tells_the_arm(tmp_path):
    write_arm(tmp_path / "trial", ArmOptions(seed=3, cycles=1))
    truth = json.loads((tmp_path / "trial" / "truth.json").read_text())
    arrays = np.load(tmp_path / "trial" / "truth.npz")
    subject, markers = truth["subject"], {each["label"]: each for each in truth["markers"]}
    assert truth["kind"] == "reach"
    assert truth["segments"] == ["thorax", "upper_arm", "forearm", "hand"]
    assert truth["assignment"]["EL"] == 1
    assert len(arrays["t"]) == truth["n_frames"]
    between = np.linalg.norm(arrays["seg_origin"][:, 1] - arrays["seg_origin"][:, 2], axis=1)
    np.testing.assert_allclose(between, subject["segment_lengths_m"]["upper_arm"], atol=1e-12)
    assert 0 < np.linalg.norm(np.subtract(markers["EL"]["local_xyz_m"], markers["EL"]["bone_xyz_m"])) < 0.02
    assert 0.05 < truth["reach"]["volume_m3"] < 0.6
    assert arrays["isb_shoulder"][:, 1].max() < 0  # the rotation about x, minus the elevation


def test_the_configuration_is_ready_to_run(tmp_path):
    trial = load(write_arm(tmp_path / "1e3", ARM))
    assert trial.name == "1e3"
    assert trial.keys.protocol == "curl"
    assert trial.keys.space == "3d"
    assert trial.keys.side == "left"


def test_a_folder_that_holds_a_trial_is_left_alone(tmp_path):
    write_chain(tmp_path / "trial", CASES["chain"][1])
    with pytest.raises(StoreError, match="already contains a trial"):
        write_chain(tmp_path / "trial", ChainOptions(seed=4))
