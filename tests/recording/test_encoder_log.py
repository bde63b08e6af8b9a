"""Encoder logs are read by the names of their columns, or refused with the cause and a remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_id.errors import RecordingError
from mocap_id.recording import read_encoder

TIME = np.arange(200) / 125.0
COLUMNS = {
    "time_s": TIME,
    "position_rad": np.sin(2 * TIME),
    "velocity_rad_s": 2 * np.cos(2 * TIME),
    "torque_Nm": 3 * np.sin(2 * TIME),
}


def written(folder: Path, columns: dict[str, object]) -> Path:
    rows = zip(*(np.asarray(values, dtype=object) for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(str(value) for value in row) for row in rows)]
    path = folder / "encoder.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_values_are_those_of_the_file_in_any_order_of_columns(tmp_path: Path) -> None:
    log = read_encoder(written(tmp_path, dict(reversed(COLUMNS.items()))))
    np.testing.assert_allclose(log.position, COLUMNS["position_rad"])
    np.testing.assert_allclose(log.velocity, COLUMNS["velocity_rad_s"])
    assert log.torque is not None
    np.testing.assert_allclose(log.torque, COLUMNS["torque_Nm"])
    assert log.rate == pytest.approx(125.0)


def test_torque_is_optional_and_may_have_empty_cells(tmp_path: Path) -> None:
    torque: list[object] = list(COLUMNS["torque_Nm"])
    torque[3] = ""
    found = read_encoder(written(tmp_path, {**COLUMNS, "torque_Nm": torque})).torque
    assert found is not None and np.isnan(found[3]) and np.isfinite(found[4:]).all()
    assert read_encoder(written(tmp_path, {k: v for k, v in COLUMNS.items() if k != "torque_Nm"})).torque is None


def with_cell(name: str, row: int, value: object) -> dict[str, object]:
    changed: list[object] = list(COLUMNS[name])
    changed[row] = value
    return {**COLUMNS, name: changed}


def renamed(old: str, new: str) -> dict[str, object]:
    return {new if name == old else name: values for name, values in COLUMNS.items()}


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (renamed("position_rad", "position_deg"), ["position_deg", "expected time_s, position_rad"]),
        ({"time_s": TIME, "position_rad": TIME}, ["expected", "velocity_rad_s"]),
        ({**COLUMNS, "current_A": TIME}, ["current_A", "remove all other columns"]),
        (with_cell("velocity_rad_s", 7, ""), ["`velocity_rad_s` has no number in line 9", "1 such"]),
        (with_cell("position_rad", 7, "nan"), ["`position_rad` has no number in line 9"]),
        (with_cell("position_rad", 7, "broken"), ["`position_rad` is 'broken' in line 9", "expected a number"]),
        (with_cell("time_s", 20, 0.05), ["does not increase", "0.05 follows 0.152"]),
        ({name: values[:5] for name, values in COLUMNS.items()}, ["5 rows", "expected at least 20"]),
        ({**COLUMNS, "position_rad": np.degrees(COLUMNS["position_rad"])}, ["57.3 times", "position in degrees"]),
        ({**COLUMNS, "velocity_rad_s": np.degrees(COLUMNS["velocity_rad_s"])}, ["0.0175 times", "velocity in degrees"]),
        ({**COLUMNS, "time_s": 1000 * TIME}, ["milliseconds"]),
        ({**COLUMNS, "velocity_rad_s": -COLUMNS["velocity_rad_s"]}, ["-1 times", "another joint or direction"]),
        ({**COLUMNS, "velocity_rad_s": np.cos(9 * TIME)}, ["another joint or direction"]),
    ],
)  # fmt: skip
def test_wrong_files_are_refused_with_the_cause(tmp_path: Path, columns: dict[str, object], words: list[str]) -> None:
    path = written(tmp_path, columns)
    with pytest.raises(RecordingError) as caught:
        read_encoder(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_the_velocity_of_a_joint_at_rest_is_not_checked(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 1e-3, (2, len(TIME)))
    log = read_encoder(written(tmp_path, {"time_s": TIME, "position_rad": noise[0], "velocity_rad_s": noise[1]}))
    assert len(log.time) == len(TIME)


@pytest.mark.parametrize("text", ["", "time_s\n", '"'])
def test_a_file_that_is_not_a_table_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "encoder.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"encoder\.csv"):
        read_encoder(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        read_encoder(tmp_path / "nowhere.csv")


def test_cells_separated_by_semicolons_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, COLUMNS)
    path.write_text(path.read_text().replace(",", ";").replace(".", ","))
    with pytest.raises(RecordingError, match=r"separated by semicolons.*with decimal points"):
        read_encoder(path)
