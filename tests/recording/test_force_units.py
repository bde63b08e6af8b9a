"""Units of force plates: declared ones are converted, missing ones assumed with a note, wrong ones refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_cases import CORNERS, body, build_c3d, plate_parameters, save, signals, standing_wrench

from mocap_id import recording
from mocap_id.errors import ConfigError
from mocap_id.recording.model import find_force_scale, find_moment_scale
from mocap_id.stages.base import Context
from mocap_id.stages.planarise import STAGE, PlanariseSettings
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import LongTable, Table

FRAMES, PER_FRAME = 30, 5
FORCE, MOMENT = standing_wrench(FRAMES * PER_FRAME, CORNERS)
SI = signals(FORCE, MOMENT, CORNERS, 500.0).channels
POUND, FOOT, INCH = 4.4482216152605, 0.3048, 0.0254


def write(folder: Path, analog: np.ndarray, units: list[str] | None, kind: int = 2, **more: Any) -> Path:
    declared = {} if units is None else {"ANALOG:UNITS": units}
    parameters = declared | plate_parameters(kind, range(1, analog.shape[1] + 1), **more)
    return save(folder, build_c3d(body(FRAMES) * 1e3, analog=analog, parameters=parameters))


def agree(plate: recording.Plate) -> None:
    assert plate.usable, plate.problem
    np.testing.assert_allclose(plate.force, FORCE, atol=1e-3)
    np.testing.assert_allclose(plate.moment, MOMENT, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "newtons"),
    [
        *((name, 1.0) for name in ("N", "n", "nt  ", "Newtons\0", "NEWTON", "Newt")),
        ("kN", 1e3),
        ("mN", 1e-3),
        ("daN", 10.0),
        *((name, POUND) for name in ("lbf", "LB", "pounds")),
        ("kgf", 9.80665),
        *((name, None) for name in ("", "V", "MN", "kg", "Nmm", "bits", "uV")),
    ],
)
def test_units_of_force(name: str, newtons: float | None) -> None:
    assert find_force_scale(name) == (None if newtons is None else pytest.approx(newtons))


@pytest.mark.parametrize(
    ("name", "newton_metres"),
    [
        *((name, 1.0) for name in ("Nm", "N.m", "N m", "N-m", "N·m", "Newton-meters", "m*N")),
        *((name, 1e-3) for name in ("Nmm", "ntmm", "N.mm", "NMM", "mm N", "mNm")),
        ("Ncm", 1e-2),
        ("kNm", 1e3),
        *((name, POUND * FOOT) for name in ("ftlb", "ft-lbs", "lbf.ft", "foot-pounds", "lb ft")),
        *((name, POUND * INCH) for name in ("in-lb", "inlbf", "lbf in")),
        *((name, None) for name in ("", "V", "N", "mN", "mm", "Nkm", "lbf")),
    ],
)
def test_units_of_moment(name: str, newton_metres: float | None) -> None:
    assert find_moment_scale(name) == (None if newton_metres is None else pytest.approx(newton_metres))


@pytest.mark.parametrize(
    ("units", "scales"),
    [
        (["lbf"] * 3 + ["ftlb"] * 3, [POUND] * 3 + [POUND * FOOT] * 3),
        (["kN"] * 3 + ["kN.m"] * 3, [1e3] * 6),
        (["mN"] * 3 + ["mN.m"] * 3, [1e-3] * 6),
        (["N"] * 3 + ["in.lbf"] * 3, [1.0] * 3 + [POUND * INCH] * 3),
    ],
)
def test_foreign_units_are_converted(tmp_path: Path, units: list[str], scales: list[float]) -> None:
    found = recording.read(write(tmp_path, SI / scales, units))
    agree(found.plates[0])
    assert found.plates[0].assumptions == found.oddities == ()


def test_channels_of_different_units_are_converted_one_by_one(tmp_path: Path) -> None:
    units = ["N", "lbf", "kN", "Nm", "Nmm", "Nm"]
    found = recording.read(write(tmp_path, SI / [1, POUND, 1e3, 1, 1e-3, 1], units))
    agree(found.plates[0])
    assert sum("declare different units" in oddity for oddity in found.oddities) == 2


def test_sensors_of_a_type_3_plate_are_converted(tmp_path: Path) -> None:
    analog = np.tile([0.0, 0, 0, 0, -0.1, -0.1, -0.1, -0.1], (FRAMES * PER_FRAME, 1))
    found = recording.read(write(tmp_path, analog, ["kN"] * 8, 3, origin=np.array([0.12, 0.2, -0.045])))
    np.testing.assert_allclose(found.plates[0].force[:, 2], 400.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("units", "reason"),
    [
        (["N", "lbf", "V", "Nmm", "Nmm", "Nmm"], "force channels declare 'V'"),
        (["V"] * 6, "force channels declare 'V'"),
        (["N", "N", "N", "furlong", "Nmm", "Nmm"], "moment channels declare 'furlong'"),
        (["N", "N", "N", "N", "Nmm", "Nmm"], "moment channels declare 'N'"),
        (["lbf"] * 6, "moment channels declare 'lbf'"),
        (["lbf"] * 3 + [""] * 3, "its forces are not in N"),
        (["N", "lbf", "", "Nmm", "Nmm", "Nmm"], "some of its force channels declare no unit"),
    ],
)
def test_unknown_units_make_the_plate_unusable(tmp_path: Path, units: list[str], reason: str) -> None:
    found = recording.read(write(tmp_path, SI, units))
    assert reason in found.plates[0].problem
    assert "_unit: …" in found.plates[0].problem
    assert not found.plates[0].ok.any()
    assert any("plate 1 is not used" in oddity for oddity in found.oddities)


@pytest.mark.parametrize("units", [None, ["N"] * 6, ["N", "N", "", "", "Nmm", "Nmm"]])
def test_missing_units_are_assumed_with_a_caution(tmp_path: Path, units: list[str] | None) -> None:
    """This includes files in which all channels, also the moments, declare N."""
    path = write(tmp_path, SI / [1, 1, 1, 1e-3, 1e-3, 1e-3], units)
    found = recording.read(path)
    agree(found.plates[0])
    assert len(found.plates[0].assumptions) == (1 if units == ["N"] * 6 else 2)
    assert set(found.plates[0].assumptions) <= set(found.oddities)
    planar, wrench = planarised(path)
    cautions = [reason for reason in wrench.reasons if reason.code == "plate-unit-assumed"]
    assert len(cautions) == len(found.plates[0].assumptions)
    assert all(reason.level == "caution" and "force_unit" in reason.message for reason in cautions)
    assert not any("was assumed" in reason.message for reason in planar.reasons)


def planarised(path: Path, **settings: Any) -> tuple[LongTable, Table]:
    trial = TrialKeys(trial="t", recording=Files(markers=path))
    planar, wrench = STAGE.function(Context(trial, PlanariseSettings(**settings), {}))
    assert isinstance(planar, LongTable)
    assert isinstance(wrench, Table)
    return planar, wrench


@pytest.mark.parametrize("units", [None, ["V"] * 6, ["N"] * 3 + ["Nmm"] * 3])
def test_the_configured_unit_has_priority(tmp_path: Path, units: list[str] | None) -> None:
    """The declared unit may be missing, unknown, or wrong, which is reported."""
    path = write(tmp_path, SI / ([POUND] * 3 + [POUND * FOOT] * 3), units)
    found = recording.read(path, force_unit="lbf", moment_unit="lbf.ft")
    agree(found.plates[0])
    assert found.plates[0].assumptions == ()
    assert any("the configuration says lbf" in oddity for oddity in found.oddities) is (units is not None)
    _, wrench = planarised(path, force_unit="lbf", moment_unit="lbf.ft")
    assert not [reason for reason in wrench.reasons if reason.code == "plate-unit-assumed"]
    assert wrench.frame["Fy"].mean() == pytest.approx(FORCE[:, 2].mean(), abs=1)


def test_a_calibration_matrix_has_its_own_units(tmp_path: Path) -> None:
    """Channels of type 4 declare V; configured units are ignored with a note."""
    matrix = np.diag([500.0, 500, 1000, 3e5, 3e5, 1.5e5])
    volts = SI * [1, 1, 1, 1e3, 1e3, 1e3] / np.diag(matrix)
    path = write(tmp_path, volts, ["V"] * 6, 4, CAL_MATRIX=matrix[:, :, None])
    agree(recording.read(path).plates[0])
    found = recording.read(path, force_unit="lbf")
    agree(found.plates[0])
    assert any("CAL_MATRIX" in oddity for oddity in found.oddities)


@pytest.mark.parametrize(("keys", "expected"), [({"force_unit": "V"}, "force_unit"), ({"moment_unit": "N"}, "moment")])
def test_an_unknown_configured_unit_is_refused(tmp_path: Path, keys: dict[str, str], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        recording.read(write(tmp_path, SI, None), **keys)
