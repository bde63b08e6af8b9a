"""Content hashes: of the data with facts and reasons, never of file bytes, so that provenance does not count."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mocap_id.store.artefacts import Facts
from mocap_id.store.provenance import dumps
from mocap_id.verdict import Reason

_CHUNK = 1 << 20


def hash_table(table: pa.Table, facts: Facts, reasons: Iterable[Reason]) -> str:
    """Hash of a table's columns (names, types, values), facts and reasons.

    NaN is one value whatever its bits, −0 is 0, and strings count by their values, not by the order or the leftovers
    of a dictionary.
    """
    digest = hashlib.sha256()
    for name in table.column_names:
        digest.update(f"column {name} ".encode())
        _add_column(digest, table.column(name))
    return _finish(digest, facts, reasons)


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


def _add_column(digest: Any, column: pa.ChunkedArray) -> None:
    if pa.types.is_dictionary(column.type) or pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        values, codes = canonical_strings(column)
        digest.update(f"strings {dumps(values)} ".encode())
        _add_array(digest, codes)
        return
    if column.null_count and pa.types.is_integer(column.type):
        _add_array(digest, column.is_null().to_numpy())
        column = pc.fill_null(column, 0)
    _add_array(digest, column.to_numpy())


def canonical_strings(column: pa.ChunkedArray) -> tuple[list[str], np.ndarray[Any, Any]]:
    """Sorted values in use and, for each row, the index of its value (int64; −1 = null)."""
    encoded = column if pa.types.is_dictionary(column.type) else column.dictionary_encode()
    whole = encoded.unify_dictionaries().combine_chunks()
    if isinstance(whole, pa.ChunkedArray):  # an empty column has no chunk to combine
        return [], np.empty(0, np.int64)
    codes = pc.fill_null(whole.indices.cast(pa.int64()), -1).to_numpy(zero_copy_only=False)
    dictionary = whole.dictionary.to_pylist()
    used = sorted(dictionary[code] for code in np.unique(codes) if code >= 0)
    rank = {value: index for index, value in enumerate(used)}
    order = np.array([*(rank.get(value, -1) for value in dictionary), -1], np.int64)  # the last one answers to code −1
    return used, order[codes]


def _add_array(digest: Any, array: np.ndarray[Any, Any]) -> None:
    if array.dtype.kind in "OUT":
        digest.update(f"strings {array.shape} {dumps(array.tolist())} ".encode())
        return
    if array.dtype.kind == "f":
        array = array.copy()
        array[np.isnan(array)] = np.nan
        array[array == 0] = 0
    digest.update(f"{array.dtype.str} {array.shape} ".encode())
    digest.update(np.ascontiguousarray(array).data)
