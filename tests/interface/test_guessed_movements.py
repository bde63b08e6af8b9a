"""Space and protocol of a recording without settings follow from its motion, or are asked for."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocap_id
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.protocols.movement import recognise_movement
from mocap_id.recording import Recording
from mocap_id.workflows.recording_trial import make_trial
from mocap_id.workflows.study.discovery import read_reach

SAMPLES = Path(__file__).resolve().parents[2] / "sample_trials"
PLANE, REACH, CURL = ("plane", "sit-to-stand"), ("3d", "reach"), ("3d", "curl")
STILL, ASKED = ("plane", "free"), None
GUESSES = {
    "sit-to-stand/STS1.trc": PLANE,
    "sit-to-stand/squats1.trc": PLANE,
    "sit-to-stand/static1.trc": STILL,
    "lifting/S1.trc": PLANE,
    "lifting/S4_markers.csv": PLANE,
    "c3d/stoop1_t169_f620f800.c3d": PLANE,
    "c3d/Sample_Static.c3d": STILL,
    "c3d/c3dfile1.c3d": STILL,
    "gait/child1_static.c3d": STILL,
    "c3d/Sample_Jump2.c3d": "jumping",
    "c3d/Gait.c3d": "walking",
    "c3d/PiG_Motion-FlatFoot-One.c3d": "walking",
    "c3d/TYPE-3.c3d": "walking",
    "c3d/marche281.c3d": "walking",
    "c3d/pc_real.c3d": "walking",
    "c3d/walking5.c3d": "walking",
    "c3d/walkingOptiTrack.c3d": "walking",
    "gait/child1_straight.c3d": "walking",
    "gait/child2_turn.c3d": "walking",
    "gait/treadmill.c3d": "walking",
    "gait/walking1.trc": "walking",
    "gait/walkingTS1.trc": "walking",
    "c3d/sample_propulsion.c3d": ASKED,
    "c3d/shd01.c3d": ASKED,
    "upper-limb/abduction/ABD01.trc": ASKED,
    "upper-limb/ulema/RF1.c3d": REACH,
    "upper-limb/ulema/HTH1.c3d": REACH,
    "upper-limb/ulema/ElbFlPron.c3d": STILL,
    "upper-limb/keraal/G3-Kinect-CTK.txt": REACH,
    "bones/S2M_armAbd/trial.c3d": ASKED,
    "bones/S2M_punching/trial.c3d": ASKED,
    "bones/FOROIT_hipFunct/trial.c3d": ASKED,
    "simulated/sts-stable-rotated-plate/trial.c3d": PLANE,
    "simulated/ur5-elbow-fast/trial.c3d": ASKED,
    "simulated-arm/wii/trial.c3d": PLANE,
    "simulated-arm/reach-hard/trial.c3d": REACH,
    "simulated-arm/reach-hard/kinect.csv": REACH,
    "simulated-arm/curl-5/trial.c3d": CURL,
    "simulated-arm/curl-C/kinect.csv": CURL,
    "simulated-arm/sphere-SS/trial.c3d": ASKED,
}
OF_SAMPLES = {
    "arm-reach/trial.c3d": REACH,
    "curl/trial.c3d": CURL,
    "curl-assisted/trial.c3d": CURL,
    "robot-joint/trial.c3d": ASKED,
    "sit-to-stand/trial.c3d": PLANE,
}


def _check_guess(file: Path, expected: tuple[str, str] | str | None, out: Path) -> None:
    if expected is ASKED:
        with pytest.raises(ConfigError, match=r"fits no protocol: .*--protocol sit-to-stand.*--space 3d"):
            make_trial(file, {"out": out})
        assert not out.exists()
        return
    keys = make_trial(file, {"out": out}).keys
    assert keys.guessed is not None
    assert keys.guessed.evidence
    if isinstance(expected, str):
        assert keys.guessed.movement == expected
    else:
        assert (keys.space, keys.protocol) == expected
        assert keys.guessed.movement not in {"walking", "jumping"}


@pytest.mark.recordings
@pytest.mark.parametrize("file", GUESSES)
def test_guesses_of_real_and_simulated_recordings(file: str, recordings: Path, tmp_path: Path) -> None:
    _check_guess(recordings / file, GUESSES[file], tmp_path / "run")


@pytest.mark.recordings
@pytest.mark.parametrize("file", ["sit-to-stand/STS1.trc", "lifting/S1.trc", "c3d/shd01.c3d"])
def test_a_body_with_markers_on_its_arms_is_no_reach_of_a_study(file: str, recordings: Path) -> None:
    assert read_reach(recordings / file, None) is None


def test_a_person_who_walks_to_the_chair_sits_down_and_stands_up() -> None:
    sample = mocap_id.read(SAMPLES / "sit-to-stand" / "trial.c3d")
    _, steps = _walk(travels=True)
    arrival = np.repeat(sample.positions[:1], len(steps), axis=0)
    arrival[..., 0] += (steps[:, 4, 0] - steps[-1, 4, 0])[:, None]
    made = np.concatenate([arrival, sample.positions[::2]])
    assert recognise_movement(sample.labels, made, 50.0)[0] == "sit-to-stand"


@pytest.mark.parametrize("file", OF_SAMPLES)
def test_guesses_of_the_sample_trials(file: str, tmp_path: Path) -> None:
    _check_guess(SAMPLES / file, OF_SAMPLES[file], tmp_path / "run")


def _walk(*, travels: bool) -> tuple[list[str], FloatArray]:
    """Return a walker at 60 Hz: each foot stands for 60 % of a stride of 1 s and 1.2 m, on the floor or on a belt."""
    time = np.arange(0, 4, 1 / 60)
    positions = []
    for phase in (0.0, 0.5):
        stride, part = np.divmod(time + phase, 1.0)
        swing = np.clip((part - 0.6) / 0.4, 0, 1)
        foot = np.stack(
            [1.2 * (stride + swing - phase), 0.1 * (phase - 0.25) + 0 * time, 0.1 * np.sin(np.pi * swing)], 1
        )
        positions += [foot + np.array([0.0, 0.0, 0.08]), foot + np.array([0.15, 0.0, 0.04])]
    body = np.stack([1.2 * time, 0 * time, 1.0 + 0.02 * np.sin(4 * np.pi * time)], 1)
    positions += [body + np.array(at) for at in ((0.1, 0.1, 0), (0.1, -0.1, 0), (0, 0.2, 0.45), (0, -0.2, 0.45))]
    made = np.stack(positions, 1)
    if not travels:
        made[..., 0] -= 1.2 * time[:, None]
    made += 1e-4 * np.random.default_rng(1).standard_normal(made.shape)  # no camera repeats a position exactly
    return ["LHEE", "LTOE", "RHEE", "RTOE", "LASI", "RASI", "LSHO", "RSHO"], made


def _jump() -> tuple[list[str], FloatArray]:
    """Return a jump at 60 Hz: a crouch of 0.3 m, then 0.4 s of free flight."""
    time = np.arange(0, 3, 1 / 60)
    crouch = -0.3 * np.sin(np.pi * np.clip((time - 0.8) / 0.7, 0, 1)) ** 2
    flight = np.where((time > 1.5) & (time < 1.9), 9.81 / 2 * (time - 1.5) * (1.9 - time), 0.0)
    labels, made = _walk(travels=True)
    made = np.repeat(made[:1], len(time), axis=0)
    made[..., 2] += flight[:, None]
    made[:, 4:, 2] += crouch[:, None]
    return labels, made


@pytest.mark.parametrize("turn", [0.0, 0.9, 2.3])
@pytest.mark.parametrize("size", [0.6, 1.0])
def test_walking_is_recognised_in_every_direction_and_size(turn: float, size: float) -> None:
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    for travels in (True, False):
        labels, made = _walk(travels=travels)
        assert recognise_movement(labels, size * made @ about_z.T + [3.0, -2.0, 0.0], 60.0)[0] == "walking"


def test_a_jump_falls_freely_and_a_fast_squat_does_not() -> None:
    labels, made = _jump()
    assert recognise_movement(labels, made, 60.0)[0] == "jumping"
    assert recognise_movement(labels, made, 20.0)[0] != "jumping", "the same way in three times the time is no fall"


@pytest.mark.parametrize(("move", "kind"), [(_jump, "jumping"), (lambda: _walk(travels=True), "walking")])
def test_walking_and_jumping_are_called_so_unless_a_protocol_is_given(
    move: Callable[[], tuple[list[str], FloatArray]], kind: str, tmp_path: Path
) -> None:
    labels, made = move()
    taken = Recording.from_arrays(labels, made, 60.0)
    run = mocap_id.run(taken, out=tmp_path / "run")
    assert run.refused
    assert [reason.code for reason in run.verdict.reasons] == [kind]
    assert "OpenSim" in run.verdict.reasons[0].message
    assert run.report.is_file()
    given = mocap_id.run(taken, protocol="free", space="plane", out=tmp_path / "given")
    assert kind not in [reason.code for reason in given.verdict.reasons]
    assert f"This looks like {kind}" in given.verdict.reasons[0].message
    assert load(tmp_path / "given" / "trial.yaml").keys.guessed is None


def test_a_quiet_run_shows_the_guess(cli: Any, tmp_path: Path) -> None:
    ran = cli("run", SAMPLES / "sit-to-stand" / "trial.c3d", "-q", "--out", tmp_path / "run")
    assert "guessed: `space: plane` and `protocol: sit-to-stand` were guessed, because" in ran.out
    assert "markers near the ground stand" in ran.out
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [note["code"] for note in summary["verdict"]["notes"]].count("guessed") == 1
    assert "markers near the ground stand" in (tmp_path / "run" / "report.html").read_text("utf-8")
    own = cli(
        "run", SAMPLES / "sit-to-stand" / "trial.c3d", "-q", "--protocol", "sit-to-stand", "--out", tmp_path / "b"
    )
    assert "guessed" not in own.out
