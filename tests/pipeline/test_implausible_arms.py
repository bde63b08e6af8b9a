"""Arms that cannot be: exchanged landmarks, a wrong vertical axis, a wrong unit and frozen markers are reported."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.recording import read
from mocap_id.recording.writer import write_c3d
from mocap_id.runner import run
from mocap_id.runner.execution import run_to
from mocap_id.stages.fit_joints.anatomy import check_lengths
from mocap_id.store import Folder
from mocap_id.verdict import Reason
from mocap_id_simulation import ArmOptions, write_arm


@pytest.fixture(scope="module")
def arm(once: Callable[[str, Callable[[Path], Any]], Any]) -> Path:
    found: Path = once("arm-to-spoil", lambda folder: write_arm(folder / "arm", ArmOptions(seed=301_011, cycles=1)))
    return found


def variant(arm: Path, name: str, text: str) -> Path:
    """Return another configuration beside that of the arm, with more lines."""
    file = arm.with_name(f"{name}.yaml")
    file.write_text(f"{arm.read_text('utf-8')}\n{text}\nout: runs/{name}\n", "utf-8")
    return file


def doubts(folder: Path, *files: str) -> list[Reason]:
    return [
        reason
        for file in files
        for reason in Folder(folder).read(file).reasons
        if reason.code in ("landmarks-implausible", "motion-implausible")
    ]


def test_a_right_arm_is_not_doubted(arm: Path) -> None:
    assert not doubts(run(load(variant(arm, "right", ""))).folder, "chain.h5", "states.parquet")


@pytest.mark.parametrize(
    ("exchanged", "said"),
    [
        ("C7: T8, T8: C7", "C7 is"),
        pytest.param("IJ: PX, PX: IJ", "IJ is", marks=pytest.mark.slow),
        ("IJ: C7, C7: IJ", "other side of the thorax"),
        pytest.param("AC: C7, C7: AC", "out of one plane", marks=pytest.mark.slow),
        pytest.param("EL: FOR2", "midpoint of EL and EM", marks=pytest.mark.slow),
    ],
)
def test_exchanged_landmarks_are_reported(arm: Path, exchanged: str, said: str) -> None:
    file = variant(arm, "".join(c for c in exchanged if c.isalnum()), f"landmarks: {{{exchanged}}}")
    found = doubts(run_to(load(file), "fit-joints").folder, "chain.h5")
    assert len(found) == 1
    assert said in found[0].message


@pytest.mark.parametrize(("scale", "wrong"), [(1.0, 0), (2.54, 2), (1 / 2.54, 2)])
def test_lengths_in_a_wrong_unit_are_reported(scale: float, wrong: int) -> None:
    found = check_lengths({"upper_arm": 0.30 * scale, "forearm": 0.26 * scale})
    assert len(found) == wrong


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        pytest.param("vertical", "planarise: {vertical: X}", "the thorax leans", marks=pytest.mark.slow),
        ("wrist", "landmarks: {RS: US, US: RS}", "RS and US are probably exchanged"),
    ],
)
def test_what_only_the_motion_shows_is_reported(arm: Path, name: str, text: str, said: str) -> None:
    found = doubts(run_to(load(variant(arm, name, text)), "ukf-smooth").folder, "states.parquet")
    assert said in found[0].message


def held(arm: Path, name: str, noise: float) -> tuple[Path, FloatArray]:
    """Return a trial in which two markers of the upper arm stay where they are for 1.5 s, and its true flexion."""
    recording = read(arm.with_name("trial.c3d"))
    points, rng = recording.positions.copy(), np.random.default_rng(1)
    for label in ("EL", "UPA1"):
        column = recording.labels.index(label)
        points[800:980, column] = points[800, column] + noise * rng.normal(size=(180, 3))
    folder = arm.parent.parent / name
    folder.mkdir(exist_ok=True)
    write_c3d(folder / "trial.c3d", recording.labels, points, recording.rate)
    text = [line for line in arm.read_text("utf-8").splitlines() if not line.startswith("imus")]
    (folder / "trial.yaml").write_text("\n".join([*text, ""]), "utf-8")
    with np.load(arm.with_name("truth.npz")) as arrays:
        return folder / "trial.yaml", np.degrees(arrays["isb_elbow"][:, 0])


def test_markers_that_repeat_their_position_are_left_out(arm: Path) -> None:
    file, flexion = held(arm, "frozen", 0.0)
    folder = run(load(file)).folder
    summary = json.loads((folder / "summary.json").read_text("utf-8"))
    found = [one["code"] for level in ("reasons", "notes") for one in summary["verdict"][level]]
    assert "samples-held" in found
    off = np.degrees(Folder(folder).read("angles.parquet")["elbow_flexion"]) - flexion
    assert np.sqrt(np.nanmean(off**2)) < 2


@pytest.mark.slow
def test_the_filter_does_not_run_away(arm: Path) -> None:
    """Noise of 0.1 mm hides that the position is repeated; the wrong chain then made rates of 1e25 rad/s."""
    file, _ = held(arm, "held", 1e-4)
    folder = run(load(file)).folder
    poses = Folder(folder).read("poses.parquet")
    rates = poses.stack([name for name in poses.names if "_omega_" in name and not name.startswith("sd_")])
    assert np.nanmax(np.abs(rates)) < 200
