"""Trees as HDF5 files: types from the schema, units in dataset attributes, provenance in file attributes.

The HDF5 library writes a tree. Reading does not need the library, because it uses the index in
:mod:`mocap_id.store.userblock`.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.store import userblock
from mocap_id.store.artefacts import Node, Tree
from mocap_id.store.columns import TreeSchema
from mocap_id.store.parquet import read_provenance
from mocap_id.store.provenance import Origin, Provenance

Leaves: TypeAlias = dict[str, np.ndarray[Any, Any]]
"""Arrays by their path in the file; texts are numpy ``U`` arrays, scalars have shape ()."""

_KINDS = {"float64": "fiu", "int64": "iu", "bool": "b", "str": "UO"}
_STORED = {"float64": "<f8", "int64": "<i8", "bool": "|b1", "str": "U"}


def encode(tree: Tree, origin: Origin) -> bytes:
    """Return the bytes of a tree's HDF5 file; ValueError if the tree does not match its schema."""
    provenance = Provenance(tree.schema.file, tree.schema.version, origin, tree.facts, tree.reasons).encode()
    arrays = {path: _encode_texts(array) for path, array in _find_arrays(tree).items()}
    size = userblock.compute_block_size(
        {path: (array.dtype.str, array.shape) for path, array in arrays.items()}, provenance
    )
    file, places = _write(tree.schema, arrays, provenance, size)
    whole = userblock.fill_block(file, size, places, provenance)
    found = userblock.read(whole)[0]
    if any(_encode_texts(found[path]).tobytes() != array.tobytes() for path, array in arrays.items()):
        raise ValueError(
            f"{tree.schema.file} is damaged: the HDF5 library wrote values at other positions than it reports"
        )
    return whole


def _encode_texts(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return an array as stored: texts are encoded as UTF-8 and padded to the length of the longest."""
    return np.char.encode(array, "utf-8") if array.dtype.kind == "U" else array


def _write(
    schema: TreeSchema, arrays: Leaves, provenance: Mapping[str, str], size: int
) -> tuple[bytes, dict[str, userblock.Place]]:
    """Return the bytes of an HDF5 file, of which the first ``size`` are free, and the positions of its datasets."""
    import h5py  # noqa: PLC0415  reading does not need it

    stream, places = io.BytesIO(), {}
    with h5py.File(stream, "w", libver=("v108", "v110"), userblock_size=size) as file:  # allows attributes > 64 KiB
        for node in schema.expand_nodes(arrays):
            array = arrays[node.name]
            text = h5py.string_dtype("utf-8", array.dtype.itemsize) if array.dtype.kind == "S" else None
            data = array.astype(text) if text else array
            dataset = file.create_dataset(node.name, data=data, track_times=False)
            dataset.attrs["unit"], dataset.attrs["meaning"] = node.unit, node.meaning
            start = dataset.id.get_offset() if array.size else 0
            places[node.name] = userblock.Place(array.dtype.str, array.shape, start)
        for key, value in provenance.items():
            file.attrs[key] = value
    return stream.getvalue(), places


def decode(content: bytes, schema: TreeSchema) -> tuple[Tree, Provenance]:
    """Read a tree from the bytes of an HDF5 file and check it against its hash and its schema.

    Raises ValueError if the file is damaged, from another program or of another schema. The message has no subject,
    because the caller writes the file name before it.
    """
    leaves, metadata = userblock.read(content)
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_find_mismatches(leaves, schema))
    if problem:
        raise ValueError(f"does not have the nodes of its schema: {problem}")
    return Tree(schema, _nest(leaves), provenance.facts, provenance.reasons), provenance


def conform(tree: Tree) -> Tree:
    """Return a tree with exactly the nodes and types of its schema, as :func:`decode` would return it.

    Raises ValueError if a node is missing, unknown or of another type.
    """
    return replace(tree, data=_nest(_find_arrays(tree)))


def _find_arrays(tree: Tree) -> Leaves:
    """Return the arrays of a tree by path, with the types of the schema; ValueError as for :func:`conform`."""
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
        if array.size and array.dtype.kind not in _KINDS[node.dtype]:
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
