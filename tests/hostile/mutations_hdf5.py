"""Damage specific to our HDF5: hash, index, and the HDF5 content, mostly with a valid hash."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from typing import Any

import h5py
import mutations_bytes
import mutations_stored
import numpy as np

NUMBERS = (0, 1, -1, 7, 2**31, 2**40, 2**63 - 1, 2**64 - 16, 10**400, 1.5, 1e400, True, None, "8", [], [1])
TYPES = (*("<f8", "<i8", "|b1", "|S1", "|S5", "|S999999999", "|O", "O", ">f8", "<U4"), *("<f4", "|V8", "M8[s]", "", 8))
PATHS = ("", "/", "a//b", "../x", "a\0b", "joints", "joints/name/deeper", "a/" * 900 + "b", "x" * 100_000, "ü", ".")


def reseal(data: bytes) -> bytes:
    """Return the file with a valid hash, as an attacker would write it."""
    line, _, rest = data.partition(b"\n")
    return line[:-64] + hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest


def reindex(data: bytes, change: Callable[[Any], Any]) -> bytes:
    """Return the file with another index and a valid hash, with the rest at its old or shifted position.

    ``change`` is given the index and changes it, or returns what is to stand there: JSON values, or bytes.
    """
    line, _, rest = data.partition(b"\n")
    index, _, after = rest.partition(b"\n")
    room = len(rest) - len(after.lstrip(b" "))
    found = json.loads(index)
    given = change(found)
    new = given if isinstance(given, bytes) else json.dumps(found if given is None else given).encode()
    if len(new) >= room and given is None:
        longer = 2 * len(new)
        for path, place in found["nodes"].items():
            if isinstance(place, list | tuple) and isinstance(place[2], int):
                found["nodes"][path] = [*place[:2], place[2] + longer - room]
        new = json.dumps(found).encode().ljust(longer - 1)
    return reseal(line + b"\n" + (new + b"\n").ljust(room) + rest[room:])


def _datasets(file: h5py.File) -> list[str]:
    found: list[str] = []
    file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
    return found


def _links(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    what = int(rng.integers(6))
    if what == 0:
        file[name] = h5py.ExternalLink("other.h5", "/x")
    elif what == 1:
        file[name] = h5py.SoftLink(str(rng.choice(["/joints", "/nowhere", f"/{name}", "/"])))
    elif what == 2:
        file[name] = file["/"]  # a ring
    elif what == 3:
        group = file.create_group(name)
        for _ in range(int(rng.choice([5, 40]))):  # each level twice: as many paths as 2 to the depth
            group["a"] = below = group.create_group("b")
            group = below
    elif what == 4:
        file[name] = np.dtype("f8")
    else:
        group = file.create_group(name)
        for _ in range(int(rng.choice([20, 400]))):
            group = group.create_group("g")


def _elsewhere(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    if rng.random() < 0.5:
        file.create_dataset(name, (4,), "f8", external=[(str(rng.choice(["/dev/zero", "/etc/passwd"])), 0, 32)])
    else:
        layout = h5py.VirtualLayout(shape=(4,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(rng.choice([".", "other.h5"])), "x", shape=(4,))
        file.create_virtual_dataset(name, layout)


def _huge(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    what = int(rng.integers(6))
    if what == 0:
        file.create_dataset(name, (1 << 40,), "f8", chunks=(1 << 20,))
    elif what == 1:
        file.create_dataset(name, (1 << 28,), "f8", chunks=(1 << 28,), compression="gzip")
    elif what == 2:
        zeros = np.zeros(1 << 22)
        file.create_dataset(name, data=zeros, chunks=(1 << 20,), compression="gzip", compression_opts=9)
    elif what == 3:
        file.create_dataset(name, (1 << 30,), "f8")  # contiguous, never written
    elif what == 4:
        text = h5py.string_dtype()
        made = file.create_dataset(name, (1 << 12,), text, chunks=(1 << 12,), compression="gzip")
        made[0] = "x" * (1 << 18)
    else:
        file.create_dataset(name, (1 << 16,), "S65000", chunks=(16,), compression="gzip")


def _kinds(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    reference = h5py.ref_dtype
    made = (
        lambda: file.create_dataset(name, data=h5py.Empty("f8")),
        lambda: file.create_dataset(name, (3,), reference),
        lambda: file.create_dataset(name, (3,), h5py.regionref_dtype),
        lambda: file.create_dataset(name, data=np.zeros(3, [("a", "f8"), ("b", "i4")])),
        lambda: file.create_dataset(name, data=np.zeros(3, "c16")),
        lambda: file.create_dataset(name, (3,), h5py.vlen_dtype(np.dtype("f8"))),
        lambda: file.create_dataset(name, data=np.array([0, 1]), dtype=h5py.enum_dtype({"A": 0, "B": 1})),
        lambda: file.create_dataset(name, data=np.zeros(3, "V7")),
        lambda: file.create_dataset(name, data=np.array([b"\xff\xfe", b"a"])),
        lambda: file.create_dataset(name, data=np.float64(np.nan)),
        lambda: file.create_dataset(name, data=np.zeros((0, 5))),
        lambda: file.create_dataset(name, data=np.zeros((1,) * 20)),
        lambda: file.create_dataset(name, data=np.array([2**63], "u8")),
        lambda: file.create_dataset(name, data=np.zeros(3, "f2")),
        lambda: file.create_dataset(name, (2,), h5py.string_dtype("ascii", 5)),
        lambda: file.create_dataset(name, (2,), h5py.string_dtype()),
    )
    made[rng.integers(len(made))]()


def _attributes(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    values = (
        mutations_stored.text(rng),
        np.arange(5),
        h5py.Empty("f8"),
        np.bytes_(b"\xff\xfe"),
        7,
        ["a", "b"],
        mutations_stored.text(rng).replace("\0", "x"),
    )
    chosen = values[rng.integers(len(values))]
    key = mutations_stored.named(rng)
    if rng.random() < 0.2:
        file.attrs.pop(key, None)
    elif not (isinstance(chosen, str) and "\0" in chosen):
        file.attrs[key] = chosen


def _index(data: bytes, rng: np.random.Generator) -> bytes:
    """Change positions, sizes, types or names of nodes, break the provenance, or write no JSON at all."""

    def change(found: Any) -> Any:
        nodes, told = found["nodes"], found["provenance"]
        for _ in range(int(rng.integers(1, 3))):
            path = str(rng.choice([*nodes])) if nodes else "x"
            node = nodes.setdefault(path, ["<f8", [], 0])
            what = int(rng.integers(9))
            if what == 0:
                node[2] = NUMBERS[rng.integers(len(NUMBERS))]
            elif what == 1:
                node[2] = int(rng.integers(len(data)))
            elif what == 2:
                number = NUMBERS[rng.integers(len(NUMBERS))]
                shapes = ([number], [number, 0], [number, number], [1] * 100, number, "12", {}, [int(rng.integers(9))])
                node[1] = shapes[rng.integers(len(shapes))]
            elif what == 3:
                node[0] = TYPES[rng.integers(len(TYPES))]
            elif what == 4:
                nodes[PATHS[rng.integers(len(PATHS))]] = node
            elif what == 5:
                del nodes[path]
            elif what == 6:
                told[mutations_stored.named(rng)] = mutations_stored.text(rng)
            elif what == 7:
                told.pop(mutations_stored.named(rng), None)
            else:
                key = str(rng.choice(["nodes", "provenance", path]))
                found[key] = nodes[path] = NUMBERS[rng.integers(len(NUMBERS))]
                return found
        return found

    if rng.random() < 0.15:
        return reindex(data, lambda found: mutations_stored.text(rng).encode("utf-8", "replace"))
    return reindex(data, change)


def _structure(data: bytes, rng: np.random.Generator) -> bytes:
    """Add links, types and declarations that HDF5 allows but we never write."""
    stream = io.BytesIO(data)
    makers: tuple[Callable[[h5py.File, str, np.random.Generator], None], ...]
    makers = (_links, _elsewhere, _huge, _kinds, _attributes)
    with h5py.File(stream, "r+", libver=("v108", "v110")) as file:
        for _ in range(int(rng.integers(1, 3))):
            names = _datasets(file)
            name = names[rng.integers(len(names))] if names else "x"
            make = makers[rng.integers(len(makers))]
            if make is not _attributes:
                if name in file and rng.random() < 0.8:
                    del file[name]
                else:
                    name = f"extra{rng.integers(1000)}"
                if name in file:
                    continue
            make(file, name, rng)
            if make is _links:
                break  # rings make the next look at all datasets endless
    return stream.getvalue()


def _edit(data: bytearray, rng: np.random.Generator) -> None:
    chance = rng.random()
    if chance < 0.4:
        data[:] = _index(bytes(data), rng)
    elif chance < 0.65:
        data[:] = _structure(bytes(data), rng)
    if chance >= 0.65 or rng.random() < 0.15:
        mutations_bytes.apply(data, rng)
    if rng.random() < 0.85:
        data[:] = reseal(bytes(data))


def hdf5(data: bytearray, rng: np.random.Generator) -> None:
    """Damage an HDF5 artefact."""
    mutations_stored.or_bytes(_edit, data, rng)
