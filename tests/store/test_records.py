"""Records of outputs: unchanged files need no decoding, changed files are detected."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mocap_id.errors import StoreError
from mocap_id.store import Folder, LongTable, Origin, Table, Tree, hash_bytes, parquet
from mocap_id.store.atomic import HashedStream
from mocap_id.store.provenance import CHAIN, PLANAR, SCHEMAS, SEGMENTS

ORIGIN = Origin("segment", 3, {"segment": {"count": 4}}, {"planar.parquet": "ab" * 32}, "key-1", 1.25)
LATER = Origin("segment", 3, {"segment": {"count": 5}}, {"planar.parquet": "ab" * 32}, "key-2", 0.5)
FILES = [SEGMENTS.file, CHAIN.file]


def segments(residual: float = 0.001) -> Table:
    markers = ["RKNE", "LKNE"]
    columns = {"marker": np.array(markers, dtype=object), "segment": np.array([1, 0])}
    reason = np.array(["moves", ""], dtype=object)
    return Table(SEGMENTS, {**columns, "residual": np.array([residual, np.nan]), "reason": reason})


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

    monkeypatch.setattr("mocap_id.store.parquet.decode_table", refuse)
    monkeypatch.setattr("mocap_id.store.hdf5.decode_tree", refuse)


def test_unchanged_files_are_recognised_without_decoding(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undecodable(monkeypatch)
    folder = Folder(written)
    assert folder.origin("segment", FILES) == ORIGIN
    assert [folder.key(file) for file in FILES] == ["key-1", "key-1"]


def test_without_its_record_an_artefact_can_be_read_but_counts_as_not_written(written: Path) -> None:
    record(written).unlink()
    folder = Folder(written)
    assert folder.origin("segment", FILES) is None
    assert folder.provenance(SEGMENTS.file).origin == ORIGIN
    assert [folder.key(file) for file in FILES] == ["key-1", "key-1"]


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("where", [0.0, 0.2, 0.5, 0.8, 0.999])
def test_one_wrong_byte_is_found(written: Path, file: str, where: float) -> None:
    path = written / file
    content = bytearray(path.read_bytes())
    content[int(where * len(content))] ^= 0x10
    path.write_bytes(content)
    for ask in (lambda one: one.key(file), lambda one: one.origin("segment", FILES), lambda one: one.read(file)):
        with pytest.raises(StoreError, match=r"is damaged or was edited.* Delete it and run again"):
            ask(Folder(written))


@pytest.mark.parametrize("where", [0.1, 0.3, 0.5])
def test_a_damaged_page_is_found_without_a_record(tmp_path: Path, where: float) -> None:
    """Parquet's own checksums: a table that was copied alone still proves its numbers."""
    long = LongTable(PLANAR, np.arange(500), np.arange(500) / 100, ("A", "B"), planar(500, 2))
    Folder(tmp_path).write([long], ORIGIN)
    record(tmp_path).unlink()
    path = tmp_path / PLANAR.file
    content = bytearray(path.read_bytes())
    content[int(where * len(content))] ^= 0x10
    path.write_bytes(content)
    with pytest.raises(StoreError, match="is damaged"):
        Folder(tmp_path).read(PLANAR.file)


def planar(frames: int, markers: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    values = {name: rng.normal(size=(frames, markers)) for name in ("x", "y", "z")}
    return values | {"visible": np.ones((frames, markers), dtype=bool)}


def test_a_replaced_artefact_is_found(written: Path) -> None:
    (written / SEGMENTS.file).write_bytes(parquet.encode_table(segments(0.002), LATER))
    with pytest.raises(StoreError, match="is damaged or was edited"):
        Folder(written).origin("segment", FILES)


def test_one_folder_follows_what_it_writes(written: Path) -> None:
    folder = Folder(written)
    assert folder.key(SEGMENTS.file) == "key-1"
    folder.write([segments(0.002), chain()], LATER)
    assert folder.key(SEGMENTS.file) == "key-2"
    assert folder.origin("segment", FILES) == LATER
    folder.remove_outputs("segment", FILES)
    assert folder.origin("segment", FILES) is None
    assert not record(written).exists()


def test_a_released_artefact_is_read_from_the_disk(written: Path) -> None:
    folder = Folder(written)
    folder.write([segments(), chain()], LATER)
    (written / SEGMENTS.file).unlink()
    assert folder.read(SEGMENTS.file).facts == {}
    folder.release([SEGMENTS.file])
    with pytest.raises(StoreError, match="is missing"):
        folder.read(SEGMENTS.file)


def test_files_of_an_older_schema_are_not_reused(written: Path) -> None:
    strings = json.loads(record(written).read_text())
    strings["artefacts"][SEGMENTS.file] |= {"schema_version": SCHEMAS[SEGMENTS.file].version + 1}
    record(written).write_text(json.dumps(strings))
    assert Folder(written).origin("segment", FILES) is None


@pytest.mark.parametrize(
    "artefacts", [None, [], {"segments.parquet": None}, {"segments.parquet": {}}, {"segments.parquet": {"digest": 1}}]
)
def test_an_invalid_record_counts_as_absent(written: Path, artefacts: object) -> None:
    strings = json.loads(record(written).read_text())
    record(written).write_text(json.dumps(strings | {"artefacts": artefacts}))
    folder = Folder(written)
    assert folder.key(SEGMENTS.file) == "key-1"
    assert folder.origin("segment", FILES) is None


def test_after_a_power_cut_between_two_renames_no_record_is_left(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, done = Path.replace, []

    def cut(path: Path, target: Path) -> Path:
        if done:
            raise SystemExit
        done.append(target)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", cut)
    with pytest.raises(SystemExit):
        Folder(written).write([segments(0.002), chain()], LATER)
    assert Folder(written).origin("segment", FILES) is None
    assert not record(written).exists()


def test_checking_outputs_loads_no_table_library(written: Path) -> None:
    asked = "import sys; from pathlib import Path; from mocap_id.store import Folder"
    looked = f"print(Folder(Path({str(written)!r})).origin('segment', {FILES}).key); print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", f"{asked}; {looked}"], capture_output=True, text=True, check=True)
    key, modules = said.stdout.splitlines()
    assert key == "key-1"
    assert {"numpy", "pandas", "pyarrow", "h5py", "scipy"} & set(modules.split()) == set()


def test_a_stream_hashes_the_bytes_written() -> None:
    stream = io.BytesIO()
    hashed = HashedStream(stream)
    for part in (b"one", bytearray(b"two"), memoryview(b"three")):
        hashed.write(part)
    hashed.flush()
    assert hashed.tell() == 11
    assert hashed.hash() == hash_bytes(stream.getvalue())


def record(folder: Path) -> Path:
    return folder / ".mocap-id" / "segment.json"


def test_artefacts_are_written_and_read_without_pandas_and_threads(tmp_path: Path) -> None:
    """Pandas takes 0.2 s to import. A thread of Arrow that holds Python objects aborts an ending process, rarely."""
    program = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
sys.modules["pandas"] = None
import numpy as np
from test_records import ORIGIN, PLANAR, LongTable, chain, planar, segments
from mocap_id.store import Folder
folder = Folder(Path({str(tmp_path)!r}))
written = [segments(), chain(), LongTable(PLANAR, np.arange(5), np.arange(5) / 100, ("A", "B"), planar(5, 2))]
folder.write(written, ORIGIN)
for one in written:
    print(Folder(folder.path).read(one.schema.file).schema.file)
threads = Path("/proc/self/task").glob("*/comm")
print([one for one in (each.read_text().strip() for each in threads) if one != "jemalloc_bg_thd"][1:])
"""
    alone = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    said = subprocess.run([sys.executable, "-c", program], env=alone, capture_output=True, text=True, check=True)
    assert said.stdout.split() == [SEGMENTS.file, CHAIN.file, PLANAR.file, "[]"]
