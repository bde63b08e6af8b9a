"""Content hashes: of the data with facts and reasons, never of file bytes, so that provenance does not count."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mocap_id.arrays import IntArray, chunks
from mocap_id.store.artefacts import Facts
from mocap_id.store.provenance import dumps
from mocap_id.verdict import Reason

Parts: TypeAlias = Callable[[], Iterable[pa.Array]]
"""A column's values, in as many arrays as its owner likes; asked for more than once."""

_ROWS = 1 << 17  # numbers of an array, at a time


class TableHash:
    """Hash of a table's columns (names, types, values), facts and reasons, taken up column by column.

    NaN is one value whatever its bits, −0 is 0, and strings count by their values, not by the order or the leftovers
    of a dictionary.
    """

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, name: str, kind: pa.DataType, length: int, parts: Parts) -> None:
        """Take up the next column, of so many values in parts."""
        digest = self._digest
        digest.update(f"column {name} ".encode())
        if _is_text(kind):
            values, codes = ranked_strings(parts)
            digest.update(f"strings {dumps(values)} ".encode())
            _add_numbers(digest, np.dtype(np.int64), length, codes)
            return
        if pa.types.is_integer(kind) and any(part.null_count for part in parts()):
            missing = (part.is_null().to_numpy(zero_copy_only=False) for part in parts())
            _add_numbers(digest, np.dtype(np.bool_), length, missing)
            filled = (pc.fill_null(part, 0) for part in parts())
        else:
            filled = (part for part in parts())
        numbers = (part.to_numpy(zero_copy_only=False) for part in filled)
        _add_numbers(digest, np.dtype(kind.to_pandas_dtype()), length, numbers)

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


def _finish(digest: Any, facts: Facts, reasons: Iterable[Reason]) -> str:
    digest.update(f"facts {dumps(facts)}\n".encode())
    digest.update(f"reasons {dumps([reason.as_dict() for reason in reasons])}\n".encode())
    result: str = digest.hexdigest()
    return result


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_dictionary(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind))


def ranked_strings(parts: Parts) -> tuple[list[str], Iterator[IntArray]]:
    """Sorted values in use and, part by part, for each row the index of its value (−1 = null)."""

    def encoded() -> Iterator[tuple[list[str], IntArray]]:
        for part in parts():
            whole = part if pa.types.is_dictionary(part.type) else part.dictionary_encode()
            codes = pc.fill_null(whole.indices.cast(pa.int64()), -1).to_numpy(zero_copy_only=False)
            yield whole.dictionary.to_pylist(), codes

    used = sorted({values[code] for values, codes in encoded() for code in np.unique(codes) if code >= 0})
    rank = {value: index for index, value in enumerate(used)}

    def ranked() -> Iterator[IntArray]:
        for values, codes in encoded():
            yield np.array([*(rank.get(value, -1) for value in values), -1], np.int64)[codes]  # code −1: the last one

    return used, ranked()


def _add_numbers(digest: Any, dtype: np.dtype[Any], length: int, parts: Iterable[np.ndarray[Any, Any]]) -> None:
    """Take up an array of one dimension, given in parts, as :func:`_add_array` does the whole."""
    digest.update(f"{dtype.str} {(length,)} ".encode())
    for part in parts:
        _add_canonical(digest, part)


def _add_array(digest: Any, array: np.ndarray[Any, Any]) -> None:
    if array.dtype.kind in "OUT":
        digest.update(f"strings {array.shape} {dumps(array.tolist())} ".encode())
        return
    digest.update(f"{array.dtype.str} {array.shape} ".encode())
    _add_canonical(digest, np.ascontiguousarray(array).reshape(-1))


def _add_canonical(digest: Any, numbers: np.ndarray[Any, Any]) -> None:
    """Take up numbers, with one NaN and one zero."""
    for rows in chunks(len(numbers), _ROWS):
        part = numbers[rows]
        if part.dtype.kind == "f":
            part = part.copy()
            part[np.isnan(part)] = np.nan
            part[part == 0] = 0
        digest.update(np.ascontiguousarray(part).data)
