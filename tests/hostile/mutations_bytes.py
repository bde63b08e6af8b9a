"""Damage that ignores the format: bits, bytes, blocks, lengths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Mutation = Callable[[bytearray, np.random.Generator], None]
INTERESTING = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)


def span(data: bytearray, rng: np.random.Generator, longest: int = 4096) -> slice:
    """Return a random, often short range of the data."""
    length = int(min(len(data), 2 ** rng.uniform(0, np.log2(longest))))
    start = int(rng.integers(0, max(len(data) - length, 0) + 1))
    return slice(start, start + length)


def flip(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(2 ** rng.uniform(0, 6))):
        if data:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))


def flip_early(data: bytearray, rng: np.random.Generator) -> None:
    """Flip bits near the start, where headers are."""
    for _ in range(int(2 ** rng.uniform(0, 4))):
        if data:
            data[rng.integers(min(len(data), 2048))] = int(rng.integers(256))


def poke(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 5))):
        if data:
            data[rng.integers(len(data))] = int(rng.choice(INTERESTING))


def fill(data: bytearray, rng: np.random.Generator) -> None:
    where = span(data, rng)
    data[where] = bytes([int(rng.choice(INTERESTING))]) * (where.stop - where.start)


def truncate(data: bytearray, rng: np.random.Generator) -> None:
    del data[int(rng.integers(0, len(data) + 1)) :]


def truncate_a_little(data: bytearray, rng: np.random.Generator) -> None:
    del data[max(len(data) - int(2 ** rng.uniform(0, 12)), 0) :]


def remove(data: bytearray, rng: np.random.Generator) -> None:
    del data[span(data, rng)]


def duplicate(data: bytearray, rng: np.random.Generator) -> None:
    where = span(data, rng)
    data[where.stop : where.stop] = data[where]


def swap(data: bytearray, rng: np.random.Generator) -> None:
    """Exchange two neighbouring ranges."""
    where = span(data, rng)
    middle = (where.start + where.stop) // 2
    data[where] = data[middle : where.stop] + data[where.start : middle]


def append(data: bytearray, rng: np.random.Generator) -> None:
    data += rng.bytes(int(2 ** rng.uniform(0, 14)))


def move(data: bytearray, rng: np.random.Generator) -> None:
    """Copy one range over another."""
    source = bytes(data[span(data, rng)])
    target = int(rng.integers(0, max(len(data) - len(source), 0) + 1))
    data[target : target + len(source)] = source


IN_PLACE: tuple[Mutation, ...] = (flip, flip_early, poke, fill, swap, move)
RESIZING: tuple[Mutation, ...] = (truncate, truncate_a_little, remove, duplicate, append)


def apply(data: bytearray, rng: np.random.Generator, most: int = 3) -> None:
    """Apply a few of them."""
    for _ in range(int(rng.integers(1, most + 1))):
        pool = IN_PLACE if rng.random() < 0.6 else RESIZING
        pool[rng.integers(len(pool))](data, rng)
