"""Content hashes: of the data with facts and reasons, never of file bytes, so that provenance does not count."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mocap_id.store.artefacts import Facts
from mocap_id.store.provenance import dumps
from mocap_id.verdict import Reason

_CHUNK = 1 << 20  # bytes of a file
_ROWS = 1 << 17  # numbers of an array, at a time


class TableHash:
    """Hash of a table's columns (names, types, values), facts and reasons, taken up column by column.

    NaN is one value whatever its bits, −0 is 0, and strings count by their values, not by the order or the leftovers
    of a dictionary.
    """

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, name: str, column: pa.ChunkedArray) -> None:
        """Take up the next column."""
        digest = self._digest
        digest.update(f"column {name} ".encode())
        if _is_text(column.type):
            values, codes = ranked_strings(column)
            digest.update(f"strings {dumps(values)} {np.dtype(np.int64).str} {(len(column),)} ".encode())
            for part in codes:
                digest.update(part.data)
            return
        if column.null_count and pa.types.is_integer(column.type):
            _add_array(digest, column.is_null().to_numpy())
            column = pc.fill_null(column, 0)
        _add_array(digest, column.to_numpy())

    def result(self, facts: Facts, reasons: Iterable[Reason]) -> str:
        """The hash, once all columns are taken up."""
        return _finish(self._digest, facts, reasons)


def hash_nodes(nodes: Mapping[str, np.ndarray[Any, Any]], facts: Facts, reasons: Iterable[Reason]) -> str:
    """Hash of a tree's leaves (path → array), facts and reasons; the order of the paths does not count."""
    digest = hashlib.sha256()
    for path in sorted(nodes):
        digest.update(f"node {path} ".encode())
        _add_array(digest, nodes[path])
    return _finish(digest, facts, reasons)


def hash_bytes(content: bytes) -> str:
    """Hash of a document or of a canonical string."""
    return hashlib.sha256(content).hexdigest()


def hash_file(path: Path) -> str:
    """Hash of a file's bytes.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def _finish(digest: Any, facts: Facts, reasons: Iterable[Reason]) -> str:
    digest.update(f"facts {dumps(facts)}\n".encode())
    digest.update(f"reasons {dumps([reason.as_dict() for reason in reasons])}\n".encode())
    result: str = digest.hexdigest()
    return result


def _is_text(kind: pa.DataType) -> bool:
    return pa.types.is_dictionary(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind)


def ranked_strings(column: pa.ChunkedArray) -> tuple[list[str], Iterator[np.ndarray[Any, Any]]]:
    """Sorted values in use and, part by part, for each row the index of its value (int64; −1 = null)."""
    encoded = column if pa.types.is_dictionary(column.type) else column.dictionary_encode()
    whole = encoded.unify_dictionaries()
    if not whole.num_chunks:
        return [], iter(())
    dictionary = whole.chunk(0).dictionary.to_pylist()

    def parts() -> Iterator[np.ndarray[Any, Any]]:
        for chunk in whole.chunks:
            for start in range(0, len(chunk), _ROWS):
                codes = pc.fill_null(chunk.indices.slice(start, _ROWS).cast(pa.int64()), -1)
                yield codes.to_numpy(zero_copy_only=False)

    found = {int(code) for part in parts() for code in np.unique(part) if code >= 0}
    used = sorted(dictionary[code] for code in found)
    rank = {value: index for index, value in enumerate(used)}
    order = np.array([*(rank.get(value, -1) for value in dictionary), -1], np.int64)  # the last one answers to code −1
    return used, (order[part] for part in parts())


def _add_array(digest: Any, array: np.ndarray[Any, Any]) -> None:
    if array.dtype.kind in "OUT":
        digest.update(f"strings {array.shape} {dumps(array.tolist())} ".encode())
        return
    digest.update(f"{array.dtype.str} {array.shape} ".encode())
    flat = np.ascontiguousarray(array).reshape(-1)
    for start in range(0, flat.size, _ROWS):
        digest.update(_canonical(flat[start : start + _ROWS]).data)


def _canonical(part: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """With one NaN and one zero."""
    if part.dtype.kind != "f":
        return part
    part = part.copy()
    part[np.isnan(part)] = np.nan
    part[part == 0] = 0
    return part
