"""Trees as HDF5 files: types from the schema, units and provenance in attributes, and an index in the user block.

The HDF5 library writes a tree. Reading does not need the library, because it uses the index in the user block.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from mocap_id.errors import first_line
from mocap_id.store.artefacts import KINDS, Node, Tree
from mocap_id.store.parquet import read_provenance
from mocap_id.store.provenance import Origin, Provenance, TreeSchema, dumps

Leaves: TypeAlias = dict[str, np.ndarray[Any, Any]]
"""Arrays by their path in the file; texts are numpy ``U`` arrays, scalars have shape ()."""

Places: TypeAlias = dict[str, tuple[str, tuple[int, ...], int]]
"""Position of the values of each dataset, by its path: type, shape, and offset of the first byte; in C order.

The type is ``<f8``, ``<i8``, ``|b1``, or ``|S`` and the bytes of each text (UTF-8, padded with NULs)."""

_STORED = {"float64": "<f8", "int64": "<i8", "bool": "|b1", "str": "U"}


def encode_tree(tree: Tree, origin: Origin) -> bytes:
    """Return the bytes of a tree's HDF5 file; ValueError if the tree does not match its schema."""
    provenance = Provenance(tree.schema.file, tree.schema.version, origin, tree.facts, tree.reasons).encode()
    arrays = {path: _encode_texts(array) for path, array in _find_arrays(tree).items()}
    # The block at the beginning has a size that can index the datasets at any offset.
    farthest = {path: (array.dtype.str, array.shape, _FARTHEST) for path, array in arrays.items()}
    needed, size = _HEAD + len(_format_index(farthest, provenance)), _SMALLEST
    while size < needed:
        size *= 2
    import h5py  # noqa: PLC0415  reading does not need it

    stream, places = io.BytesIO(), Places()
    with h5py.File(stream, "w", libver=("v108", "v110"), userblock_size=size) as file:  # allows attributes > 64 KiB
        for node in tree.schema.expand_nodes(arrays):
            array = arrays[node.name]
            text = h5py.string_dtype("utf-8", array.dtype.itemsize) if array.dtype.kind == "S" else None
            data = array.astype(text) if text else array
            dataset = file.create_dataset(node.name, data=data, track_times=False)
            dataset.attrs["unit"], dataset.attrs["meaning"] = node.unit, node.meaning
            start = dataset.id.get_offset() if array.size else 0
            places[node.name] = (array.dtype.str, array.shape, start)
        for key, value in provenance.items():
            file.attrs[key] = value
    rest = _format_index(places, provenance).ljust(size - _HEAD) + stream.getvalue()[size:]
    whole = _format_head(rest) + rest
    found = read_datasets(whole)[0]
    if any(_encode_texts(found[path]).tobytes() != array.tobytes() for path, array in arrays.items()):
        raise ValueError(
            f"{tree.schema.file} is damaged: the HDF5 library wrote values at other positions than it reports"
        )
    return whole


def _encode_texts(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return an array as stored: texts are encoded as UTF-8 and padded to the length of the longest."""
    return np.char.encode(array, "utf-8") if array.dtype.kind == "U" else array


def decode_tree(content: bytes, schema: TreeSchema) -> tuple[Tree, Provenance]:
    """Read a tree from the bytes of an HDF5 file and check it against its hash and its schema.

    Raises ValueError without a subject, because the caller writes the file name before it.
    """
    leaves, metadata = read_datasets(content)
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_find_mismatches(leaves, schema))
    if problem:
        raise ValueError(f"does not have the nodes of its schema: {problem}")
    return Tree(schema, _nest(leaves), provenance.facts, provenance.reasons), provenance


def conform_tree(tree: Tree) -> Tree:
    """Return a tree with exactly the nodes and types of its schema, as from its file; ValueError if they differ."""
    return replace(tree, data=_nest(_find_arrays(tree)))


def _find_arrays(tree: Tree) -> Leaves:
    """Return the arrays of a tree by path, with the types of the schema; ValueError if they differ."""
    leaves = dict(_flatten(tree.data, ""))
    problem = "; ".join(_find_mismatches(leaves, tree.schema))
    unknown = sorted(set(leaves) - {node.name for node in tree.schema.expand_nodes(leaves)})
    if unknown:
        problem += f"; nodes that are not in its schema: {', '.join(unknown)}"
    if problem:
        raise ValueError(f"{tree.schema.file}: {problem.removeprefix('; ')}")
    types = {node.name: np.dtype(_STORED[node.dtype]) for node in tree.schema.expand_nodes(leaves)}
    return {path: np.ascontiguousarray(array, dtype=types[path]).reshape(array.shape) for path, array in leaves.items()}


def _flatten(data: Mapping[str, Node], above: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    for name, node in data.items():
        if isinstance(node, Mapping):
            yield from _flatten(node, f"{above}{name}/")
        else:
            yield above + name, np.asarray(node)


def _find_mismatches(leaves: Leaves, schema: TreeSchema) -> Iterator[str]:
    for node in schema.expand_nodes(leaves):
        if node.name not in leaves:
            yield f"`{node.name}` is missing"
            continue
        array = leaves[node.name]
        if array.size and array.dtype.kind not in KINDS[node.dtype]:
            yield f"`{node.name}` has the type {array.dtype}, expected {node.dtype}"


def _nest(leaves: Leaves) -> dict[str, Any]:
    """Return nested mappings of names to arrays; scalars have Python types."""
    root: dict[str, Any] = {}
    for path, array in leaves.items():
        *groups, name = path.split("/")
        group = root
        for each in groups:
            group = group.setdefault(each, {})
        group[name] = array if array.ndim else array.item()
    return root


_TITLE = "mocap-id: HDF5 follows this block of text; SHA-256 of all after this line: "
_HEAD = len(_TITLE) + 64 + 1  # bytes of the first line
_SMALLEST = 512  # bytes, the smallest user block of HDF5
_FARTHEST = 1 << 40  # bytes; largest offset of a dataset
_HDF5 = b"\x89HDF\r\n\x1a\n"
_TYPE = re.compile(r"<f8|<i8|\|b1|\|S[1-9][0-9]{0,8}")
_PATH = re.compile(r"[^/\0]+(/[^/\0]+){0,7}")
_DAMAGED = "is damaged or was edited: its content does not match its own hash"


def read_datasets(content: bytes) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, str]]:
    """Return the datasets by path, and the provenance, from the bytes of a file; errors as for :func:`decode_tree`.

    Texts are numpy ``U`` arrays, scalars have shape (). The hash is checked before anything else.
    """
    if not content.startswith(_TITLE.encode()):
        if content.startswith(_HDF5):
            raise ValueError("is HDF5 without the hash of mocap-id: an earlier version or another program wrote it")
        raise ValueError("is damaged, or was not written by mocap-id: it does not begin with its hash")
    if content[:_HEAD] != _format_head(content[_HEAD:]):
        raise ValueError(_DAMAGED)
    try:
        index = json.loads(content[_HEAD : content.index(b"\n", _HEAD)])
        places = {path: (dtype, tuple(shape), start) for path, (dtype, shape, start) in index["nodes"].items()}
        provenance = {key: value for key, value in index["provenance"].items() if isinstance(value, str)}
        # Every dataset must lie within the file, and no two may overlap.
        taken = []  # first byte and end of every dataset with values
        for path, (dtype, shape, start) in places.items():
            if not _PATH.fullmatch(path) or not _TYPE.fullmatch(dtype):
                raise ValueError(f"a dataset has an invalid name or type: {path[:80]!r}, {dtype[:80]!r}")
            if any(type(number) is not int or not 0 <= number <= _FARTHEST for number in (*shape, start)):
                raise ValueError(f"`{path[:80]}` has an invalid shape or offset")
            end = start + math.prod(shape) * np.dtype(dtype).itemsize
            if end > len(content):
                raise ValueError(f"`{path[:80]}` ends after the end of the file")
            if end > start:
                taken.append((start, end))
        groups = {path[: slash.start()] for path in places for slash in re.finditer("/", path)}
        if groups & places.keys():
            raise ValueError(f"`{min(groups & places.keys())[:80]}` is both a dataset and a group")
        if any(start < end for (_, end), (start, _) in pairwise(sorted(taken))):
            raise ValueError("two datasets share bytes")
        datasets = {}
        for path, (dtype, shape, start) in places.items():
            values = np.frombuffer(content, dtype, math.prod(shape), start).reshape(shape)
            if dtype == "|b1" and (values.view(np.uint8) > 1).any():
                raise ValueError("a truth value that is neither true nor false")
            datasets[path] = np.char.decode(values, "utf-8") if dtype.startswith("|S") else values.copy()
        return datasets, provenance
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"is damaged ({first_line(error)[:200]})") from error


def _format_head(rest: bytes) -> bytes:
    return f"{_TITLE}{hashlib.sha256(rest).hexdigest()}\n".encode()


def _format_index(places: Places, provenance: Mapping[str, str]) -> bytes:
    return f"{dumps({'nodes': places, 'provenance': provenance})}\n".encode()
