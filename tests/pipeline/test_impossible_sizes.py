"""Trials whose segments are almost certainly wrong, or have sizes that no person has, are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mocap_id
from mocap_id.config import load
from mocap_id.errors import Refused
from mocap_id.recording import Recording
from mocap_id.runner import run_to
from mocap_id.stages.fit_joints.plane import check_sizes
from mocap_id.stages.trial_keys import Subject
from mocap_id.workflows.recording_trial import make_trial
from mocap_id_simulation import Options, simulate

SAMPLE = Path(__file__).resolve().parents[2] / "sample_trials" / "sit-to-stand" / "trial.c3d"


def _fit(factor: float, out: Path, **keys: Any) -> Refused | None:
    """Return the refusal of the sample with all positions multiplied by a factor, up to the joint fit."""
    sample = mocap_id.read(SAMPLE)
    positions = factor * sample.positions[:1600:2]
    scaled = Recording.from_arrays(sample.labels, positions, sample.rate / 2)
    return run_to(make_trial(scaled, {"protocol": "sit-to-stand", "out": out, **keys}), "fit-joints").refused


@pytest.mark.parametrize("factor", [0.1, 1 / 2.54, 2.54, 10.0])
def test_a_wrong_unit_of_length_gives_no_person(factor: float, tmp_path: Path) -> None:
    refused = _fit(factor, tmp_path / "run")
    assert refused is not None
    assert refused.code == "size-impossible"
    assert "planarise: {units" in str(refused)


def test_lengths_must_fit_the_height(tmp_path: Path) -> None:
    assert _fit(1.0, tmp_path / "right") is None
    assert _fit(1.0, tmp_path / "right", subject={"height": 1.7}) is None
    refused = _fit(1.0, tmp_path / "wrong", subject={"height": 1.2})
    assert refused is not None
    assert "for a height of 1.2 m" in str(refused)


def test_a_thigh_is_not_called_shank(tmp_path: Path) -> None:
    file = simulate(
        "sit-to-stand",
        tmp_path / "trial",
        Options(seed=9600, repetitions=2, marker_set="plug-in-gait", without="LKNE,RKNE"),
    )
    refused = run_to(load(file), "fit-joints").refused
    assert refused is not None
    assert refused.code == "size-impossible"
    assert "ankle is 0.4" in str(refused)


@pytest.mark.parametrize(
    ("lengths", "subject", "refused"),
    [
        ({"shank": 0.42, "thigh": 0.41}, {}, None),
        ({"shank": 0.42, "thigh": 0.41}, {"height": 1.7}, None),
        ({"shank": 1.78}, {"height": 1.85}, "shank is 1.78 m long, expected 0.34 to 0.57 m"),
        ({"shank": 1.78}, {}, "shank is 1.78 m long, expected 0.20 to 0.62 m in any person"),
        ({"shank": 0.42, "thigh": 0.60}, {}, "thigh is 0.60 m long, expected 0.31 to 0.52 m beside a shank of 0.42 m"),
        ({"shank": 0.42, "thigh": 0.30}, {"height": 1.7}, "thigh is 0.30 m long"),
        ({"shank": 0.55, "thigh": 0.42}, {"height": 1.7}, "shank is 0.55 m long"),
        ({"shank": 0.16, "thigh": 0.17}, {}, "in any person"),
        ({"shank": 0.16, "thigh": 0.17}, {"height": 0.68}, None),
        ({"shank": 0.44, "thigh": 0.32}, {"height": 1.74, "sex": "female"}, None),
        ({"shank": 0.42, "thigh": 0.41, "pelvis": 0.62}, {"height": 1.86}, None),
        (
            {"shank": 0.42, "thigh": 0.41, "pelvis": 0.92},
            {"height": 1.86},
            "pelvis is 0.92 m long, expected at most 0.74",
        ),
        ({"shank": 0.42, "thigh": 0.41, "pelvis": 0.92}, {}, "pelvis is 0.92 m long, expected at most 0.84 m"),
        ({"foot": 0.12, "pelvis": 0.02, "segment 1": 3.0}, {}, None),
    ],
)
def test_lengths_of_a_leg(lengths: dict[str, float], subject: dict[str, Any], refused: str | None) -> None:
    sizes = {name: (length, 0.002) for name, length in lengths.items()}
    if refused is None:
        check_sizes(sizes, Subject(**subject))
        return
    with pytest.raises(Refused, match=refused):
        check_sizes(sizes, Subject(**subject))
    check_sizes({name: (length, 1.0) for name, length in lengths.items()}, Subject(**subject))  # hardly known


@pytest.mark.recordings
def test_segments_that_are_almost_certainly_wrong_are_refused(recordings: Path, tmp_path: Path) -> None:
    file = recordings / "c3d" / "stoop1_t169_f620f800.c3d"
    keys: dict[str, Any] = {"protocol": "sit-to-stand"}
    refused = run_to(make_trial(file, {**keys, "out": tmp_path / "own"}), "segment").refused
    assert refused is not None
    assert (refused.code, refused.limit) == ("segments-unsure", 1e-3)
    assert refused.value is not None
    assert refused.value < 1e-3
    given = make_trial(file, {**keys, "segment": {"count": 5}, "out": tmp_path / "given"})
    assert run_to(given, "segment").refused is None
