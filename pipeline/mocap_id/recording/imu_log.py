"""Reader of logs of inertial sensors: the program's own CSV, and exports of Xsens MTw, Xsens DOT and Delsys."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.sample_checks import (
    SENSOR_HZ,
    HeldSamples,
    check_rate,
    check_times,
    find_held,
    list_held,
)
from mocap_id.recording.text_tables import (
    TextTable,
    check_end,
    check_unique,
    read_text,
    split_lines,
)

_OWN = ("time_s", "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z")
_XSENS = ("Gyr_X", "Gyr_Y", "Gyr_Z", "Acc_X", "Acc_Y", "Acc_Z")
_DELSYS = re.compile(
    r"(?!.*time series)(?P<sensor>.*?)[ :.]*(?P<kind>ACC|GYRO)[ .]*(?P<axis>[XYZ])\b.*?\((?P<unit>[^()]+)\)\s*$", re.I
)
_UNITS = {
    **{"deg/s": np.pi / 180, "°/s": np.pi / 180, "dps": np.pi / 180, "rad/s": 1.0},
    **{"g": 9.80665, "m/s^2": 1.0, "m/s²": 1.0, "m/s2": 1.0},
}
_HEADER = 40  # largest number of lines above the names of the columns
_LEAST_ROWS = 50
_FASTEST = 100.0  # rad/s, more than any sensor measures
_RATE = re.compile(r"Update Rate:\s*([0-9.]+)")
_DELSYS_TIME = re.compile(r"\btime|(?:^|\W)x *[\[(] *s *[\])]", re.I)
_RATES_LINE = re.compile(r"^[^0-9]*[0-9.,e+-]+ *(?:Hz|s)\b", re.I)  # the rates or steps of the channels
_HERTZ = re.compile(r"\W*([0-9]+(?:\.[0-9]+)?) *Hz\W*", re.I)
_MAX_RATE_ERROR = 0.02
_TICKS = {"dot": 1e-6, "mtw": 1e-4}  # s, one step of SampleTimeFine
_WRAPS = {"SampleTimeFine": 2.0**32, "PacketCounter": 2.0**16}
_EXPECTED = f"expected {', '.join(_OWN)} (rad/s, m/s²), or an export of one sensor of Xsens MTw, Xsens DOT or Delsys"


@dataclass(frozen=True)
class ImuLog:
    """K samples of an inertial sensor, on its own clock."""

    time: FloatArray  # (K,) increasing times, s
    gyro: FloatArray  # (K, 3) angular velocity in the sensor's axes, rad/s
    acc: FloatArray  # (K, 3) specific force in the sensor's axes, m/s²
    held: tuple[HeldSamples, ...] = ()  # repeated or interpolated rows, which are left out


def read_imu(path: Path, rate: float | None = None) -> ImuLog:
    """Read the log of one inertial sensor.

    The program's CSV has the columns ``time_s, gyro_x, gyro_y, gyro_z, acc_x, acc_y, acc_z`` in rad/s and m/s². Exports
    of Xsens have the columns ``Gyr_X``, ``Acc_X`` and so on. The angular velocity is in rad/s for MTw, and in degrees
    per second for DOT, whose files begin with the device's tag. In exports of Delsys (EMGworks, Trigno Discover) the
    names of the columns contain sensor, channel and unit; a column before the channels contains their times.

    ``rate`` is the configured number of rows per second, Hz, for an export without times; it must agree with the times
    that a file has. Raises RecordingError if the file is missing, has another format, several sensors, a column twice,
    too few rows or no times, if it ends within its last line, or if its times are not increasing seconds.
    """
    text = read_text(path)
    lines = split_lines(text)
    start = next((k for k, line in enumerate(lines[:_HEADER]) if _is_header(line)), None)
    if start is None:
        if any(re.search(r"GYRO[ .]*[XYZ]\b", line, re.IGNORECASE) for line in lines[:_HEADER]):
            raise RecordingError(
                f"{path}: the names of its channels contain no units; expected names such as `ACC.X (g)` and "
                "`GYRO.X (deg/s)`: export with units, or add them to the names"
            )
        raise RecordingError(f"{path}: no columns of an inertial sensor; {_EXPECTED}")
    separator = next((each for each in "\t;," if each in lines[start]), ",")
    names = [name.strip().strip('"').strip() for name in lines[start].split(separator)]
    delsys = not any(set(names) >= set(layout) for layout in (_OWN, _XSENS))
    below, width = start + 1, len(names)
    if delsys:  # lines with rates may follow; columns to the right of the channels contain the labels of events
        while below < len(lines) and _RATES_LINE.search(lines[below]):
            below += 1
        width = max(k for k, name in enumerate(names) if _DELSYS.match(name)) + 1
    else:
        while width and not names[width - 1]:
            width -= 1
        check_unique(path, names)
    names = names[:width]
    rows = [separator.join(line.rstrip().split(separator)[:width]) for line in lines[below:]]
    if separator != ",":  # decimal commas
        rows = [row.replace(",", ".") for row in rows]
    table = TextTable(path, names, rows, below + 1, separator)
    check_end(path, table, text)
    values = table.numbers()
    columns = dict(zip(names, values.T, strict=True))
    if delsys:
        declared = {
            k: float(found[1])
            for line in lines[start + 1 : below]
            for k, cell in enumerate(line.split(separator))
            if (found := _HERTZ.fullmatch(cell.replace(",", ".") if separator != "," else cell))
        }
        time, signals = _read_delsys(path, names, values, declared, rate)
    elif set(names) >= set(_OWN):
        time, signals = columns[_OWN[0]], np.stack([columns[name] for name in _OWN[1:]], axis=1)
    else:
        signals = np.stack([columns[name] for name in _XSENS], axis=1)
        dot = any("DeviceTag" in line or "sep=" in line for line in lines[:start])
        signals[:, :3] *= np.pi / 180 if dot else 1.0
        time = _read_xsens_times(path, columns, _TICKS["dot" if dot else "mtw"], "\n".join(lines[:start]), rate)
    complete = np.isfinite(time) & np.isfinite(signals).all(axis=1)
    time, gyro, acc = time[complete], signals[complete, :3], signals[complete, 3:]
    if len(time) < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {len(time)} complete rows, expected at least {_LEAST_ROWS}")
    check_times(path, time, "the time", SENSOR_HZ)
    own = 1.0 / float(np.median(np.diff(time)))
    if rate is not None and abs(own / rate - 1.0) > _MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}: `rate_hz` is {rate:g} in the configuration, but the times of the file have {own:.6g} Hz; "
            "remove `rate_hz`"
        )
    if np.abs(gyro).max() > _FASTEST:
        raise RecordingError(
            f"{path}: the gyroscope reaches {np.abs(gyro).max():.0f} rad/s; degrees per second must be converted "
            "to rad/s"
        )
    of_gyro, of_acc = find_held(gyro, own), find_held(acc, own)
    again, straight = of_gyro[0] | of_acc[0], of_gyro[1] | of_acc[1]
    kept = ~again & ~straight
    held = list_held(f"the sensor in {path.name}", time, again, straight & ~again)
    return ImuLog(time[kept], gyro[kept], acc[kept], held)


def format_imu_csv(log: ImuLog) -> bytes:
    """Return a log as the bytes of the program's own CSV."""
    rows = np.column_stack([log.time, log.gyro, log.acc])
    lines = [",".join(_OWN), *(",".join(f"{value:.6f}" for value in row) for row in rows.tolist())]
    return ("\n".join(lines) + "\n").encode()


def _is_header(line: str) -> bool:
    cells = [cell.strip().strip('"').strip() for cell in re.split("[,;\t]", line)]
    return any(set(layout) <= set(cells) for layout in (_OWN, _XSENS)) or any(map(_DELSYS.match, cells))


def _read_xsens_times(
    path: Path, columns: dict[str, FloatArray], tick: float, head: str, rate: float | None
) -> FloatArray:
    """Return the times of an export of Xsens, s: from SampleTimeFine in steps of ``tick``, s, or from the rate."""
    fine, stated = columns.get("SampleTimeFine"), _RATE.search(head)
    if fine is not None and np.isfinite(fine).all():
        return _unwrap(fine, _WRAPS["SampleTimeFine"]) * tick
    hertz = rate if stated is None else float(stated[1])
    if hertz is None:
        raise RecordingError(
            f"{path}: has no times and no line 'Update Rate': export it with SampleTimeFine, or give its rate, "
            f"`imus: {{SEGMENT: {{file: {path.name}, rate_hz: …}}}}`"
        )
    check_rate(path, hertz, "its rate", SENSOR_HZ)
    counter = columns.get("PacketCounter", np.arange(float(len(columns[_XSENS[0]]))))
    return _unwrap(counter, _WRAPS["PacketCounter"]) / hertz


def _unwrap(counter: FloatArray, wrap: float) -> FloatArray:
    """Return a counter that starts at 0, with ``wrap`` added each time that the recorded counter starts again."""
    if not len(counter):
        return counter
    back = np.concatenate([[0.0], np.cumsum(np.diff(counter) < -wrap / 2)])
    return np.asarray(counter - counter[0] + wrap * back)


def _read_delsys(
    path: Path, names: list[str], values: FloatArray, declared: dict[int, float], rate: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return the times (K,) of the gyroscope, s, and the channels (K, 6) at these times.

    The last column of times before a channel contains its times. If there is none, its rate is in ``declared`` by
    column, from the lines below the names, or is the configured ``rate``, Hz.
    """
    channels: dict[str, tuple[FloatArray, FloatArray]] = {}
    sensors = {match["sensor"].strip() for name in names if (match := _DELSYS.match(name))}
    if len(sensors) > 1:
        raise RecordingError(f"{path}: has {len(sensors)} sensors ({', '.join(sorted(sensors))}); export only one")
    clock: int | None = None
    for k, name in enumerate(names):
        if _DELSYS_TIME.search(name):
            clock = k
            continue
        match = _DELSYS.match(name)
        if match is None:
            continue
        factor = _UNITS.get(match["unit"].strip().lower())
        if factor is None:
            raise RecordingError(f"{path}: `{name}` is in {match['unit']}; expected {', '.join(_UNITS)}")
        channel = f"{match['kind'].lower()}_{match['axis'].lower()}"
        if channel in channels:
            raise RecordingError(f"{path}: `{name}` occurs twice, as with several sensors; export only one sensor")
        kept = np.isfinite(values[:, k])
        if clock is None:
            hertz = declared.get(k, rate)
            if hertz is None:
                raise RecordingError(
                    f"{path}: has no column of times before `{name}`: export it with the times (X[s]), or give its "
                    f"rate, `imus: {{SEGMENT: {{file: {path.name}, rate_hz: …}}}}`"
                )
            check_rate(path, hertz, "its rate", SENSOR_HZ)
            time = np.arange(len(values)) / hertz
        else:
            time = values[:, clock]
            stamped = np.flatnonzero(np.isfinite(time))
            kept &= np.isfinite(time)
            if kept.any() and np.flatnonzero(kept)[-1] < 0.5 * stamped[-1]:
                raise RecordingError(
                    f"{path}: `{name}` ends after {np.count_nonzero(kept)} rows, but `{names[clock]}` after "
                    f"{len(stamped)}: these are the times of a faster channel; export each channel with its own times"
                )
        if kept.any():
            check_times(path, time[kept], f"the time of `{name}`", SENSOR_HZ)
        channels[channel] = (time[kept], factor * values[kept, k])
    missing = [name for name in _OWN[1:] if name not in channels or not len(channels[name][0])]
    if missing:
        raise RecordingError(f"{path}: has no {', '.join(missing)}; {_EXPECTED}")
    first, last = (pick(float(time[end]) for time, _ in channels.values()) for pick, end in ((max, 0), (min, -1)))
    time = channels["gyro_x"][0]
    step = float(np.median(np.diff(time)))
    time = time[(time >= first - step) & (time <= last + step)]
    return time, np.stack([np.interp(time, *channels[name]) for name in _OWN[1:]], axis=1)
