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


CHANNELS = [(f"{kind} {axis}", unit) for kind, unit in (("GYRO", "deg/s"), ("ACC", "G")) for axis in "XYZ"]
IN_UNITS = [*np.degrees(SIGNALS[:, :3]).T, *(SIGNALS[:, 3:] / 9.80665).T]  # deg/s, then g


def discover(path: Path, events: bool = False, semicolons: bool = False, group_times: bool = False) -> Path:
    """Write an export of Trigno Discover: two lines with rates below the names, perhaps events to the right."""
    names, cells = [], []
    for k, ((name, unit), value) in enumerate(zip(CHANNELS, IN_UNITS, strict=True)):
        if not (group_times and k % 3):
            names.append(f"{name} Time Series (s)")
            cells.append([f"{t:.6f}" for t in TIME])
        names.append(f"{name} ({unit})")
        cells.append([f"{each:.9f}" for each in value])
    rates = ["" if "Time" in name else "100.0 Hz" for name in names]
    steps = ["" if "Time" in name else "0.01 s" for name in names]
    rows = [list(row) for row in zip(*cells, strict=True)]
    if events:
        names += ["Type", "Name", "Time (s)"]
        rows = [[*row, "General", "start", "0.1"] for row in rows]
    lines = [["Application:", "Trigno Discover (2.1.0.7)"], ["Date/Time:", "1/1/2024"], ["Sensor 1 (75651)", ""]]
    lines += [["sensor mode: 609", ""], names, rates, steps, *rows]
    text = "\n".join(", ".join(line) for line in lines) + "\n"
    if semicolons:
        text = text.replace(", ", ";").replace(".", ",")
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize("form", [{}, {"events": True}, {"semicolons": True}, {"group_times": True}])
def test_trigno_discover(tmp_path: Path, form: dict[str, bool]) -> None:
    check(discover(tmp_path / "discover.csv", **form))


def test_trigno_discover_without_times_has_rates_below_the_names(tmp_path: Path) -> None:
    """The channel of the muscle is faster and has more rows."""
    lines = ["Application:, Trigno Discover (1.7.0)", "EMG 01 (88016), , ", "sensor mode: 55, , "]
    lines += [", ".join(["EMG 1 (mV)", *(f"{name} ({unit})" for name, unit in CHANNELS)])]
    lines += [", ".join(["1259.2593 Hz", *["100 Hz" for _ in CHANNELS]])]
    for k in range(500):
        lines.append(", ".join(["0.5", *(f"{value[k]:.9f}" if k < ROWS else "" for value in IN_UNITS)]))
    (tmp_path / "discover.csv").write_text("\n".join(lines) + "\n")
    check(tmp_path / "discover.csv")


def test_channels_without_units_are_refused(tmp_path: Path) -> None:
    head = ",".join(f'X[s],"Avanti sensor 2: {kind}.{axis} 2"' for kind in ("ACC", "GYRO") for axis in "XYZ")
    path = write(tmp_path / "emgworks.csv", [head], [each for value in IN_UNITS for each in (TIME, value)])
    with pytest.raises(RecordingError, match="contain no units"):
        read_imu(path)


def test_delsys_times_are_not_taken_from_another_channel(tmp_path: Path) -> None:
    """A channel of the muscle stands between the times and the sensor's channels."""
    names = ["X[s]", "EMG 1 (mV)", *(f"{name} ({unit})" for name, unit in CHANNELS)]
    check(write(tmp_path / "delsys.csv", [",".join(names)], [TIME, np.cos(9 * TIME), *IN_UNITS]))


def test_delsys_times_of_a_faster_channel_are_refused(tmp_path: Path) -> None:
    head = ",".join(["EMG 1 Time Series (s)", "EMG 1 (mV)", *(f"{name} ({unit})" for name, unit in CHANNELS)])
    rows = [
        [f"{k / 1000:.4f}", "0.5", *("" if k >= ROWS else f"{value[k]:.6f}" for value in IN_UNITS)] for k in range(600)
    ]
    (tmp_path / "emg.csv").write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    with pytest.raises(RecordingError, match="times of a faster channel"):
        read_imu(tmp_path / "emg.csv")


def test_delsys_without_times_needs_a_rate(tmp_path: Path) -> None:
    path = write(tmp_path / "delsys.csv", [",".join(f"{name} ({unit})" for name, unit in CHANNELS)], IN_UNITS)
    with pytest.raises(RecordingError, match=r"no column of times.*rate_hz"):
        read_imu(path)
    log = read_imu(path, 100.0)
    np.testing.assert_allclose(log.time, TIME, atol=1e-9)
    np.testing.assert_allclose(log.gyro, SIGNALS[:, :3], atol=1e-6)


def test_xsens_without_update_rate_needs_a_rate(tmp_path: Path) -> None:
    names = ["PacketCounter", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z"]
    counter = np.delete(np.arange(ROWS + 1.0), 20)  # a packet is lost
    columns = [counter, *SIGNALS[:, 3:].T, *SIGNALS[:, :3].T]
    path = write(tmp_path / "mtw.txt", ["// Start Time: Unknown", "\t".join(names)], columns, "\t")
    with pytest.raises(RecordingError, match=r"no line 'Update Rate'.*rate_hz"):
        read_imu(path)
    np.testing.assert_allclose(read_imu(path, 50.0).time, counter / 50.0, atol=1e-9)
    with pytest.raises(RecordingError, match="1e-05 Hz, expected 5 to"):
        read_imu(path, 1e-5)


def test_a_rate_that_contradicts_the_times_is_refused(tmp_path: Path) -> None:
    path = own(tmp_path / "imu.csv")
    check(path)
    assert len(read_imu(path, 100.0).time) == ROWS
    with pytest.raises(RecordingError, match=r"`rate_hz` is 60 .* 100 Hz"):
        read_imu(path, 60.0)


def test_a_column_that_occurs_twice_is_refused(tmp_path: Path) -> None:
    head = "time_s,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,gyro_x"
    path = write(tmp_path / "own.csv", [head], [TIME, *SIGNALS.T, SIGNALS[:, 0] + 9])
    with pytest.raises(RecordingError, match="`gyro_x` occurs twice"):
        read_imu(path)
    names = [f"X[s],{name} ({unit})" for _ in (1, 2) for name, unit in CHANNELS]
    columns = [each for _ in (1, 2) for value in IN_UNITS for each in (TIME, value)]
    path = write(tmp_path / "two.csv", [",".join(names)], columns)
    with pytest.raises(RecordingError, match="occurs twice, as with several sensors"):
        read_imu(path)


def test_a_log_that_ends_within_its_last_number_is_refused(tmp_path: Path) -> None:
    path = own(tmp_path / "imu.csv")
    text = "\n".join(
        ",".join(f"{float(cell):.4f}" if k else cell for cell in line.split(","))
        for k, line in enumerate(path.read_text("utf-8").splitlines())
    )
    path.write_text(text, "utf-8")
    assert len(read_imu(path).time) == ROWS  # a whole last line without a line end
    for lost in (1, 3, 20):
        path.write_text(text[:-lost], "utf-8")
        with pytest.raises(RecordingError, match="ends within its last line"):
            read_imu(path)
