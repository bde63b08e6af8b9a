"""Force plates of every type and special cases of C3D files, compared with known wrenches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_cases import CORNERS, ORIGIN, body, build_c3d, plate_parameters, save, signals, standing_wrench

from mocap_id import recording
from mocap_id.recording.lab_plates import compute_centre_of_pressure, compute_plate_axes

FRAMES, PER_FRAME = 30, 5
FORCE, MOMENT = standing_wrench(FRAMES * PER_FRAME, CORNERS)
CHANNELS = signals(FORCE, MOMENT, CORNERS, 500.0).channels * [1, 1, 1, 1e3, 1e3, 1e3]
"""Channels of a type 2 plate, N and N·mm."""

UNITS = {"ANALOG:UNITS": ["N", "N", "N", "Nmm", "Nmm", "Nmm"]}


def read(folder: Path, analog: np.ndarray, parameters: dict[str, Any], **build: Any) -> recording.Recording:
    points = body(FRAMES) * 1e3
    return recording.read(save(folder, build_c3d(points, analog=analog, parameters=parameters, **build)))


def agree(plate: recording.Plate, force: float = 1e-3, moment: float = 1e-3) -> None:
    assert plate.usable, plate.problem
    np.testing.assert_allclose(plate.force, FORCE, atol=force)
    np.testing.assert_allclose(plate.moment, MOMENT, atol=moment)


def test_type_2(tmp_path: Path) -> None:
    found = read(tmp_path, CHANNELS, UNITS | plate_parameters(2, range(1, 7)))
    (plate,) = found.plates
    agree(plate)
    assert found.analog_rate == plate.rate == 500
    assert plate.kind == "type 2"
    assert found.oddities == ()


def test_channels_need_not_be_the_first_ones(tmp_path: Path) -> None:
    other = np.random.default_rng(0).normal(size=(len(CHANNELS), 3)) * 1e3
    analog = np.column_stack([other[:, :1], CHANNELS[:, ::-1], other[:, 1:]])
    units = {"ANALOG:UNITS": ["V", "Nmm", "Nmm", "Nmm", "N", "N", "N", "V", "V"]}
    agree(read(tmp_path, analog, units | plate_parameters(2, [7, 6, 5, 4, 3, 2])).plates[0])


def test_origin_of_the_wrong_sign_is_corrected_and_reported(tmp_path: Path) -> None:
    found = read(tmp_path, CHANNELS, UNITS | plate_parameters(2, range(1, 7), -ORIGIN))
    agree(found.plates[0])
    assert any("sign was corrected" in oddity for oddity in found.oddities)


def test_the_force_on_the_plate_is_reversed_and_reported(tmp_path: Path) -> None:
    found = read(tmp_path, -CHANNELS, UNITS | plate_parameters(2, range(1, 7)))
    agree(found.plates[0])
    assert any("reversed" in oddity for oddity in found.oddities)


def test_type_1(tmp_path: Path) -> None:
    surface = signals(FORCE, MOMENT, CORNERS, 500.0, np.zeros(3)).channels
    f, m = surface[:, :3], surface[:, 3:]
    cop = np.column_stack([-m[:, 1], m[:, 0]]) / f[:, 2:]
    free = m[:, 2] - (cop[:, 0] * f[:, 1] - cop[:, 1] * f[:, 0])
    analog = np.column_stack([f, cop * 1e3, free * 1e3])
    units = {"ANALOG:UNITS": ["N", "N", "N", "mm", "mm", "Nmm"]}
    agree(read(tmp_path, analog, units | plate_parameters(1, range(1, 7))).plates[0])


@pytest.mark.parametrize("height", [-0.045, 0.045])
def test_type_3(tmp_path: Path, height: float) -> None:
    a, b = 0.12, 0.2
    sensed = signals(FORCE, MOMENT, CORNERS, 500.0, np.array([0, 0, -0.045])).channels
    fx, fy, fz, mx, my, mz = sensed.T
    shear = mz / 2 / b  # one of many ways to spread the load over the sensors
    z1 = (fz + mx / b - my / a) / 4
    z2 = (fz + mx / b + my / a) / 4
    z3 = (fz - mx / b + my / a) / 4
    z4 = (fz - mx / b - my / a) / 4
    analog = np.column_stack([fx / 2 - shear, fx / 2 + shear, fy / 2, fy / 2, z1, z2, z3, z4])
    origin = np.array([a, b, height])
    parameters = {"ANALOG:UNITS": ["N"] * 8} | plate_parameters(3, range(1, 9), origin)
    agree(read(tmp_path, analog, parameters).plates[0])


def calibration(seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.diag([500.0, 500, 1000, 3e5, 3e5, 1.5e5]) @ (np.eye(6) + 0.01 * rng.normal(size=(6, 6)))


def test_type_4_is_calibrated_by_a_matrix_stored_column_by_column(tmp_path: Path) -> None:
    matrix = calibration()
    volts = np.linalg.solve(matrix, CHANNELS.T).T
    parameters = plate_parameters(4, range(1, 7), CAL_MATRIX=matrix[:, :, None])
    agree(read(tmp_path, volts, parameters).plates[0], 0.01, 0.01)


def test_type_2_ignores_a_matrix(tmp_path: Path) -> None:
    agree(
        read(tmp_path, CHANNELS, UNITS | plate_parameters(2, range(1, 7), CAL_MATRIX=calibration()[:, :, None])).plates[
            0
        ]
    )


def test_a_matrix_whose_diagonal_is_in_the_scales_is_applied_once(tmp_path: Path) -> None:
    per_volt = calibration() / np.array([1, 1, 1, 1e3, 1e3, 1e3])[:, None]  # N and N·m per volt
    volts = np.linalg.solve(per_volt, (CHANNELS / [1, 1, 1, 1e3, 1e3, 1e3]).T).T
    counts_per_volt = 3276.7
    scale = np.diag(per_volt) * [1, 1, 1, 1e3, 1e3, 1e3] / counts_per_volt
    parameters = {"ANALOG:SCALE": scale} | plate_parameters(4, range(1, 7), CAL_MATRIX=per_volt[:, :, None])
    found = read(tmp_path, volts * counts_per_volt, parameters)
    agree(found.plates[0], 0.05, 0.05)
    assert any("applied once" in oddity for oddity in found.oddities)


def test_offset_scale_and_unsigned_counts(tmp_path: Path) -> None:
    scale, general, offset = np.array([0.02, 0.02, 0.05, 8.0, 8.0, 8.0]), 0.5, np.full(6, 32768)
    counts = np.round(CHANNELS / (scale * general)) + offset
    assert counts.min() > 0
    assert counts.max() < 65536
    parameters = {
        "ANALOG:FORMAT": "UNSIGNED",
        "ANALOG:SCALE": scale,
        "ANALOG:GEN_SCALE": general,
        "ANALOG:OFFSET": offset - 65536,
        "ANALOG:BITS": np.array([16]),
    }
    found = read(tmp_path, counts, UNITS | parameters | plate_parameters(2, range(1, 7)), scale=0.05)
    agree(found.plates[0], 0.02, 0.02)


def test_moments_in_newton_metres(tmp_path: Path) -> None:
    units = {"ANALOG:UNITS": ["N", "N", "N", "N.m", "N.m", "N.m"]}
    agree(read(tmp_path, CHANNELS / [1, 1, 1, 1e3, 1e3, 1e3], units | plate_parameters(2, range(1, 7))).plates[0])


def test_undeclared_units_are_assumed_and_reported(tmp_path: Path) -> None:
    found = read(tmp_path, CHANNELS, plate_parameters(2, range(1, 7)))
    agree(found.plates[0])
    assert sum("was assumed" in oddity for oddity in found.oddities) == 2


def test_wrong_moment_units_show_in_the_centre_of_pressure(tmp_path: Path) -> None:
    units = {"ANALOG:UNITS": ["N", "N", "N", "Nm", "Nm", "Nm"]}
    found = read(tmp_path, CHANNELS, units | plate_parameters(2, range(1, 7)))
    assert any("lies off the plate" in oddity for oddity in found.oddities)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_unloaded_baseline_is_subtracted(tmp_path: Path, sign: float) -> None:
    """This includes an offset over a tenth of the peak with the opposite sign of loads."""
    offset = np.array([3.0, -2.0, sign * (20.0 if sign < 0 else 150.0), 900.0, 300.0, 50.0])
    analog = CHANNELS.copy()
    analog[: 10 * PER_FRAME] = 0
    zero = {"FORCE_PLATFORM:ZERO": np.array([1, 10])}
    found = read(tmp_path, analog + offset, UNITS | plate_parameters(2, range(1, 7)) | zero)
    np.testing.assert_allclose(found.plates[0].force[50:], FORCE[50:], atol=1e-3)
    np.testing.assert_allclose(found.plates[0].force[:50], 0, atol=1e-3)


def test_a_loaded_baseline_is_not_subtracted(tmp_path: Path) -> None:
    zero = {"FORCE_PLATFORM:ZERO": np.array([1, 10])}
    found = read(tmp_path, CHANNELS, UNITS | plate_parameters(2, range(1, 7)) | zero)
    agree(found.plates[0])
    assert any("(ZERO) are loaded" in oddity for oddity in found.oddities)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"FORCE_PLATFORM:CHANNEL": np.arange(2, 8)[:, None]}, "names channel 7, the file has 6"),
        ({"FORCE_PLATFORM:CHANNEL": np.array([1, 2, 3, 4, 5, 5])[:, None]}, "names a channel twice"),
        ({"FORCE_PLATFORM:CHANNEL": np.arange(1, 5)[:, None]}, "has 4 rows"),
        ({"FORCE_PLATFORM:TYPE": np.array([6])}, "type 6 is not supported"),
        ({"FORCE_PLATFORM:TYPE": np.array([4])}, "CAL_MATRIX is missing"),
        ({"FORCE_PLATFORM:CORNERS": np.zeros((3, 4, 1))}, "do not form a rectangle"),
        ({"FORCE_PLATFORM:CORNERS": (CORNERS[[0, 3, 2, 1]].T * 1e3)[:, :, None]}, "z axis point up"),
        ({"ANALOG:SCALE": np.ones(4)}, "is missing for some of its channels"),
    ],
)
def test_unusable_plates_say_why(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    parameters = UNITS | plate_parameters(2, range(1, 7)) | {"POINT:Y_SCREEN": "+Z"} | change
    found = read(tmp_path, CHANNELS, parameters)
    (plate,) = found.plates
    assert not plate.usable
    assert reason in plate.problem
    assert len(plate.ok) == len(plate.force) == FRAMES * PER_FRAME
    assert not plate.ok.any()
    assert np.isnan(plate.force).all()
    assert any("plate 1 is not used" in oddity for oddity in found.oddities)
    assert found.positions.shape[0] == FRAMES


def test_saturated_samples_are_not_ok(tmp_path: Path) -> None:
    scale = np.array([1.0, 1.0, 1.0, 100.0, 100.0, 100.0])
    counts = np.clip(np.round(CHANNELS / scale), -2048, 2047)
    counts[20:25, 2] = -2048
    counts[60, 4] = 2047
    parameters = {"ANALOG:SCALE": scale, "ANALOG:BITS": np.array([12])} | plate_parameters(2, range(1, 7))
    found = read(tmp_path, counts, UNITS | parameters, scale=0.05)
    assert np.flatnonzero(~found.plates[0].ok).tolist() == [20, 21, 22, 23, 24, 60]
    assert any("saturated" in oddity for oddity in found.oddities)


def test_clipping_shows_in_a_noisy_channel_without_counts(tmp_path: Path) -> None:
    limit = np.quantile(CHANNELS[:, 2], 0.05)
    analog = CHANNELS.copy()
    analog[40:60, 2] = limit - 0.123
    analog[:, 2] = np.maximum(analog[:, 2], limit - 0.123)
    found = read(tmp_path, analog, UNITS | plate_parameters(2, range(1, 7)))
    assert not found.plates[0].ok[40:60].any()
    assert found.plates[0].ok.sum() >= len(analog) - 30


def test_the_vertical_comes_from_the_plates(tmp_path: Path) -> None:
    """A file with Y up and a level plate gives the same lab."""
    to_y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    corners = CORNERS @ to_y_up.T
    parameters = UNITS | plate_parameters(2, range(1, 7)) | {"FORCE_PLATFORM:CORNERS": (corners.T * 1e3)[:, :, None]}
    points = body(FRAMES) * 1e3
    data = build_c3d(points @ to_y_up.T, analog=CHANNELS, parameters=parameters | {"POINT:Y_SCREEN": "+Z"})
    found = recording.read(save(tmp_path, data))
    assert found.vertical == "Y"
    assert any("force plates say Y" in oddity for oddity in found.oddities)
    np.testing.assert_allclose(found.positions, points / 1e3, atol=1e-6)
    agree(found.plates[0])


def test_the_centre_of_pressure_is_where_the_load_acts(tmp_path: Path) -> None:
    (plate,) = read(tmp_path, CHANNELS, UNITS | plate_parameters(2, range(1, 7))).plates
    point = compute_centre_of_pressure(plate, plate)
    arm = np.column_stack([point, np.zeros(len(point))])
    free = plate.moment - np.cross(arm, plate.force)
    np.testing.assert_allclose(free[:, :2], 0, atol=1e-3)
    assert np.abs(point).max() < 0.12


def test_plate_axes_are_a_right_handed_frame_with_z_down() -> None:
    axes = compute_plate_axes(CORNERS)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[2, 2] == pytest.approx(-1)


def test_another_reader_agrees(tmp_path: Path) -> None:
    """The force-plate filter of ezc3d gives the same for a plate without special cases."""
    import ezc3d

    path = save(
        tmp_path,
        build_c3d(body(FRAMES) * 1e3, analog=CHANNELS, parameters=UNITS | plate_parameters(2, range(1, 7))),
    )
    platform = ezc3d.c3d(str(path), extract_forceplat_data=True)["data"]["platform"][0]
    (plate,) = recording.read(path).plates
    np.testing.assert_allclose(plate.force, platform["force"].T, atol=1e-3)
    centre = platform["corners"].mean(axis=1) * 1e-3
    about_lab = platform["moment"].T * 1e-3 + np.cross(centre, platform["force"].T)
    np.testing.assert_allclose(plate.moment, about_lab, atol=1e-3)
