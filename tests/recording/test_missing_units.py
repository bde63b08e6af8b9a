"""A file without a length unit: `inspect` shows what it holds, and a run refuses it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from recording_cases import CORNERS, body, build_c3d, plate_parameters, save, signals, standing_wrench

from mocap_id import recording
from mocap_id.errors import RecordingError

FRAMES = 60
POSITIONS = body(FRAMES)
FORCE, MOMENT = standing_wrench(5 * FRAMES, CORNERS)


@pytest.fixture
def trials(tmp_path: Path) -> dict[str, Path]:
    """The same trial as TRC and as C3D, in mm but without a unit."""
    recording.write_trc(tmp_path / "sts.trc", [f"M{k}" for k in range(5)], POSITIONS, 100.0)
    text = (tmp_path / "sts.trc").read_text()
    (tmp_path / "sts.trc").write_text(text.replace("\tmm\t", "\t\t"))
    channels = signals(FORCE, MOMENT, CORNERS, 500.0).channels * [1, 1, 1, 1e3, 1e3, 1e3]
    units = {"POINT:UNITS": "", "ANALOG:UNITS": ["N", "N", "N", "Nmm", "Nmm", "Nmm"]}
    data = build_c3d(POSITIONS * 1e3, analog=channels, parameters=units | plate_parameters(2, range(1, 7)))
    return {"TRC": tmp_path / "sts.trc", "C3D": save(tmp_path, data)}


@pytest.mark.parametrize("form", ["TRC", "C3D"])
def test_inspect_shows_the_content(cli, trials: dict[str, Path], form: str) -> None:
    said = cli("inspect", trials[form], "--json")
    assert said.code == 0
    found = json.loads(said.out)
    assert found["format"].startswith(form)
    assert found["units"] is None
    assert (found["frames"], len(found["markers"]), found["missing_fraction"]) == (FRAMES, 5, 0)
    assert any("no length unit: a run needs it, `planarise: {units: mm}`" in note for note in found["oddities"])
    assert any("mm gives 1." in note or "mm gives 0." in note for note in found["oddities"])
    if form == "C3D":
        assert found["mass_kg"] == pytest.approx(FORCE[:, 2].mean() / 9.81, rel=1e-3)
    assert "not declared" in cli("inspect", trials[form]).out


@pytest.mark.parametrize("form", ["TRC", "C3D"])
def test_a_run_needs_the_unit(trials: dict[str, Path], form: str) -> None:
    with pytest.raises(RecordingError, match="no length unit; set `planarise:"):
        recording.read(trials[form])
    found = recording.read(trials[form], units="mm", vertical="Z")
    axes = [0, 1, 2] if form == "C3D" else [0, 2, 1]
    np.testing.assert_allclose(np.abs(found.positions), np.abs(POSITIONS[..., axes]), atol=1e-4)


def test_a_stated_unit_is_still_checked(cli, tmp_path: Path) -> None:
    recording.write_trc(tmp_path / "sts.trc", [f"M{k}" for k in range(5)], POSITIONS * 1000, 100.0)
    said = cli("inspect", tmp_path / "sts.trc")
    assert said.code != 0
    assert "the unit is wrong" in said.err
