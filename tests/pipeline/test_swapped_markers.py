"""A recording with two swapped markers, through the first stage and through all stages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id import recording
from mocap_id.config import load
from mocap_id.runner import run
from mocap_id.stages.base import Context
from mocap_id.stages.planarise import STAGE, PlanariseSettings
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import LongTable
from mocap_id_simulation import Options, generate

FIRST, START, STOP = 11, 400, 900  # the file's first frame; frames of the array in which the labels are exchanged
SWAPPED = ("LTHI", "LTIB2")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same trial with correct labels, and with two labels swapped for five seconds."""
    one = generate("sit-to-stand", Options(seed=4, repetitions=3))
    labels = list(one.scene.markers.labels)
    columns = [labels.index(name) for name in SWAPPED]
    raw = one.points.copy()
    raw[START:STOP, columns] = one.points[START:STOP, columns[::-1]]
    folder = tmp_path_factory.mktemp("swapped")
    for name, points in (("right", one.points), ("swapped", raw)):
        recording.write_c3d(folder / f"{name}.c3d", labels, points, 100.0, first_frame=FIRST)
    return folder / "right.c3d", folder / "swapped.c3d"


def planarised(path: Path, **settings: Any) -> LongTable:
    trial = TrialKeys(trial="t", recording=Files(markers=path), protocol="sit-to-stand")
    planar = STAGE.function(Context(trial, PlanariseSettings(**settings), {}))[0]
    assert isinstance(planar, LongTable)
    return planar


def test_a_swap_is_a_caution_that_names_it(files: tuple[Path, Path]) -> None:
    right, swapped = files
    clean, planar = planarised(right), planarised(swapped)
    assert clean.facts["swaps"] == []
    assert "marker-swap" not in {reason.code for reason in clean.reasons}
    (swap,) = planar.facts["swaps"]
    assert swap["labels"] == list(SWAPPED)
    assert (swap["first_frame"], swap["last_frame"]) == (FIRST + START, FIRST + STOP - 1)
    times = planar.frame.drop_duplicates("frame").set_index("frame")["time"]
    assert swap["first_s"] == times[FIRST + START]
    assert swap["last_s"] == times[FIRST + STOP - 1]
    assert swap["repaired"] is False
    (reason,) = (reason for reason in planar.reasons if reason.code == "marker-swap")
    assert reason.level == "caution"
    assert reason.value == 1
    for part in (*SWAPPED, "once", str(FIRST + START), str(FIRST + STOP - 1), "repair_swaps: true"):
        assert part in reason.message


def test_the_repaired_trial_equals_the_original(files: tuple[Path, Path]) -> None:
    right, swapped = files
    before = swapped.read_bytes()
    clean, planar = planarised(right), planarised(swapped, repair_swaps=True)
    assert swapped.read_bytes() == before
    np.testing.assert_array_equal(planar.frame[["x", "y", "z"]], clean.frame[["x", "y", "z"]])
    assert [swap["repaired"] for swap in planar.facts["swaps"]] == [True]
    (reason,) = (reason for reason in planar.reasons if reason.code == "marker-swap")
    assert reason.level == "ok"
    assert "were corrected" in reason.message


def test_the_verdict_of_the_whole_trial_says_so(files: tuple[Path, Path], tmp_path: Path) -> None:
    outcomes = {}
    for name, path, settings in (
        ("right", files[0], {}),
        ("swapped", files[1], {}),
        ("repaired", files[1], {"repair_swaps": True}),
    ):
        yaml = tmp_path / f"{name}.yaml"
        keys = {"trial": name, "recording": str(path), "protocol": "sit-to-stand", "planarise": settings}
        yaml.write_text(json.dumps(keys))
        outcomes[name] = dict(run(load(yaml)).summary())
    levels = {}
    for name, summary in outcomes.items():
        told = summary["verdict"]["reasons"] + summary["verdict"]["notes"]
        levels[name] = {reason["code"]: reason["level"] for reason in told}.get("marker-swap")
    assert levels == {"right": None, "swapped": "caution", "repaired": "ok"}
    assert outcomes["swapped"]["verdict"]["level"] != "ok"
    assert outcomes["repaired"]["segments"] == outcomes["right"]["segments"]
    assert outcomes["repaired"]["lengths_m"] == outcomes["right"]["lengths_m"]
