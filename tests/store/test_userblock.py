"""The file of a tree is valid HDF5, is checked by its hash before reading, and is read without the HDF5 library."""

from __future__ import annotations

import io
import sys
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_id.store import Column, Origin, Tree, TreeSchema, hdf5
from mocap_id.store.provenance import CHAIN

ORIGIN = Origin("fit-joints", 3, {"segment": {"count": 4}}, {"planar.parquet": "ab" * 32}, "key-1", 1.25)
KINDS = TreeSchema(
    "kinds.h5",
    1,
    (
        Column("name", "str", "", "one text"),
        Column("deep/er/count", "int64", "1", "one number"),
        Column("yes", "bool", "", "(n,)"),
        Column("deep/texts", "str", "", "(n, 2)"),
        Column("nothing", "float64", "m", "(0, 3)"),
        Column("no_texts", "str", "", "(0,)"),
    ),
)


def kinds(facts: dict[str, Any] | None = None) -> Tree:
    deep = {"er": {"count": 7}, "texts": np.array([["Ä", ""], ["日本", "a\tb"], ["x" * 999, "y"]])}
    data = {"name": "Hüfte", "deep": deep, "yes": np.array([True, False, True]), "nothing": np.zeros((0, 3))}
    return Tree(KINDS, data | {"no_texts": np.array([], dtype=str)}, facts or {})


def chain(joints: int) -> Tree:
    rng = np.random.default_rng(joints)
    names = [f"joint {j} ä" for j in range(joints)]
    data = {
        "joints": {
            "name": np.array(names, dtype=str),
            "parent": np.arange(joints),
            "centre": np.asfortranarray(rng.normal(size=(joints, 2))),
            "covariance": rng.normal(size=(joints, 2, 2)).transpose(0, 2, 1),
            "arc": np.full(joints, np.nan),
        },
        "segments": {"name": ["base", *names], "length": rng.normal(size=joints), "length_sd": np.zeros(0)},
        "markers": {"name": ["Ä", "B"], "segment": [0, 1], "local": np.zeros((2, 2)), "residual": [np.nan, 1.0]},
    }
    return Tree(CHAIN, data, {"iterations": 4})


TREES = {"kinds": kinds(), "long facts": kinds({"text": "ü" * 200_000}), **{f"chain {n}": chain(n) for n in (0, 1, 9)}}


def leaves(data: Any, above: str = "") -> dict[str, Any]:
    found = {}
    for name, item in data.items():
        found |= leaves(item, f"{above}{name}/") if isinstance(item, dict) else {above + name: item}
    return found


@pytest.mark.parametrize("name", TREES)
def test_plain_h5py_reads_the_same(name: str) -> None:
    """The HDF5 library confirms the index."""
    tree = TREES[name]
    content = hdf5.encode_tree(tree, ORIGIN)
    ours = leaves(hdf5.decode_tree(content, tree.schema)[0].data)
    assert ours.keys() == {node.name for node in tree.schema.nodes}
    with h5py.File(io.BytesIO(content)) as file:
        for node in tree.schema.nodes:
            dataset = file[node.name]
            theirs = dataset.asstr()[()] if h5py.check_string_dtype(dataset.dtype) else dataset[()]
            np.testing.assert_array_equal(np.asarray(theirs), np.asarray(ours[node.name]), strict=False)
            assert (dataset.attrs["unit"], dataset.attrs["meaning"]) == (node.unit, node.meaning)
        assert {key for key in file.attrs if isinstance(file.attrs[key], str)} == set(file.attrs)
        assert file.attrs["mocap-id.schema"] == tree.schema.file
        block = file.userblock_size
    assert block >= 512
    assert block & (block - 1) == 0
    content[:block].decode("utf-8")  # text that people can read


@pytest.mark.parametrize("name", TREES)
def test_a_tree_is_read_without_the_hdf5_library(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    content = hdf5.encode_tree(TREES[name], ORIGIN)
    monkeypatch.setitem(sys.modules, "h5py", None)
    tree, provenance = hdf5.decode_tree(content, TREES[name].schema)
    assert provenance.origin == ORIGIN
    given, found = leaves(TREES[name].data), leaves(tree.data)
    assert given.keys() == found.keys()
    for path, array in given.items():
        np.testing.assert_array_equal(np.asarray(found[path]), np.asarray(array))
    with pytest.raises(ImportError):
        hdf5.encode_tree(TREES[name], ORIGIN)


WHOLE = hdf5.encode_tree(chain(3), ORIGIN)


@settings(max_examples=200, deadline=None)
@given(at=st.integers(0, len(WHOLE) - 1), bit=st.integers(0, 7))
def test_every_bit_counts(at: int, bit: int) -> None:
    spoilt = bytearray(WHOLE)
    spoilt[at] ^= 1 << bit
    with pytest.raises(ValueError, match="is damaged"):
        hdf5.decode_tree(bytes(spoilt), CHAIN)


@settings(max_examples=100, deadline=None)
@given(length=st.integers(0, len(WHOLE) - 1))
def test_every_byte_counts(length: int) -> None:
    for spoilt in (WHOLE[:length], WHOLE + WHOLE[length:], WHOLE[:length] + WHOLE[length + 1 :]):
        with pytest.raises(ValueError, match="is damaged"):
            hdf5.decode_tree(spoilt, CHAIN)


def test_hdf5_without_the_hash_of_mocap_id() -> None:
    with pytest.raises(ValueError, match="is HDF5 without the hash of mocap-id: an earlier version"):
        hdf5.decode_tree(WHOLE[WHOLE.index(b"\x89HDF") :], CHAIN)


def test_a_wrong_place_in_the_index_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a wrong place the file could not be read, so it must not be written."""
    format_index = hdf5._format_index

    def elsewhere(places: hdf5.Places, provenance: dict[str, str]) -> bytes:
        wrong = {path: (dtype, shape, start ^ 8) for path, (dtype, shape, start) in places.items()}
        return format_index(wrong, provenance)

    monkeypatch.setattr(hdf5, "_format_index", elsewhere)
    with pytest.raises(ValueError, match="is damaged"):
        hdf5.encode_tree(chain(3), ORIGIN)
