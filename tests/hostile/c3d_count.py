"""Possible numbers of frames of a C3D file, read from its bytes without the program's own code."""

from __future__ import annotations

import struct

import mutations_c3d
import numpy as np


def _numbers(data: bytes, place: mutations_c3d.Place) -> list[float]:
    """Return a parameter's values as unsigned words or floats (DEC floats converted)."""
    endian, size = mutations_c3d.order(data), abs(place.element)
    count = int(np.prod(place.shape)) if place.shape else 1
    raw = data[place.values : place.values + size * count]
    if place.element not in (1, 2, 4) or len(raw) < size * count:
        return []
    if place.element == 4:
        return [_real(data, raw[4 * k : 4 * k + 4]) for k in range(count)]
    return [float(value) for value in struct.unpack(endian + {1: "B", 2: "H"}[place.element] * count, raw)]


def _real(data: bytes, raw: bytes) -> float:
    start = (max(data[0], 2) - 1) * 512
    if data[start + 3] == 85:
        return float(struct.unpack("<f", raw[2:] + raw[:2])[0]) / 4
    return float(struct.unpack(mutations_c3d.order(data) + "f", raw)[0])


def possible(data: bytes) -> set[int]:
    """Return every declared number of frames that the file's size allows, and the remaining bytes."""
    known: dict[str, list[float]] = {}
    for place in mutations_c3d.places(data):
        known.setdefault(place.name, _numbers(data, place))
    endian = mutations_c3d.order(data)
    points, analog, first, last = struct.unpack(endian + "HHHH", data[2:10])
    block, samples = struct.unpack(endian + "HH", data[16:20])

    def some(name: str) -> list[float]:
        return [value for value in known.get(name, [])[:1] if np.isfinite(value)]

    frames = {last - first + 1, *map(int, some("POINT:FRAMES")), *map(int, some("POINT:LONG_FRAMES"))}
    start, end = known.get("TRIAL:ACTUAL_START_FIELD"), known.get("TRIAL:ACTUAL_END_FIELD")
    if start and end:
        lows = int(end[0]) - int(start[0]) + 1
        highs = (int(end[1]) if len(end) > 1 else 0) - (int(start[1]) if len(start) > 1 else 0)
        frames |= {lows, lows + 65536 * highs}
    scales = [_real(data, data[12:16]), *some("POINT:SCALE")]
    words = {4 if scale < 0 else 2 for scale in scales}
    per_frame = {analog, *(int(used) * samples for used in some("ANALOG:USED"))}
    starts = {(int(b) - 1) * 512 for b in (block, *some("POINT:DATA_START"))}
    fitting = set()
    for at in starts:
        for count in {points, *map(int, some("POINT:USED"))}:
            for numbers in per_frame:
                for word in words:
                    size = (4 * count + numbers) * word
                    held = (len(data) - at) // size if size and 0 < at < len(data) else 0
                    fitting |= {n for n in frames if 0 < n <= held}
                    if 65535 in frames and held > 65535:
                        fitting |= {*range(65536, held + 1)}
    return fitting
