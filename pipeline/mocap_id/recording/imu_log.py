"""Reader of logs of inertial sensors: the program's own CSV, and exports of Xsens MTw, Xsens DOT and Delsys."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.text_tables import TextTable, read_text, split_lines

_OWN = ("time_s", "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z")
_XSENS = ("Gyr_X", "Gyr_Y", "Gyr_Z", "Acc_X", "Acc_Y", "Acc_Z")
_DELSYS = re.compile(r"(?P<sensor>.*?)[ :.]*(?P<kind>ACC|GYRO)[ .]*(?P<axis>[XYZ])\b.*?\((?P<unit>[^()]+)\)\s*$", re.I)
_UNITS = {
    **{"deg/s": np.pi / 180, "°/s": np.pi / 180, "dps": np.pi / 180, "rad/s": 1.0},
    **{"g": 9.80665, "m/s^2": 1.0, "m/s²": 1.0, "m/s2": 1.0},
}
_HEADER = 40  # largest number of lines above the names of the columns
_LEAST_ROWS = 50
_FASTEST = 100.0  # rad/s, more than any sensor measures
_RATE = re.compile(r"Update Rate:\s*([0-9.]+)")
_TICKS = {"dot": 1e-6, "mtw": 1e-4}  # s, one step of SampleTimeFine
_WRAPS = {"SampleTimeFine": 2.0**32, "PacketCounter": 2.0**16}
_EXPECTED = f"expected {', '.join(_OWN)} (rad/s, m/s²), or an export of one sensor of Xsens MTw, Xsens DOT or Delsys"


@dataclass(frozen=True)
class ImuLog:
    """K samples of an inertial sensor, on its own clock."""

    time: FloatArray  # (K,) increasing times, s
    gyro: FloatArray  # (K, 3) angular velocity in the sensor's axes, rad/s
    acc: FloatArray  # (K, 3) specific force in the sensor's axes, m/s²


def read_imu(path: Path) -> ImuLog:
    """Read the log of one inertial sensor.

    The program's CSV has the columns ``time_s, gyro_x, gyro_y, gyro_z, acc_x, acc_y, acc_z`` in rad/s and m/s². Exports
    of Xsens have the columns ``Gyr_X``, ``Acc_X`` and so on. The angular velocity is in rad/s for MTw, and in degrees
    per second for DOT, whose files begin with the device's tag. In exports of Delsys the names of the columns contain
    sensor, channel and unit, and the column before each channel contains its times.

    Raises RecordingError if the file is missing, has another format, several sensors or too few rows, or if its times
    do not increase.
    """
    lines = split_lines(read_text(path))
    start = next((k for k, line in enumerate(lines[:_HEADER]) if _is_header(line)), None)
    if start is None:
        raise RecordingError(f"{path}: no columns of an inertial sensor; {_EXPECTED}")
    separator = next((each for each in "\t;," if each in lines[start]), ",")
    names = [name.strip().strip('"') for name in lines[start].split(separator)]
    while names and not names[-1]:
        names.pop()
    rows = [line.rstrip().rstrip(separator) for line in lines[start + 1 :]]
    values = TextTable(path, names, rows, start + 2, separator).numbers()
    columns = dict(zip(names, values.T, strict=True))
    if all(name in columns for name in _OWN):
        log = _keep_complete_rows(columns[_OWN[0]], np.stack([columns[name] for name in _OWN[1:]], axis=1))
    elif all(name in columns for name in _XSENS):
        log = _read_xsens(path, columns, "\n".join(lines[:start]))
    else:
        log = _read_delsys(path, names, values)
    _check_log(path, log)
    return log


def format_imu_csv(log: ImuLog) -> bytes:
    """Return a log as the bytes of the program's own CSV."""
    rows = np.column_stack([log.time, log.gyro, log.acc])
    lines = [",".join(_OWN), *(",".join(f"{value:.6f}" for value in row) for row in rows.tolist())]
    return ("\n".join(lines) + "\n").encode()


def _is_header(line: str) -> bool:
    return (
        all(name in line for name in _OWN) or all(name in line for name in _XSENS) or bool(_find_delsys_channels(line))
    )


def _find_delsys_channels(line: str) -> list[re.Match[str]]:
    return [found for cell in re.split("[,;\t]", line) if (found := _DELSYS.match(cell.strip().strip('"')))]


def _keep_complete_rows(time: FloatArray, values: FloatArray) -> ImuLog:
    kept = np.isfinite(time) & np.isfinite(values).all(axis=1)
    return ImuLog(time[kept], values[kept, :3], values[kept, 3:])


def _read_xsens(path: Path, columns: dict[str, FloatArray], head: str) -> ImuLog:
    kind = "dot" if "DeviceTag" in head or "sep=" in head else "mtw"
    values = np.stack([columns[name] for name in _XSENS], axis=1)
    values[:, :3] *= np.pi / 180 if kind == "dot" else 1.0
    fine, rate = columns.get("SampleTimeFine"), _RATE.search(head)
    if fine is not None and np.isfinite(fine).all():
        return _keep_complete_rows(_unwrap(fine, _WRAPS["SampleTimeFine"]) * _TICKS[kind], values)
    if rate is None or "PacketCounter" not in columns:
        raise RecordingError(
            f"{path}: has no times: export it with SampleTimeFine, or with PacketCounter and the line 'Update Rate'"
        )
    return _keep_complete_rows(_unwrap(columns["PacketCounter"], _WRAPS["PacketCounter"]) / float(rate[1]), values)


def _unwrap(counter: FloatArray, wrap: float) -> FloatArray:
    """Return a counter that starts at 0, with ``wrap`` added each time that the recorded counter starts again."""
    back = np.concatenate([[0.0], np.cumsum(np.diff(counter) < -wrap / 2)])
    return np.asarray(counter - counter[0] + wrap * back)


def _read_delsys(path: Path, names: list[str], values: FloatArray) -> ImuLog:
    """Return the channels at the times of the gyroscope; the column before each channel contains its times."""
    channels: dict[str, tuple[FloatArray, FloatArray]] = {}
    sensors = set()
    for k, name in enumerate(names):
        match = _DELSYS.match(name)
        if match is None or k == 0:
            continue
        factor = _UNITS.get(match["unit"].strip().lower())
        if factor is None:
            raise RecordingError(f"{path}: `{name}` is in {match['unit']}; expected {', '.join(_UNITS)}")
        sensors.add(match["sensor"].strip())
        own = next(j for j in range(k - 1, -1, -1) if _DELSYS.match(names[j]) is None)
        kept = np.isfinite(values[:, own]) & np.isfinite(values[:, k])
        channels[f"{match['kind'].lower()}_{match['axis'].lower()}"] = (values[kept, own], factor * values[kept, k])
    if len(sensors) > 1:
        raise RecordingError(f"{path}: has {len(sensors)} sensors ({', '.join(sorted(sensors))}); export only one")
    missing = [name for name in _OWN[1:] if name not in channels]
    if missing:
        raise RecordingError(f"{path}: has no {', '.join(missing)}; {_EXPECTED}")
    time = channels["gyro_x"][0]
    return _keep_complete_rows(time, np.stack([np.interp(time, *channels[name]) for name in _OWN[1:]], axis=1))


def _check_log(path: Path, log: ImuLog) -> None:
    if len(log.time) < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {len(log.time)} complete rows, expected at least {_LEAST_ROWS}")
    back = np.flatnonzero(np.diff(log.time) <= 0)
    if len(back):
        raise RecordingError(
            f"{path}: the time does not increase after {log.time[back[0]]:g} s ({len(back)} such rows): sort the rows "
            "by time and remove repeated rows"
        )
    if np.abs(log.gyro).max() > _FASTEST:
        raise RecordingError(
            f"{path}: the gyroscope reaches {np.abs(log.gyro).max():.0f} rad/s; degrees per second must be converted "
            "to rad/s"
        )
