"""Reaches of a recorded left arm against the ranges of another program (ULEMA)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.runner import run

pytestmark = pytest.mark.recordings

POINTERS = {"IJ": "IJ", "PX": "PX", "C7": "C7", "T8": "T8", "EL": "LEL", "EM": "LEM", "RS": "LRS", "US": "LUS"}
TRIAL = """\
trial: {name}
space: 3d
protocol: reach
side: left
recording: {folder}/{name}.c3d
planarise: {{ignore: ['CH*', LEL, LEM, LRS, LUS, 'LMC*', LGH, 'LA?', LTS, LPC, C7, T8, IJ, PX]}}
segment: {{names: [thorax, girdle, upper_arm, forearm, hand]}}
pointer: {{P1: 0.4575, P2: 0.369, P3: 0.266, P4: 0.1475}}
pointers: {{{pointers}}}
"""
THEIRS = {
    "shoulder_plane": "LElevationplaneH1",
    "shoulder_elevation": "LShoulderElevationH1",
    "shoulder_axial": "LShoulderRotationH1",
}


@pytest.mark.parametrize(("name", "volume"), [("RF1", (0.001, 0.01)), ("HTH1", (0.005, 0.05))])
def test_ranges_are_those_of_the_other_program(
    recordings: Path, tmp_path: Path, name: str, volume: tuple[float, float]
) -> None:
    folder = recordings / "upper-limb" / "ulema"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")
    pointers = ", ".join(f"{landmark}: {folder}/cal{file}.c3d" for landmark, file in POINTERS.items())
    configuration = tmp_path / f"{name}.yaml"
    configuration.write_text(TRIAL.format(name=name, folder=folder, pointers=pointers))
    outcome = run(load(configuration))
    found = json.loads((outcome.folder / "summary.json").read_text())["workspace"]
    rows = (line.rstrip("\t").split("\t") for line in _lines(folder / f"{name}_angles.csv"))
    printed = {row[0]: np.sort(np.array(row[1:], dtype=float)) for row in rows}
    for ours, theirs in THEIRS.items():
        values = printed[theirs]
        assert found["ranges"][ours]["range_deg"] == pytest.approx(values[-5] - values[4], abs=5), ours
    assert volume[0] < found["volume_m3"] < volume[1]  # one movement only, repeated
    assert found["interval_m3"][0] <= found["volume_m3"] <= found["interval_m3"][1]


def _lines(file: Path) -> list[str]:
    """Return the lines of the angles in every frame; those after them are resampled."""
    return file.read_text(encoding="latin-1").splitlines()[1:29]
