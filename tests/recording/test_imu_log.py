"""Logs of inertial sensors: the layouts that are read, their units, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_id.errors import RecordingError
from mocap_id.recording.imu_log import read_imu

ROWS = 60
TIME = np.arange(ROWS) / 100
SIGNALS = np.round(np.random.default_rng(0).uniform(-2, 2, (ROWS, 6)), 6)  # rad/s, then m/s²


def write(path: Path, head: list[str], columns: list[np.ndarray], separator: str = ",") -> Path:
    rows = [separator.join(f"{value:.9g}" for value in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([*head, *rows]) + "\n", "utf-8")
    return path


def own(path: Path, time: np.ndarray = TIME, scale: float = 1.0) -> Path:
    return write(path, ["time_s,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z"], [time, *(scale * SIGNALS.T)])


def check(path: Path, time: np.ndarray = TIME) -> None:
    log = read_imu(path)
    np.testing.assert_allclose(log.time, time, atol=1e-6)
    np.testing.assert_allclose(np.hstack([log.gyro, log.acc]), SIGNALS, atol=1e-6)


def test_own_layout(tmp_path: Path) -> None:
    check(own(tmp_path / "imu.csv"))


def test_xsens_mtw_by_its_counter_that_wraps(tmp_path: Path) -> None:
    counter = (65500 + np.arange(ROWS)) % 65536
    head = ["// Start Time: Unknown", "// Update Rate: 100.0Hz", "\t".join(["PacketCounter", "SampleTimeFine"])]
    head[-1] += "\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z"
    rows = np.column_stack([counter, np.full(ROWS, np.nan), SIGNALS[:, 3:], SIGNALS[:, :3]])
    lines = ["\t".join("" if np.isnan(value) else f"{value:.9g}" for value in row) for row in rows]
    (tmp_path / "mtw.txt").write_text("\n".join([*head, *lines]) + "\n", "utf-8")
    check(tmp_path / "mtw.txt")


def test_xsens_dot_in_degrees(tmp_path: Path) -> None:
    head = ["sep=,", "DeviceTag:,left", "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"]
    columns = [np.arange(ROWS), 4_294_900_000 + 1e4 * np.arange(ROWS), *SIGNALS[:, 3:].T, *np.degrees(SIGNALS[:, :3]).T]
    columns[1] %= 2**32
    rows = [",".join(repr(float(value)) for value in row) for row in np.column_stack(columns)]
    (tmp_path / "dot.csv").write_text("\n".join([*head, *rows]) + "\n", "utf-8")
    check(tmp_path / "dot.csv")


def test_delsys_states_its_units(tmp_path: Path) -> None:
    names = [f"Avanti 1: {kind}.{axis} ({unit})" for kind, unit in (("GYRO", "deg/s"), ("ACC", "g")) for axis in "XYZ"]
    values = [*np.degrees(SIGNALS[:, :3]).T, *(SIGNALS[:, 3:] / 9.80665).T]
    columns = [each for value in values for each in (TIME, value)]
    check(write(tmp_path / "delsys.csv", [",".join(f"X [s],{name}" for name in names)], columns))


@pytest.mark.parametrize(
    ("case", "found"),
    [("empty", "no columns"), ("back", "does not increase"), ("degrees", "rad/s"), ("short", "rows")],
)
def test_what_is_no_log_is_refused(tmp_path: Path, case: str, found: str) -> None:
    path = tmp_path / "imu.csv"
    if case == "empty":
        path.write_text("a,b\n1,2\n", "utf-8")
    elif case == "short":
        path.write_text("\n".join(own(path).read_text("utf-8").splitlines()[:20]), "utf-8")
    else:
        own(
            path,
            np.where(np.arange(ROWS) == 30, 0.1, TIME) if case == "back" else TIME,
            100 if case == "degrees" else 1,
        )
    with pytest.raises(RecordingError, match=found):
        read_imu(path)
