"""What stands beside the outputs: bytes that are those written need no decoding, all others are looked into."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mocap_id.errors import StoreError
from mocap_id.store import Folder, Origin, Table, Tree, hash_bytes, parquet
from mocap_id.store.digest import HashedStream
from mocap_id.store.schemas import CHAIN, SCHEMAS, SEGMENTS

ORIGIN = Origin("segment", 3, {"segment": {"count": 4}}, {"planar.parquet": "ab" * 32}, "key-1", 1.25)
LATER = Origin("segment", 3, {"segment": {"count": 5}}, {"planar.parquet": "ab" * 32}, "key-2", 0.5)
FILES = [SEGMENTS.file, CHAIN.file]


def segments(residual: float = 0.001) -> Table:
    markers = ["RKNE", "LKNE"]
    columns = {"marker": pd.Categorical(markers), "segment": pd.array([1, 0], dtype="Int64")}
    return Table(SEGMENTS, pd.DataFrame({**columns, "residual": [residual, np.nan], "reason": ["moves", ""]}))


def chain() -> Tree:
    joints = {
        "name": ["knee"],
        "parent": [0],
        "centre": np.ones((1, 2)),
        "covariance": np.ones((1, 2, 2)),
        "arc": [0.5],
    }
    bodies = {"name": ["base", "shank"], "length": np.zeros(0), "length_sd": np.zeros(0)}
    markers = {"name": ["A"], "segment": [0], "local": np.zeros((1, 2)), "residual": [1.0]}
    return Tree(CHAIN, {"joints": joints, "segments": bodies, "markers": markers})


@pytest.fixture
def written(tmp_path: Path) -> Path:
    Folder(tmp_path).write([segments(), chain()], ORIGIN)
    return tmp_path


def undecodable(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("decoded")

    monkeypatch.setattr("mocap_id.store.parquet.decode", refuse)
    monkeypatch.setattr("mocap_id.store.hdf5.decode", refuse)


def test_what_was_written_is_known_without_decoding(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = {file: Folder(written).provenance(file) for file in FILES}
    undecodable(monkeypatch)
    folder = Folder(written)
    assert folder.origin("segment", FILES) == ORIGIN
    assert {file: folder.content(file) for file in FILES} == {file: one.content for file, one in told.items()}


def test_without_its_record_an_artefact_tells_the_same_of_itself(written: Path) -> None:
    before = [Folder(written).content(file) for file in FILES]
    (written / ".mocap-id" / "segment.json").unlink()
    folder = Folder(written)
    assert folder.origin("segment", FILES) == ORIGIN
    assert [folder.content(file) for file in FILES] == before


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("where", [0.2, 0.5, 0.8])
def test_one_wrong_byte_is_not_what_was_written(written: Path, file: str, where: float) -> None:
    path = written / file
    content = bytearray(path.read_bytes())
    content[int(where * len(content))] ^= 0x10
    path.write_bytes(content)
    folder = Folder(written)
    try:  # a byte that means nothing is no damage: the content is the same
        assert folder.content(file) == json.loads(record(written).read_text())["artefacts"][file]["content"]
    except StoreError as error:
        assert "Delete it and run again" in str(error)


def test_the_same_content_in_other_bytes_is_the_same(written: Path) -> None:
    (written / SEGMENTS.file).write_bytes(parquet.encode(segments(), LATER))
    folder = Folder(written)
    assert folder.content(SEGMENTS.file) == Folder(written).provenance(SEGMENTS.file).content
    assert folder.origin("segment", [SEGMENTS.file]) == LATER  # as the file says of itself
    assert folder.origin("segment", FILES) is None  # not written together


def test_an_exchanged_artefact_is_known_by_its_own_content(written: Path) -> None:
    before = Folder(written).content(SEGMENTS.file)
    (written / SEGMENTS.file).write_bytes(parquet.encode(segments(0.002), LATER))
    assert Folder(written).content(SEGMENTS.file) != before


def test_one_folder_follows_what_it_writes(written: Path) -> None:
    folder = Folder(written)
    before = folder.content(SEGMENTS.file)
    folder.write([segments(0.002), chain()], LATER)
    assert folder.content(SEGMENTS.file) != before
    assert folder.origin("segment", FILES) == LATER
    folder.forget("segment", FILES)
    assert folder.origin("segment", FILES) is None
    assert not record(written).exists()


def test_bytes_of_an_older_schema_are_not_taken_for_granted(written: Path) -> None:
    strings = json.loads(record(written).read_text())
    strings["artefacts"][SEGMENTS.file] |= {"schema_version": SCHEMAS[SEGMENTS.file].version + 1, "content": "of old"}
    record(written).write_text(json.dumps(strings))
    assert Folder(written).content(SEGMENTS.file) != "of old"


@pytest.mark.parametrize(
    "artefacts", [None, [], {"segments.parquet": None}, {"segments.parquet": {}}, {"segments.parquet": {"digest": 1}}]
)
def test_a_record_that_is_none_counts_as_absent(written: Path, artefacts: object) -> None:
    before = Folder(written).content(SEGMENTS.file)
    strings = json.loads(record(written).read_text())
    record(written).write_text(json.dumps(strings | {"artefacts": artefacts}))
    folder = Folder(written)
    assert folder.content(SEGMENTS.file) == before
    assert folder.origin("segment", FILES) == ORIGIN


def test_looking_at_what_is_up_to_date_loads_no_library_of_tables(written: Path) -> None:
    asked = "import sys; from pathlib import Path; from mocap_id.store import Folder"
    looked = f"print(Folder(Path({str(written)!r})).origin('segment', {FILES}).key); print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", f"{asked}; {looked}"], capture_output=True, text=True, check=True)
    key, modules = said.stdout.splitlines()
    assert key == "key-1"
    assert {"pandas", "pyarrow", "h5py", "scipy"} & set(modules.split()) == set()


def test_a_stream_hashes_what_goes_through_it() -> None:
    stream = io.BytesIO()
    hashed = HashedStream(stream)
    for part in (b"one", bytearray(b"two"), memoryview(b"three")):
        hashed.write(part)
    hashed.flush()
    assert hashed.tell() == 11
    assert hashed.hash() == hash_bytes(stream.getvalue())


def record(folder: Path) -> Path:
    return folder / ".mocap-id" / "segment.json"
