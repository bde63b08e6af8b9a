"""Names of marker sets beside the motion, swaps that are said once, and torques of chains with single markers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.runner import run_stage
from mocap_id.stages.base import Findings
from mocap_id.stages.segment.hints import check_marker_names
from mocap_id.store import Folder
from mocap_id.verdict import Reason
from mocap_id_simulation import Options, simulate
from mocap_id_simulation.options import FaultOptions

STAGES = ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim")
NAMES = ("foot", "shank", "thigh", "torso")
LABELS = ("LHEE", "LTOE", "L_ANK", "LTIB", "RKNE", "L.THI", "LASI", "C7", "X1")
SEGMENTS = np.array([0, 0, 1, 1, 1, 2, 3, 3, 2])


def done(folder: Path, options: Options, stages: tuple[str, ...] = STAGES) -> Folder:
    trial = load(simulate("sit-to-stand", folder, replace(options, repetitions=2, analog_rate=100)))
    for stage in stages:
        assert run_stage(trial, stage).refused is None
    return Folder(trial.out)


def codes(tree: Any) -> dict[str, str]:
    return {reason.code: reason.level for reason in tree.reasons}


def contradict(
    labels: tuple[str, ...], segments: np.ndarray, names: tuple[str, ...], confidence: float
) -> tuple[Reason, ...]:
    out = Findings()
    check_marker_names(out, labels, segments, names, confidence)
    return tuple(out.reasons)


def test_names_that_agree_say_nothing() -> None:
    assert contradict(LABELS, SEGMENTS, NAMES, 0.9) == ()
    assert contradict(("A", "B", *LABELS[2:5]), SEGMENTS[:5] * 0, NAMES, 0.9) == ()  # too few known names


@pytest.mark.parametrize(("confidence", "level"), [(0.95, "ok"), (0.6, "caution")])
def test_a_name_against_the_motion_is_named(confidence: float, level: str) -> None:
    moved = SEGMENTS.copy()
    moved[[3, 5]] = 2, 1
    (reason,) = contradict(LABELS, moved, NAMES, confidence)
    assert reason.level == level
    assert reason.value == 2
    assert "LTIB is on the thigh, but by its name on the shank" in reason.message
    assert "L.THI is on the shank" in reason.message
    assert "RKNE" not in reason.message


def test_a_marker_on_no_segment_or_on_the_ground_contradicts_nothing() -> None:
    moved = SEGMENTS + 1
    moved[[0, 3]] = 0, -1
    assert contradict(LABELS, moved, ("ground", *NAMES), 0.9) == ()


def test_a_swap_is_said_once(tmp_path: Path) -> None:
    run = done(tmp_path / "trial", Options(seed=998900, faults=FaultOptions(mislabelled_s=2)), STAGES[:2])
    assert "marker-swap" in codes(run.read("planar.parquet"))
    segments = run.read("segments.parquet")
    assert "marker-elsewhere" not in codes(segments)
    assert {stretch["how"] for stretch in segments.facts["bad_stretches"]} == {"swapped"}


def test_the_foot_of_a_single_marker_chain_comes_from_the_reference(tmp_path: Path) -> None:
    """The torque of the ankle then has a small standard deviation, and its error is within it."""
    run = done(tmp_path / "trial", Options(seed=998901, marker_set="joints"))
    tree, table = run.read("dynamics.h5"), run.read("dynamics.parquet")
    assert codes(tree)["foot-prior"] == "ok"
    sd = table["sd_tau_1"][table["in_fit"]]
    assert np.sqrt(np.nanmean(sd**2)) < 4.5
    truth = json.loads((tmp_path / "trial" / "truth.json").read_text())
    with np.load(tmp_path / "trial" / "truth.npz") as arrays:
        at = np.searchsorted(arrays["t"], table["time"] - 1e-6)
        true = arrays["tau"][at, 0]
    off_seat = np.any([(table["time"] > r["seat_off"]) & (table["time"] < r["seat_on"]) for r in truth["reps"]], axis=0)
    error = np.abs(table["tau_1"]) - np.abs(true)
    assert np.sqrt(np.nanmean(error[off_seat] ** 2)) < 5.0


@pytest.mark.parametrize(
    ("options", "parameters"),
    [(Options(seed=998903), False), (Options(seed=1230023, marker_set="plug-in-gait", knee_on_shank=True), True)],
)
def test_few_places_of_markers_on_a_segment_need_the_prior_of_the_foot(
    tmp_path: Path, options: Options, parameters: bool
) -> None:
    """Otherwise only the torques use it."""
    run = done(tmp_path / "trial", options)
    assert run.read("chain.h5").facts["single_markers"] is False
    tree = run.read("dynamics.h5")
    (note,) = (reason for reason in tree.reasons if reason.code == "foot-prior")
    assert ("the torques also use" in note.message) != parameters
    assert tree.facts["reference_pulls"] == parameters


def test_torques_are_uncertain_where_the_model_does_not_follow_the_plate(tmp_path: Path) -> None:
    """Both shoulders are missing while the person sits down, and the pelvis alone hardly shows the trunk's angle."""
    run = done(tmp_path / "trial", Options(seed=1230029, marker_set="joints"))
    (reason,) = (reason for reason in run.read("dynamics.h5").reasons if reason.code == "torque-uncertain")
    assert "from the plate around 13.5 s" in reason.message
    assert reason.value is not None
    assert reason.value > 5.0


@pytest.mark.slow
def test_a_long_rest_does_not_change_the_process_noise(tmp_path: Path) -> None:
    noise = []
    for rest in (0.0, 60.0):
        run = done(tmp_path / f"{rest:g}", Options(seed=998902, rest_standing=rest), STAGES[:4])
        noise.append(np.array(run.read("states.parquet").facts["sigma_v"]))
    np.testing.assert_allclose(noise[1], noise[0], rtol=0.35)
