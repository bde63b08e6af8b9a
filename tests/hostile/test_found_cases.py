"""Every input that once caused a traceback, a hang, excessive memory or a wrong count, kept as a recipe."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import c3d_count
import h5py
import hostile_seeds
import mutations_c3d
import mutations_hdf5
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from recording_cases import body, build_c3d, plate_parameters

from mocap_id import recording
from mocap_id.config import load
from mocap_id.errors import ConfigError, RecordingError, StoreError
from mocap_id.recording.c3d_package import compare_with_package
from mocap_id.recording.text_tables import read_table
from mocap_id.store import Folder

POINTS = body(40, 6) * 1e3


def read_c3d(folder: Path, data: bytes) -> recording.Recording:
    path = folder / "case.c3d"
    path.write_bytes(data)
    return recording.read(path)


def with_frames(data: bytes, frames: int) -> bytes:
    """Return a file whose header and parameters declare the same wrong number of frames."""
    lying = bytearray(data)
    mutations_c3d.put_word(lying, 8, struct.unpack("<H", lying[6:8])[0] + frames - 1)
    for place in mutations_c3d.places(lying):
        if place.name == "POINT:FRAMES":
            mutations_c3d.put_word(lying, place.values, frames)
    return bytes(lying)


@pytest.mark.parametrize(
    ("frames", "told"),
    [(35, "data for 5 more frames"), (39, "data for 1 more frames"), (41, "contain almost only zeros")],
)
def test_counts_that_agree_on_a_lie_are_told(tmp_path: Path, frames: int, told: str) -> None:
    """The file's size does not determine the number of frames within the last block's padding."""
    data = with_frames(build_c3d(POINTS), frames)
    found = read_c3d(tmp_path, data)
    assert len(found.frames) == frames
    assert frames in c3d_count.possible(data)
    assert any(told in oddity for oddity in found.oddities), found.oddities


@pytest.mark.parametrize("frames", [60, 1000, 65535])
def test_frames_that_are_not_there_are_refused(tmp_path: Path, frames: int) -> None:
    with pytest.raises(RecordingError, match="declares"):
        read_c3d(tmp_path, with_frames(build_c3d(POINTS), frames))


def test_a_sound_file_says_nothing_of_its_end(tmp_path: Path) -> None:
    assert not [oddity for oddity in read_c3d(tmp_path, build_c3d(POINTS)).oddities if "frame" in oddity]


def test_plates_that_no_parameter_tells_of_take_no_memory(tmp_path: Path) -> None:
    """65,535 plates of some thousand samples each would need gigabytes."""
    analog = np.random.default_rng(0).normal(size=(160, 6))
    parameters = plate_parameters(2, range(1, 7)) | {"FORCE_PLATFORM:USED": -1}
    found = read_c3d(tmp_path, build_c3d(POINTS, analog=analog, parameters=parameters))
    assert [plate.index for plate in found.plates] == [1, 2]
    assert "declares 65535 plates and TYPE 1" in found.plates[1].problem


@pytest.mark.parametrize("block", [0, 1, 3, 255])
def test_a_parameter_block_where_the_library_looks_for_none(tmp_path: Path, block: int) -> None:
    """The library's UnboundLocalError was not caught; if only the header is broken, the file can still be read."""
    data = bytearray(build_c3d(POINTS))
    data[0] = block
    if block > 2:
        with pytest.raises(RecordingError, match=r"case.c3d: the parameter section"):
            read_c3d(tmp_path, bytes(data))
    else:
        found = read_c3d(tmp_path, bytes(data))
        np.testing.assert_allclose(found.positions, POINTS * 1e-3, atol=1e-6)
        assert any("cannot read this file" in said for said in compare_with_package(tmp_path / "case.c3d"))


def test_a_channel_map_without_dimensions(tmp_path: Path) -> None:
    """An IndexError was not caught."""
    analog = np.random.default_rng(0).normal(size=(160, 6))
    parameters = plate_parameters(2, range(1, 7)) | {"FORCE_PLATFORM:CHANNEL": 1}
    (plate,) = read_c3d(tmp_path, build_c3d(POINTS, analog=analog, parameters=parameters)).plates
    assert "CHANNEL has 1 rows" in plate.problem


def trc(folder: Path) -> tuple[Path, list[bytes]]:
    return folder / "link.trc", hostile_seeds.trc(folder, False)[0].data.split(b"\n")


@pytest.mark.parametrize("declared", ["²", "٣", "9" * 5000, "1e9", "-1", "", "nan"])
def test_numbers_of_frames_that_are_none(tmp_path: Path, declared: str) -> None:
    path, lines = trc(tmp_path)
    cells = lines[2].split(b"\t")
    cells[2] = declared.encode()
    path.write_bytes(b"\n".join([*lines[:2], b"\t".join(cells), *lines[3:]]))
    if declared.startswith("9"):
        with pytest.raises(RecordingError, match="declares"):
            recording.read(path)
    else:
        found = recording.read(path)
        assert len(found.frames) == 100
        assert any("no valid number of frames" in oddity for oddity in found.oddities)


@pytest.mark.parametrize("declared", ["0", "-100", "nan", "inf", "1e999", "1e-320"])
def test_rates_that_are_none(tmp_path: Path, declared: str) -> None:
    """A ZeroDivisionError was not caught."""
    path, lines = trc(tmp_path)
    rest = lines[2].partition(b"\t")[2]
    path.write_bytes(b"\n".join([*lines[:2], declared.encode() + b"\t" + rest, *lines[3:]]))
    with pytest.raises(RecordingError, match=r"link.trc: DataRate is "):
        recording.read(path)


@pytest.mark.parametrize("cell", ["9" * 25, "9" * 5000, "1e400", "²"])
@pytest.mark.parametrize("column", [0, 1, 4])
def test_giants_among_the_cells(tmp_path: Path, cell: str, column: int) -> None:
    """An OverflowError was not caught, or a frame number wrapped around."""
    path, lines = trc(tmp_path)
    cells = lines[20].split(b"\t")
    cells[column] = cell.encode()
    path.write_bytes(b"\n".join([*lines[:20], b"\t".join(cells), *lines[21:]]))
    try:
        found = recording.read(path)
    except RecordingError as error:
        assert "link.trc" in str(error)
    else:
        assert column == 4
        assert any("were set to missing" in oddity for oddity in found.oddities)


def test_a_quote_swallows_no_rows(tmp_path: Path) -> None:
    path, lines = trc(tmp_path)
    cells = lines[2].split(b"\t")
    cells[2] = b"?"
    lines[2] = b"\t".join(cells)
    lines[20] = lines[20].replace(b"\t", b'\t"', 1)
    lines[30] = lines[30].replace(b"\t", b'\t"', 1)
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(RecordingError, match=r"link.trc"):
        recording.read(path)
    rows = hostile_seeds.csv()[0].data.replace(b"\n0.20,", b'\n0.20,"').replace(b"\n0.30,", b'\n0.30,"')
    (tmp_path / "force.csv").write_bytes(rows)
    with pytest.raises(RecordingError, match=r"force.csv"):
        recording.read_force_log(tmp_path / "force.csv")


def test_a_whitespace_table_with_a_cell_too_many(tmp_path: Path) -> None:
    """The columns of all rows were silently shifted."""
    path, lines = trc(tmp_path)
    rows = [line.replace(b"\t", b" ") + b" 1.0" for line in lines[6:] if line]
    path.write_bytes(b"\n".join([*lines[:6], *rows]))
    with pytest.raises(RecordingError, match="cells"):
        recording.read(path)


def test_many_names_above_many_short_lines(tmp_path: Path) -> None:
    """Blank cells for all names needed terabytes for a file of megabytes."""
    rows = "\n".join(f"{k}\t{k / 100}" for k in range(1, 20_001))
    heads = {
        "a.trc": "PathFileType\t4\nDataRate\tNumFrames\tNumMarkers\tUnits\n100\t20000\t99999\tmm\nFrame#\tTime",
        "a.mot": "table\nendheader\ntime",
    }
    for name, head in heads.items():
        names = "".join(f"\tx{k}\t\t" for k in range(20_000))
        (tmp_path / name).write_text(f"{head}{names}\ty\n{rows}")
        with pytest.raises(RecordingError, match=rf"{name}: 20000 lines omit most of"):
            (recording.read if name == "a.trc" else read_table)(tmp_path / name)


@pytest.mark.parametrize("end", [b"\x0b", b"\x0c", b"\x1c", b"\xc2\x85", b"\xe2\x80\xa8"])
def test_only_line_ends_end_lines(tmp_path: Path, end: bytes) -> None:
    """A form feed or U+0085 within a label does not end a line."""
    path, lines = trc(tmp_path)
    path.write_bytes(b"\n".join([*lines[:3], lines[3].replace(b"L4", b"L" + end + b"4"), *lines[4:]]))
    assert len(recording.read(path).frames) == 100
    path.write_bytes(end.join(lines))
    with pytest.raises(RecordingError, match=r"link.trc"):
        recording.read(path)


@pytest.mark.parametrize(("cell", "row"), [("9" * 25, 8), ("9" * 25, 40), ("1e400", 8), ("1e400", 106)])
def test_giants_in_a_mot_table(tmp_path: Path, cell: str, row: int) -> None:
    """An infinite last time was accepted as increasing."""
    path = tmp_path / "grf.mot"
    lines = hostile_seeds.mot(False)[0].data.split(b"\n")
    lines[row] = cell.encode() + b"\t" + lines[row].partition(b"\t")[2]
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(RecordingError, match=r"grf.mot"):
        read_table(path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("trial: !!bool maybe", "line 1: `maybe` is not a valid bool"),
        ("trial: x\nwindow: !!int ''", "line 2: `` is not a valid int"),
        ("%YAML 9.9\n---\ntrial: x", "not valid YAML"),
        ("trial: " + "9" * 5000, "is not a valid int"),
        ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]", "aliases"),
        ("deep: " + "[" * 5000, "deep"),
        ("deep: " + "- " * 100_000, "not valid YAML"),
        ("deep: " + "{a: " * 40 + "}" * 40, "more than 32 levels deep"),
        ("wide: [" + "1," * 600 + "]", "more than 500 values"),
        ("trial: !!python/object/apply:os.system [echo]", "tag"),
        ("trial: x\ntrial: y", "is given twice"),
        ('recording: "a\\0b"\ntrial: x', ""),
        (
            "trial: x\nrecording: x.c3d\nout: runs/" + "x" * 300,
            "line 3: the folder of the results",
        ),  # case 5760 of 20261
        ("trial: x\nrecording: x.c3d\nout: " + "runs/" * 1000, "longer than this system allows"),
        ('trial: x\nrecording: x.c3d\nout: "a\\0b"', "is not a valid path"),
    ],
)
def test_configurations_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, told: str) -> None:
    monkeypatch.setattr("mocap_id.config.parsing._MAX_VALUES", 500)  # 40,000 take seconds
    path = tmp_path / "trial.yaml"
    path.write_text(text)
    if not told:
        assert load(path).name == "x"
        return
    with pytest.raises(ConfigError, match=r"trial.yaml") as said:
        load(path)
    assert told in str(said.value)


def test_a_home_of_nobody(tmp_path: Path) -> None:
    """A RuntimeError was not caught."""
    path = tmp_path / "trial.yaml"
    path.write_text("trial: x\nrecording: ~nobody-of-this-name/trial.c3d\n")
    with pytest.raises(RecordingError, match="no such file"):
        from mocap_id import runner

        runner.run(load(path))


def edited(data: bytes, change: object) -> bytes:
    stream = io.BytesIO(data)
    with h5py.File(stream, "r+", libver=("v108", "v110")) as file:
        change(file)  # type: ignore[operator]
    return stream.getvalue()


def many_ways(file: h5py.File) -> None:
    """Return a file in which each level has two paths: 2 to the 40th paths in all."""
    group = file.create_group("extra")
    for _ in range(40):
        group["a"] = below = group.create_group("b")
        group = below


def long_texts(file: h5py.File) -> None:
    """Return a file in which 4096 strings, padded to the longest, need gigabytes."""
    texts = file.create_dataset("extra", (1 << 12,), h5py.string_dtype(), chunks=(1 << 12,), compression="gzip")
    texts[0] = "x" * (1 << 18)


HDF5 = {
    "a ring": lambda file: file.__setitem__("extra", file["/"]),
    "many ways": many_ways,
    "long texts": long_texts,
    "a great many texts": lambda file: file.create_dataset("extra", (1 << 20,), h5py.string_dtype(), chunks=(1 << 12,)),
    "huge and empty": lambda file: file.create_dataset("extra", (1 << 30,), "f8"),
    "chunks of gigabytes": lambda file: file.create_dataset("extra", (1 << 40, 1 << 40), "f8", chunks=(1024, 1024)),
    "a bomb": lambda file: file.create_dataset("extra", data=np.zeros(1 << 22), chunks=(1 << 20,), compression="gzip"),
    "external": lambda file: file.create_dataset("extra", (4,), "f8", external=[("/dev/zero", 0, 32)]),
    "soft": lambda file: file.__setitem__("extra", h5py.SoftLink("/joints")),
    "external link": lambda file: file.__setitem__("extra", h5py.ExternalLink("x.h5", "/")),
    "references": lambda file: file.create_dataset("extra", (3,), h5py.ref_dtype),
    "compound": lambda file: file.create_dataset("extra", data=np.zeros(3, [("a", "f8")])),
    "nothing": lambda file: file.create_dataset("extra", data=h5py.Empty("f8")),
    "facts that are none": lambda file: file.attrs.__setitem__("mocap-id.facts", "[]"),
    "a node gone": lambda file: file.__delitem__("joints/centre"),
}


@pytest.mark.parametrize("case", HDF5)
def test_trees_that_nobody_wrote(tmp_path: Path, made: Path, case: str) -> None:
    """Edited files are refused; even with a valid hash, their content is not read with HDF5."""
    sound = (made / "done" / "chain.h5").read_bytes()
    changed = edited(sound, HDF5[case])
    path = tmp_path / "chain.h5"
    path.write_bytes(changed)
    with pytest.raises(StoreError, match=r"chain.h5 is damaged or was edited"):
        Folder(tmp_path).read("chain.h5")
    path.write_bytes(mutations_hdf5.reseal(changed))
    assert Folder(tmp_path).provenance("chain.h5") == Folder(made / "done").provenance("chain.h5")


def node(path: str, *place: object) -> Callable[[Any], None]:
    return lambda found: found["nodes"].__setitem__(path, place)


def told(key: str, value: object) -> Callable[[Any], None]:
    return lambda found: found["provenance"].__setitem__(f"mocap-id.{key}", value)


INDEXES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "after the end": (node("joints/centre", "<f8", [2, 2], 1 << 30), "ends after the end of the file"),
    "before the start": (node("joints/centre", "<f8", [2, 2], -8), "shape or offset"),
    "no place": (node("joints/centre", "<f8", [2, 2], 1.5), "shape or offset"),
    "true": (node("joints/centre", "<f8", [True, 4], 0), "shape or offset"),
    "no numbers": (node("joints/centre", "<f8", "22", 0), "shape or offset"),
    "no shape": (node("joints/centre", "<f8", 4, 0), "is damaged"),
    "gigabytes": (node("joints/centre", "<f8", [1 << 30], 0), "ends after the end of the file"),
    "more than any memory": (node("joints/centre", "<f8", [1 << 40] * 9, 0), "ends after the end of the file"),
    "empty, but larger than any memory": (node("joints/centre", "<f8", [0, *[1 << 40] * 9], 0), "is damaged"),
    "a hundred dimensions": (node("joints/centre", "<f8", [1] * 100, 0), "is damaged"),
    "the same bytes over and over": (
        lambda found: found["nodes"].update({f"extra{k}": ("|S4000", [1], 0) for k in range(50)}),
        "two datasets share bytes",
    ),
    "an object": (node("joints/centre", "|O", [1], 0), "name or type"),
    "a type that is none": (node("joints/centre", 8, [1], 0), "is damaged"),
    "not UTF-8": (node("joints/name", "|S8", [1], 2048), "is damaged"),
    "neither true nor false": (node("extra", "|b1", [64], 0), "neither true nor false"),
    "deep": (node("a/" * 900 + "b", "<f8", [], 0), "name or type"),
    "a dataset for a group": (node("joints", "<f8", [], 0), "a dataset and a group"),
    "a group for a dataset": (node("joints/name/deeper", "<f8", [], 0), "a dataset and a group"),
    "nodes that are none": (lambda found: {**found, "nodes": [1]}, "is damaged"),
    "no provenance": (lambda found: {"nodes": found["nodes"]}, "is damaged"),
    "another node's values": (
        lambda found: found["nodes"].__setitem__("joints/arc", found["nodes"]["markers/residual"]),
        "two datasets share bytes",
    ),
    "a node gone": (lambda found: found["nodes"].pop("joints/centre") and None, "`joints/centre` is missing"),
    "texts for numbers": (node("joints/centre", "|S8", [1], 0), "expected float64"),
    "no JSON": (lambda found: b"{" * 7, "is damaged"),
    "JSON without end": (lambda found: b"[" * 100_000, "is damaged"),
    "a number without end": (lambda found: b"9" * 5000, "is damaged"),
    "facts that are none": (told("facts", "[]"), "damaged provenance"),
    "facts of no text": (told("facts", 7), "damaged provenance"),
    "facts without end": (told("facts", "[" * 20000), "damaged provenance"),
    "deep facts": (told("facts", '{"a":' * 980 + "1" + "}" * 980), "damaged provenance"),
    "a grave reason": (told("reasons", '[{"code":"a","message":"b","level":"grave"}]'), "damaged provenance"),
}


@pytest.mark.parametrize("case", INDEXES)
def test_indexes_that_nobody_wrote(tmp_path: Path, made: Path, case: str) -> None:
    change, complaint = INDEXES[case]
    spoilt = mutations_hdf5.reindex((made / "done" / "chain.h5").read_bytes(), change)
    (tmp_path / "chain.h5").write_bytes(spoilt)
    with pytest.raises(StoreError, match=r"chain.h5") as said:
        Folder(tmp_path).read("chain.h5")
    assert complaint in str(said.value)


def looping(data: bytes) -> bytes:
    """Return a file whose first string is so long that the library's offset in the heap wraps around."""
    spoilt = bytearray(data)
    struct.pack_into("<Q", spoilt, data.index(b"GCOL") + 24, 2**64 - 16)
    return bytes(spoilt)


@pytest.mark.parametrize("kind", ["spoilt", "with a right hash", "of an earlier version"])
def test_a_heap_that_hdf5_never_leaves(tmp_path: Path, made: Path, kind: str) -> None:
    """Case 240 of seed 1005: HDF5 2.0 loops endlessly in a heap of strings."""
    whole = (made / "done" / "chain.h5").read_bytes()
    spoilt = looping(whole[whole.index(b"\x89HDF") :] if "earlier" in kind else whole)
    (tmp_path / "chain.h5").write_bytes(mutations_hdf5.reseal(spoilt) if "right" in kind else spoilt)
    script = (
        "import sys, pathlib; from mocap_id.store import Folder; Folder(pathlib.Path(sys.argv[1])).read('chain.h5')"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script, tmp_path], capture_output=True, text=True, timeout=60, check=False
    )
    complaint = {"spoilt": "is damaged or was edited", "of an earlier version": "HDF5 without the hash"}.get(kind, "")
    assert complaint in ended.stderr
    assert (ended.returncode == 0) == (kind == "with a right hash"), ended.stderr


def one_many_times(table: pa.Table) -> pa.Table:
    rows = 80_000_000
    return pa.table({"time": pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array([0.0]))})


PARQUET = {
    "a column twice": (lambda table: table.append_column("time", table.column("time")), "occurs twice"),
    "columns without number": (
        lambda table: pa.table({f"theta_{k}": pa.nulls(1, pa.float64()) for k in range(1, 6000)}),
        "6000",
    ),
    "one value eighty million times": (one_many_times, "too much memory"),
    "facts that are none": (lambda table: table, "damaged provenance"),
}


@pytest.mark.parametrize("case", PARQUET)
def test_tables_that_nobody_wrote(tmp_path: Path, made: Path, case: str) -> None:
    change, told = PARQUET[case]
    table = pq.read_table(made / "done" / "states.parquet")
    metadata = dict(table.schema.metadata)
    if "facts" in case:
        metadata[b"mocap-id.facts"] = b"[]"
    pq.write_table(change(table).replace_schema_metadata(metadata), tmp_path / "states.parquet")
    with pytest.raises(StoreError, match=r"states.parquet") as said:
        Folder(tmp_path).read("states.parquet")
    assert told.replace("6000", "columns") in str(said.value)
