"""Trees as HDF5: typed by their schema, units in the dataset attributes, provenance in the file's attributes."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import h5py
import numpy as np

from mocap_id.store.artefacts import Node, Tree, TreeSchema
from mocap_id.store.content import hash_nodes
from mocap_id.store.parquet import read_provenance
from mocap_id.store.provenance import Origin, Provenance

Leaves: TypeAlias = dict[str, np.ndarray[Any, Any]]
"""Path in the file → array; strings as numpy ``U`` arrays, scalars with shape ()."""

_KINDS = {"float64": "fiu", "int64": "iu", "bool": "b", "str": "UO"}
_BROKEN = (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, UnicodeError)
"""What the library raises on damaged files."""
_MOST_NODES, _MOST_TEXTS = 1000, 5000
_ROOM, _LEAST_ROOM = 4, 1 << 24
"""Bytes in memory for each byte of the file, which is never compressed (text takes four a character); and at least."""


def encode(tree: Tree, origin: Origin) -> tuple[bytes, str]:
    """The tree as the bytes of an HDF5 file, and its content hash.

    Raises
    ------
    ValueError
        The tree does not have the nodes or types that its schema promises.
    """
    leaves = conform(tree)
    content = hash_nodes(leaves, tree.facts, tree.reasons)
    provenance = Provenance(tree.schema.file, tree.schema.version, origin, content, tree.facts, tree.reasons)
    stream = io.BytesIO()
    with h5py.File(stream, "w", libver=("v108", "v110")) as file:  # this format holds attributes over 64 KiB
        for node in tree.schema.nodes:
            array = leaves[node.name]
            text = h5py.string_dtype() if array.dtype.kind == "U" else None
            data = array.astype(object) if text else array
            dataset = file.create_dataset(node.name, data=data, dtype=text, track_times=False)
            dataset.attrs["unit"], dataset.attrs["meaning"] = node.unit, node.meaning
        for key, value in provenance.encode().items():
            file.attrs[key] = value
    return stream.getvalue(), content


def decode(content: bytes, schema: TreeSchema) -> tuple[Tree, Provenance]:
    """The tree of an HDF5 file's bytes, checked against its schema and its own content hash.

    Raises
    ------
    ValueError
        The file is damaged, not ours, links elsewhere or is not of this schema; the message completes "FILE …".
    """
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            leaves = dict(_Walk(len(content)).leaves(file, ""))
            metadata = {key: value for key, value in file.attrs.items() if isinstance(value, str)}
    except _BROKEN as error:
        raise ValueError(f"is damaged ({str(error).partition(chr(10))[0]})") from error
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_mismatches(leaves, schema))
    if problem:
        raise ValueError(f"does not have its nodes: {problem}")
    if hash_nodes(leaves, provenance.facts, provenance.reasons) != provenance.content:
        raise ValueError("is damaged or was edited: its content does not match its own hash")
    return Tree(schema, _nested(leaves), provenance.facts, provenance.reasons), provenance


def conform(tree: Tree) -> Leaves:
    """The tree's leaves by path, with exactly its schema's nodes and types.

    Raises
    ------
    ValueError
        A node is missing, unknown or of another type.
    """
    leaves = dict(_flat(tree.data, ""))
    problem = "; ".join(_mismatches(leaves, tree.schema))
    unknown = sorted(set(leaves) - {node.name for node in tree.schema.nodes})
    if unknown:
        problem += f"; nodes that its schema does not name: {', '.join(unknown)}"
    if problem:
        raise ValueError(f"{tree.schema.file}: {problem.removeprefix('; ')}")
    types = {node.name: np.dtype("U" if node.dtype == "str" else node.dtype) for node in tree.schema.nodes}
    return {path: array.astype(types[path], copy=False) for path, array in leaves.items()}


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


class _Walk:
    """A way through a file that trusts nothing of it.

    Whatever points outside the file is refused before it is opened, whatever declares more values than the file can
    hold before it is read, and no object is visited twice: links may lead round in rings.

    Parameters
    ----------
    size : int
        Bytes of the file.
    """

    def __init__(self, size: int) -> None:
        self._left = _ROOM * size + _LEAST_ROOM
        self._seen: set[Any] = set()

    def leaves(self, group: h5py.Group, above: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
        """Every dataset of a group, by its path.

        Raises
        ------
        ValueError
            The file is not as this program writes it; the message completes "FILE …".
        """
        self._enter(group, above)
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise ValueError(f"holds a link at `{above}{name}`, which could lead to another file: refused")
            item = group[name]
            if isinstance(item, h5py.Group):
                yield from self.leaves(item, f"{above}{name}/")
            elif isinstance(item, h5py.Dataset):
                self._enter(item, above + name)
                yield above + name, self._array(item, above + name)

    def _enter(self, item: h5py.Group | h5py.Dataset, path: str) -> None:
        found = h5py.h5o.get_info(item.id)
        place = (found.fileno, found.addr)
        if place in self._seen:
            raise ValueError(f"holds an object twice, once at `{path}`: refused")
        self._seen.add(place)
        if len(self._seen) > _MOST_NODES:
            raise ValueError(f"holds more than {_MOST_NODES} objects: refused")

    def _array(self, dataset: h5py.Dataset, path: str) -> np.ndarray[Any, Any]:
        if dataset.external or dataset.is_virtual:
            raise ValueError(f"keeps the values of `{path}` in another file: refused")
        if dataset.shape is None or dataset.dtype.kind not in "biufSO":
            raise ValueError(f"holds values of a kind that no node has at `{path}`: {dataset.dtype}")
        self._take(math.prod(dataset.shape) * dataset.dtype.itemsize, path)
        if h5py.check_string_dtype(dataset.dtype):
            return self._text(dataset, path)
        if dataset.dtype.kind == "O":
            raise ValueError(f"holds references or lists at `{path}`: refused")
        return np.asarray(dataset[()])

    def _text(self, dataset: h5py.Dataset, path: str) -> np.ndarray[Any, Any]:
        """Strings one by one: many of them may stand for one and the same long one."""
        if math.prod(dataset.shape) > _MOST_TEXTS:
            raise ValueError(f"holds more than {_MOST_TEXTS} texts at `{path}`: refused")
        texts: list[str] = []
        for index in np.ndindex(dataset.shape):
            texts.append(dataset.asstr()[index])
            self._take(4 * len(texts[-1]), path)
        self._take(4 * len(texts) * max(map(len, texts), default=0), path)  # all are as wide as the longest
        return np.array(texts, dtype="U").reshape(dataset.shape)

    def _take(self, needed: int, path: str) -> None:
        """Count off memory; what the file cannot hold is refused."""
        self._left -= needed
        if self._left < 0:
            raise ValueError(f"declares more values than it holds at `{path}`: refused")


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
