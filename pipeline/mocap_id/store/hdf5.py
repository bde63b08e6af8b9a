"""Trees as HDF5: typed by their schema, units in the dataset attributes, provenance in the file's attributes.

A tree is written by the HDF5 library and read without it: by the block that :mod:`mocap_id.store.sealed` puts before.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.store import sealed
from mocap_id.store.artefacts import Node, Tree, TreeSchema
from mocap_id.store.parquet import read_provenance
from mocap_id.store.provenance import Origin, Provenance

Leaves: TypeAlias = dict[str, np.ndarray[Any, Any]]
"""Path in the file → array; strings as numpy ``U`` arrays, scalars with shape ()."""

_KINDS = {"float64": "fiu", "int64": "iu", "bool": "b", "str": "UO"}
_STORED = {"float64": "<f8", "int64": "<i8", "bool": "|b1", "str": "U"}


def encode(tree: Tree, origin: Origin) -> bytes:
    """The tree as the bytes of an HDF5 file.

    Raises
    ------
    ValueError
        The tree does not have the nodes or types that its schema promises.
    """
    told = Provenance(tree.schema.file, tree.schema.version, origin, tree.facts, tree.reasons).encode()
    arrays = {path: _stored(array) for path, array in _leaves(tree).items()}
    size = sealed.room({path: (array.dtype.str, array.shape) for path, array in arrays.items()}, told)
    file, places = _write(tree.schema, arrays, told, size)
    whole = sealed.seal(file, size, places, told)
    found = sealed.opened(whole)[0]
    if any(_stored(found[path]).tobytes() != array.tobytes() for path, array in arrays.items()):
        raise ValueError(f"{tree.schema.file} is damaged: the HDF5 library put values elsewhere than it says")
    return whole


def _stored(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """As it stands in the file: all texts of an array as long as the longest, so that they stand beside each other."""
    return np.char.encode(array, "utf-8") if array.dtype.kind == "U" else array


def _write(
    schema: TreeSchema, arrays: Leaves, provenance: Mapping[str, str], size: int
) -> tuple[bytes, dict[str, sealed.Place]]:
    """An HDF5 file whose first ``size`` bytes are free, and where in it the datasets stand."""
    import h5py  # noqa: PLC0415  reading does without

    stream, places = io.BytesIO(), {}
    with h5py.File(stream, "w", libver=("v108", "v110"), userblock_size=size) as file:  # it holds attributes > 64 KiB
        for node in schema.nodes:
            array = arrays[node.name]
            text = h5py.string_dtype("utf-8", array.dtype.itemsize) if array.dtype.kind == "S" else None
            data = array.astype(text) if text else array
            dataset = file.create_dataset(node.name, data=data, track_times=False)
            dataset.attrs["unit"], dataset.attrs["meaning"] = node.unit, node.meaning
            start = dataset.id.get_offset() if array.size else 0
            places[node.name] = sealed.Place(array.dtype.str, array.shape, start)
        for key, value in provenance.items():
            file.attrs[key] = value
    return stream.getvalue(), places


def decode(content: bytes, schema: TreeSchema) -> tuple[Tree, Provenance]:
    """The tree of an HDF5 file's bytes, checked against its seal and its schema.

    Raises
    ------
    ValueError
        The file is damaged, not ours or is not of this schema; the message completes "FILE …".
    """
    leaves, metadata = sealed.opened(content)
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_mismatches(leaves, schema))
    if problem:
        raise ValueError(f"does not have its nodes: {problem}")
    return Tree(schema, _nested(leaves), provenance.facts, provenance.reasons), provenance


def conform(tree: Tree) -> Tree:
    """The same with exactly its schema's nodes and types, as :func:`decode` gives it.

    Raises
    ------
    ValueError
        A node is missing, unknown or of another type.
    """
    return replace(tree, data=_nested(_leaves(tree)))


def _leaves(tree: Tree) -> Leaves:
    """The tree's leaves by path; ValueError as for :func:`conform`."""
    leaves = dict(_flat(tree.data, ""))
    problem = "; ".join(_mismatches(leaves, tree.schema))
    unknown = sorted(set(leaves) - {node.name for node in tree.schema.nodes})
    if unknown:
        problem += f"; nodes that its schema does not name: {', '.join(unknown)}"
    if problem:
        raise ValueError(f"{tree.schema.file}: {problem.removeprefix('; ')}")
    types = {node.name: np.dtype(_STORED[node.dtype]) for node in tree.schema.nodes}
    return {path: np.ascontiguousarray(array, dtype=types[path]).reshape(array.shape) for path, array in leaves.items()}


def _flat(data: Mapping[str, Node], above: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    for name, node in data.items():
        if isinstance(node, Mapping):
            yield from _flat(node, f"{above}{name}/")
        else:
            yield above + name, np.asarray(node)


def _mismatches(leaves: Leaves, schema: TreeSchema) -> Iterator[str]:
    for node in schema.nodes:
        if node.name not in leaves:
            yield f"`{node.name}` is missing"
            continue
        array = leaves[node.name]
        if array.size and array.dtype.kind not in _KINDS[node.dtype]:
            yield f"`{node.name}` holds {array.dtype}, expected {node.dtype}"


def _nested(leaves: Leaves) -> dict[str, Any]:
    """Leaves as nested names; scalars as Python's own types."""
    root: dict[str, Any] = {}
    for path, array in leaves.items():
        *groups, name = path.split("/")
        place = root
        for group in groups:
            place = place.setdefault(group, {})
        place[name] = array if array.ndim else array.item()
    return root
