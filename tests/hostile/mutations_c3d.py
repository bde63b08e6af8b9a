"""Damage specific to C3D: header words, parameters, groups, offsets, block numbers, consistently wrong counts."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import mutations_bytes
import numpy as np

WORDS = (0, 1, 2, 3, 127, 128, 255, 256, 1023, 32767, 32768, 65534, 65535)
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-45, 1e-30, 1e30, 3.4e38, -3.4e38, float("nan"), float("inf"), float("-inf"))
HEADER_WORDS = (2, 4, 6, 8, 10, 16, 18)  # points, analog, first, last, gap, data block, samples a frame
HEADER_FLOATS = (12, 20)  # scale, rate
COUNTS = ("POINT:USED", "POINT:FRAMES", "POINT:DATA_START", "ANALOG:USED", "FORCE_PLATFORM:USED", "ANALOG:BITS")


@dataclass(frozen=True)
class Place:
    """Position of a parameter: group id, and byte ranges of the entry, its type byte and its values."""

    name: str
    entry: int
    offset: int
    kind: int
    values: int
    shape: tuple[int, ...]
    element: int


def order(data: bytes | bytearray) -> str:
    start = (max(data[0], 2) - 1) * 512
    return ">" if len(data) > start + 3 and data[start + 3] == 86 else "<"


def places(data: bytes | bytearray) -> list[Place]:
    """Return the positions of all parameters of a valid file."""
    endian, at, found, groups = order(data), (max(data[0], 2) - 1) * 512 + 4, [], {}
    while at + 2 <= len(data):
        length, group = struct.unpack("bb", data[at : at + 2])
        if length == 0 or group == 0 or at + 4 + abs(length) > len(data):
            break
        name = bytes(data[at + 2 : at + 2 + abs(length)]).decode("latin-1").upper()
        offset = at + 2 + abs(length)
        step = struct.unpack(endian + "H", data[offset : offset + 2])[0]
        if group < 0:
            groups.setdefault(-group, name)  # the first of two is valid
        elif offset + 4 <= len(data):
            rank = data[offset + 3]
            shape = tuple(data[offset + 4 : offset + 4 + rank])
            element = struct.unpack("b", data[offset + 2 : offset + 3])[0]
            full = f"{groups.get(group, group)}:{name}"
            found.append(Place(full, at, offset, offset + 2, offset + 4 + rank, shape, element))
        if step == 0:
            break
        at = offset + step
    return found


def put_word(data: bytearray, at: int, value: int) -> None:
    if at + 2 <= len(data):
        data[at : at + 2] = struct.pack(order(data) + "H", value % 65536)


def put_float(data: bytearray, at: int, value: float) -> None:
    if at + 4 <= len(data):
        data[at : at + 4] = struct.pack(order(data) + "f", value)


def near(rng: np.random.Generator, value: int) -> int:
    """Return a wrong number: an awkward one, or one close to the truth."""
    chance = rng.random()
    if chance < 0.4:
        return int(rng.choice(WORDS))
    if chance < 0.8:
        return value + int(rng.choice([-2, -1, 1, 2, 3]))
    return int(rng.choice([2 * value, value // 2, rng.integers(65536)]))


def header_word(data: bytearray, rng: np.random.Generator) -> None:
    at = int(rng.choice(HEADER_WORDS))
    if at + 2 <= len(data):
        put_word(data, at, near(rng, struct.unpack(order(data) + "H", data[at : at + 2])[0]))


def header_float(data: bytearray, rng: np.random.Generator) -> None:
    put_float(data, int(rng.choice(HEADER_FLOATS)), float(rng.choice(FLOATS)))


def some(data: bytearray, rng: np.random.Generator, counts: bool = False) -> Place | None:
    found = places(data) if data else []
    found = [place for place in found if place.name in COUNTS] if counts else found
    return found[rng.integers(len(found))] if found else None


def parameter_value(data: bytearray, rng: np.random.Generator, counts: bool = False) -> None:
    place = some(data, rng, counts)
    if place is None:
        return
    size = int(np.prod(place.shape)) if place.shape else 1
    for _ in range(int(rng.integers(1, 4))):
        index = int(rng.integers(max(size, 1)))
        if place.element == 4:
            put_float(data, place.values + 4 * index, float(rng.choice(FLOATS)))
        elif place.element == 2 and place.values + 2 * index + 2 <= len(data):
            at = place.values + 2 * index
            put_word(data, at, near(rng, struct.unpack(order(data) + "H", data[at : at + 2])[0]))
        elif place.values + index < len(data):
            data[place.values + index] = int(rng.integers(256))


def count_parameter(data: bytearray, rng: np.random.Generator) -> None:
    parameter_value(data, rng, counts=True)


def parameter_shape(data: bytearray, rng: np.random.Generator) -> None:
    place = some(data, rng)
    if place is not None and place.kind + 1 < len(data):
        what = int(rng.integers(3))
        if what == 0:
            data[place.kind] = int(rng.choice([0xFF, 0, 1, 2, 3, 4, 8, 0x80, 0x7F]))
        elif what == 1:
            data[place.kind + 1] = int(rng.choice([0, 1, 2, 3, 7, 8, 255]))
        elif place.shape:
            data[place.kind + 2 + int(rng.integers(len(place.shape)))] = int(rng.choice([0, 1, 2, 127, 128, 255]))


def parameter_offset(data: bytearray, rng: np.random.Generator) -> None:
    place = some(data, rng)
    if place is not None:
        put_word(
            data, place.offset, near(rng, struct.unpack(order(data) + "H", data[place.offset : place.offset + 2])[0])
        )


def group_id(data: bytearray, rng: np.random.Generator) -> None:
    place = some(data, rng)
    if place is not None:
        data[place.entry + 1] = int(rng.choice([0, 1, 2, 3, 127, 128, 255, rng.integers(256)]))


def rename(data: bytearray, rng: np.random.Generator) -> None:
    """Rename a parameter, so that it is missing or duplicated."""
    place, other = some(data, rng), some(data, rng)
    if place is None or other is None:
        return
    name = place.name.partition(":")[2]
    new = other.name.partition(":")[2] if rng.random() < 0.3 else "X" * len(name)
    data[place.entry + 2 : place.entry + 2 + len(name)] = new[: len(name)].ljust(len(name)).encode("latin-1", "replace")


def lose_counts(data: bytearray, rng: np.random.Generator) -> None:
    """Remove some of the parameters that declare counts."""
    for place in places(data) if data else []:
        if place.name in COUNTS[:4] and rng.random() < 0.5:
            data[place.entry + 2] = ord("~")


def agree_on_a_lie(data: bytearray, rng: np.random.Generator) -> None:
    """Declare the same wrong number of frames in header and parameters."""
    if len(data) < 24:
        return
    first, last = struct.unpack(order(data) + "HH", data[6:10])
    frames = max(last - first + 1 + int(rng.choice([-20, -5, -2, -1, 1, 2, 5, 20, 1000])), 1)
    put_word(data, 8, first + frames - 1)
    for place in places(data):
        if place.name == "POINT:FRAMES":
            (put_float if place.element == 4 else put_word)(data, place.values, frames)
        if place.name == "TRIAL:ACTUAL_END_FIELD":
            put_word(data, place.values, first + frames - 1)


def processor(data: bytearray, rng: np.random.Generator) -> None:
    at = (max(data[0], 2) - 1) * 512 + 3 if data else 0
    if at < len(data):
        data[at] = int(rng.choice([0, 83, 84, 85, 86, 87, 255]))


def first_bytes(data: bytearray, rng: np.random.Generator) -> None:
    if len(data) > 1:
        data[0] = int(rng.choice([0, 1, 2, 3, 4, 128, 255]))


def poison_data(data: bytearray, rng: np.random.Generator) -> None:
    """Put NaN, infinities and huge values among the samples."""
    for _ in range(int(2 ** rng.uniform(0, 8))):
        at = int(rng.integers(max(len(data) // 8, 1), len(data) + 1)) // 4 * 4
        put_float(data, at, float(rng.choice(FLOATS)))


IN_PLACE: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    header_word,
    header_word,
    header_float,
    parameter_value,
    count_parameter,
    count_parameter,
    parameter_shape,
    parameter_offset,
    group_id,
    rename,
    lose_counts,
    agree_on_a_lie,
    processor,
    first_bytes,
    poison_data,
    mutations_bytes.flip_early,
    mutations_bytes.flip,
)


def apply(data: bytearray, rng: np.random.Generator) -> bool:
    """Apply a few of them; return whether the length is unchanged, so that the number of frames is known."""
    for _ in range(int(rng.integers(1, 4))):
        IN_PLACE[rng.integers(len(IN_PLACE))](data, rng)
    if rng.random() < 0.75:
        return True
    mutations_bytes.RESIZING[rng.integers(len(mutations_bytes.RESIZING))](data, rng)
    return False
