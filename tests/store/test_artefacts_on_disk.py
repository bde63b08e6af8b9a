"""Artefacts are read as they were written, with their provenance; damaged ones are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mocap_id.errors import StoreError
from mocap_id.store import Column, Document, Folder, LongTable, Origin, Table, TableSchema, Tree, parquet
from mocap_id.store.provenance import CHAIN, EVENTS, MARKERS, SCHEMAS, SEGMENTS, STATES, WRENCH
from mocap_id.verdict import Reason

ORIGIN = Origin("segment", 3, {"segment": {"count": 4}}, {"planar.parquet": "ab" * 32}, "key-1", 1.25)
REASON = Reason("segments-unsure", "Zwei Körper: name the segments", 0.4, 0.5)


def segments() -> Table:
    frame = pd.DataFrame(
        {
            "marker": pd.Categorical(["RKNE", "LKNE", "ARM"], categories=["RKNE", "unused", "LKNE", "ARM"]),
            "segment": pd.array([1, 0, None], dtype="Int64"),
            "residual": [0.001, np.nan, -0.0],
            "reason": ["moves with the shank", "", "zu kurz gesehen"],
        }
    )
    return Table.from_frame(
        SEGMENTS, frame, {"count": np.int64(4), "gap": float("nan"), "names": ("foot", "Hüfte")}, (REASON,)
    )


def chain(joints: int = 2) -> Tree:
    rng = np.random.default_rng(7)
    names = [f"joint {j}" for j in range(joints)]
    data = {
        "joints": {
            "name": np.array(names, dtype=str),
            "parent": np.arange(joints),
            "centre": rng.normal(size=(joints, 2)),
            "covariance": rng.normal(size=(joints, 2, 2)),
            "arc": rng.normal(size=joints),
        },
        "segments": {"name": ["base", *names], "length": np.zeros(max(joints - 1, 0)), "length_sd": np.zeros(0)},
        "markers": {"name": ["Ä", "B"], "segment": [0, 1], "local": np.zeros((2, 2)), "residual": [np.nan, 1.0]},
    }
    return Tree(CHAIN, data, {"iterations": 4}, (REASON,))


def states(joints: int, samples: int = 5) -> Table:
    columns: dict[str, np.ndarray] = {"time": np.arange(samples) / 100}
    for k in range(joints, 0, -1):  # written in the wrong order on purpose
        for column in STATES.repeated:
            dtype = bool if column.dtype == "bool" else float
            columns[column.name.format(k=k)] = np.full(samples, k).astype(dtype)
    return Table.from_frame(STATES, pd.DataFrame(columns))


def test_a_table_is_read_as_it_was_written(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([segments()], ORIGIN)
    table = folder.read("segments.parquet")
    assert isinstance(table, Table)
    assert table.frame["marker"].tolist() == ["RKNE", "LKNE", "ARM"]
    assert table.frame["marker"].cat.categories.tolist() == ["ARM", "LKNE", "RKNE"]
    assert table.frame["segment"].dtype == "Int64"
    assert table.frame["segment"].isna().tolist() == [False, False, True]
    assert np.isnan(table.frame["residual"].iloc[1])
    assert table.frame["reason"].tolist() == ["moves with the shank", "", "zu kurz gesehen"]
    assert table.facts == {"count": 4, "gap": None, "names": ["foot", "Hüfte"]}
    assert table.reasons == (REASON,)


def wrench(**more: np.ndarray) -> Table:
    columns = {column.name: np.arange(4.0) for column in WRENCH.columns if column.dtype == "float64"}
    return Table.from_frame(WRENCH, pd.DataFrame({**more, **columns, "plate_ok": True}))


def test_groups_of_columns_are_there_as_a_whole_or_not_at_all(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([wrench()], ORIGIN)
    plain = folder.read("wrench.parquet")
    assert isinstance(plain, Table)
    assert list(plain.frame) == [column.name for column in WRENCH.columns]
    names = [f"{name}_{of}" for of in ("external_2", "seat", "external_1", "p1") for name in ("tauz", "Fy", "Fx")]
    more = {name: np.full(4, float(i)) for i, name in enumerate(names)}
    folder.write([wrench(**more)], ORIGIN)
    whole = folder.read("wrench.parquet")
    assert isinstance(whole, Table)
    expected = [f"{name}_{of}" for of in ("p1", "seat", "external_1", "external_2") for name in ("Fx", "Fy", "tauz")]
    assert list(whole.frame)[len(WRENCH.columns) :] == expected
    for name in names:
        assert (whole.frame[name] == more[name]).all()
    field = pq.read_schema(tmp_path / "wrench.parquet").field("Fy_external_2")
    assert field.metadata[b"unit"] == b"N"


@pytest.mark.parametrize("missing", ["Fy_seat", "tauz_external_1"])
def test_half_a_group_is_refused(missing: str) -> None:
    names = [f"{name}_{of}" for of in ("seat", "external_1") for name in ("Fx", "Fy", "tauz")]
    with pytest.raises(ValueError, match=f"missing columns .*{missing}"):
        parquet.conform_table(wrench(**{name: np.zeros(4) for name in names if name != missing}))


def test_a_tree_is_read_as_it_was_written(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([chain()], ORIGIN)
    tree = folder.read("chain.h5")
    assert isinstance(tree, Tree)
    for group, nodes in chain().data.items():
        for name, value in nodes.items():
            np.testing.assert_array_equal(tree.data[group][name], np.asarray(value))
    assert tree.facts == {"iterations": 4}
    assert tree.reasons == (REASON,)


def test_a_chain_without_joints_has_empty_nodes(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([chain(joints=0)], ORIGIN)
    tree = folder.read("chain.h5")
    assert isinstance(tree, Tree)
    assert tree.data["joints"]["centre"].shape == (0, 2)


@pytest.mark.parametrize("artefact", [segments(), chain()], ids=["table", "tree"])
def test_provenance_is_kept(tmp_path: Path, artefact: Table | Tree) -> None:
    folder = Folder(tmp_path)
    folder.write([artefact], ORIGIN)
    provenance = Folder(tmp_path).provenance(artefact.schema.file)
    assert provenance.origin == ORIGIN
    assert (provenance.schema, provenance.schema_version) == (artefact.schema.file, artefact.schema.version)


def test_parquet_is_readable_by_others_and_states_units(tmp_path: Path) -> None:
    Folder(tmp_path).write([segments()], ORIGIN)
    path = tmp_path / "segments.parquet"
    found = pd.read_parquet(path)
    assert found["segment"].isna().tolist() == [False, False, True]
    schema = pq.read_schema(path)
    assert schema.field("residual").metadata[b"unit"] == b"m"
    assert schema.metadata[b"mocap-id.stage"] == b"segment"
    assert json.loads(schema.metadata[b"mocap-id.parameters"]) == {"segment": {"count": 4}}


def test_hdf5_states_units(tmp_path: Path) -> None:
    Folder(tmp_path).write([chain()], ORIGIN)
    with h5py.File(tmp_path / "chain.h5") as file:
        assert file["joints/centre"].attrs["unit"] == "m"
        assert file.attrs["mocap-id.key"] == "key-1"


def test_facts_may_be_larger_than_an_old_hdf5_attribute(tmp_path: Path) -> None:
    tree = chain()
    folder = Folder(tmp_path)
    folder.write([Tree(tree.schema, tree.data, {"text": "x" * 200_000})], ORIGIN)
    assert len(Folder(tmp_path).read("chain.h5").facts["text"]) == 200_000


def test_repeated_columns_come_in_order_of_their_number(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([states(12)], ORIGIN)
    names = pq.read_schema(tmp_path / "states.parquet").names
    assert names[:2] == ["time", "theta_1"]
    assert names.index("observed_9") < names.index("theta_10") < names.index("theta_12")


def long(frames: int = 5, labels: tuple[str, ...] = ("RKNE", "LKNE", "ARM")) -> LongTable:
    rng = np.random.default_rng(3)
    values = {name: rng.normal(size=(frames, len(labels))) for name in ("x", "y", "residual")}
    values["residual"][1:2, :1] = np.nan
    values["used"] = np.isfinite(values["residual"])
    time = np.arange(frames) / 50
    return LongTable(MARKERS, np.arange(91, 91 + frames), time, labels, values, {"why": "x"}, (REASON,))


@pytest.mark.parametrize("rows", [1, 4, 7, 1 << 18])
def test_a_long_table_is_the_table_with_all_its_labels(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For any number of rows written at a time, also parts of a frame."""
    one = long()
    frame = pd.DataFrame(
        {
            "frame": np.repeat(one.frames, 3),
            "time": np.repeat(one.time, 3),
            "marker": pd.Categorical(list(one.labels) * 5),
            **{name: values.ravel() for name, values in one.values.items()},
        }
    )
    monkeypatch.setattr(parquet, "_ROWS", rows)
    pd.testing.assert_frame_equal(one.frame, frame)
    read = parquet.decode_table(parquet.encode_table(one, ORIGIN), MARKERS)[0]
    pd.testing.assert_frame_equal(read.frame, frame)
    plain = parquet.decode_table(parquet.encode_table(Table.from_frame(MARKERS, frame), ORIGIN), MARKERS)[0]
    for found in (read, plain):
        assert isinstance(found, LongTable)
        assert found.labels == one.labels
        np.testing.assert_array_equal(found.frames, one.frames)
        np.testing.assert_array_equal(found.time, one.time)
        for name, values in one.values.items():
            np.testing.assert_array_equal(found.values[name], values, strict=True)


@pytest.mark.parametrize("spoil", ["swapped", "short", "twice"])
def test_a_long_table_has_the_same_markers_in_every_frame(spoil: str) -> None:
    frame = long().frame
    match spoil:
        case "swapped":
            frame.loc[[3, 4], "marker"] = ["LKNE", "RKNE"]
        case "short":
            frame = frame.iloc[:-1]
        case "twice":
            frame.loc[7, "frame"] = 91
    with pytest.raises(ValueError, match="the same markers in every frame"):
        parquet.decode_table(parquet.encode_table(Table.from_frame(MARKERS, frame), ORIGIN), MARKERS)


@pytest.mark.parametrize("empty", [long(0), long(3, ())], ids=["no frame", "no marker"])
def test_a_long_table_of_nothing(empty: LongTable) -> None:
    found = parquet.decode_table(parquet.encode_table(empty, ORIGIN), MARKERS)[0].frame
    assert len(found) == 0
    assert found.columns.tolist() == [column.name for column in MARKERS.columns]


def test_a_long_table_must_match_its_schema() -> None:
    one = long()
    with pytest.raises(ValueError, match="residual"):
        parquet.conform_table(replace(one, values={name: one.values[name] for name in ("x", "y")}))


def test_every_schema_can_be_written_empty(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    for schema in SCHEMAS.values():
        if isinstance(schema, TableSchema):
            folder.write([nothing(schema)], ORIGIN)
            table = folder.read(schema.file)
            assert isinstance(table, LongTable if schema.long else Table)
            assert len(table.frame) == 0


def nothing(schema: TableSchema) -> Table | LongTable:
    """A table without rows."""
    if schema.long:
        values = {c.name: np.empty((0, 0), c.dtype) for c in schema.columns[3:]}
        return LongTable(schema, np.empty(0, np.int64), np.empty(0), (), values)
    types = {"category": "str", "str": "str"}
    frame = pd.DataFrame({c.name: pd.Series(dtype=types.get(c.dtype, c.dtype)) for c in schema.columns})
    return Table.from_frame(schema, frame)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda f: f.drop(columns="residual"), "residual"),
        (lambda f: f.assign(extra=1.0), "extra"),
        (lambda f: f.assign(residual="far"), "residual"),
        (lambda f: f.assign(segment=[0.5, 1.0, 2.0]), "segment"),
    ],
)
def test_a_table_that_breaks_its_schema_is_not_written(change, complaint: str, tmp_path: Path) -> None:
    one = segments()
    with pytest.raises(ValueError, match=complaint):
        Folder(tmp_path).write([Table.from_frame(one.schema, change(one.frame))], ORIGIN)
    assert list(tmp_path.iterdir()) == []


def test_a_repeated_column_alone_is_not_enough() -> None:
    table = states(1)
    with pytest.raises(ValueError, match="sd_theta_1"):
        parquet.conform_table(Table.from_frame(STATES, table.frame.drop(columns="sd_theta_1")))


def test_plates_may_have_any_number() -> None:
    columns = {column.name: np.zeros(2, bool if column.dtype == "bool" else float) for column in WRENCH.columns}
    columns |= {"Fx_p3": np.ones(2), "Fy_p3": np.ones(2), "tauz_p3": np.ones(2)}
    assert parquet.conform_table(Table(WRENCH, columns)).names[-3:] == ["Fx_p3", "Fy_p3", "tauz_p3"]


@pytest.mark.parametrize("spoil", ["truncate", "empty", "text"])
@pytest.mark.parametrize("artefact", [segments(), chain()], ids=["table", "tree"])
def test_a_damaged_file_is_named(tmp_path: Path, artefact: Table | Tree, spoil: str) -> None:
    Folder(tmp_path).write([artefact], ORIGIN)
    path = tmp_path / artefact.schema.file
    whole = path.read_bytes()
    spoilt = {"truncate": whole[: len(whole) // 2], "empty": b"", "text": b"frame,time\n" * 100}
    path.write_bytes(spoilt[spoil])
    with pytest.raises(StoreError, match=path.name):
        Folder(tmp_path).read(artefact.schema.file)


def test_an_edited_table_is_recognised(tmp_path: Path) -> None:
    Folder(tmp_path).write([segments()], ORIGIN)
    path = tmp_path / "segments.parquet"
    table = pq.read_table(path)
    index = table.column_names.index("residual")
    edited = table.set_column(index, table.schema.field(index), pa.array([0.5, 0.5, 0.5]))
    pq.write_table(edited, path)
    with pytest.raises(StoreError, match="edited"):
        Folder(tmp_path).read("segments.parquet")


def test_a_foreign_table_is_recognised(tmp_path: Path) -> None:
    segments().frame.to_parquet(tmp_path / "segments.parquet")
    with pytest.raises(StoreError, match="not written by mocap-id"):
        Folder(tmp_path).read("segments.parquet")


def test_another_schema_version_is_refused(tmp_path: Path) -> None:
    newer = TableSchema(SEGMENTS.file, SEGMENTS.version + 1, SEGMENTS.columns)
    one = segments()
    (tmp_path / SEGMENTS.file).write_bytes(parquet.encode_table(Table(newer, one.columns), ORIGIN))
    with pytest.raises(StoreError, match=r"version 2, expected segments.parquet version 1"):
        Folder(tmp_path).read(SEGMENTS.file)


def test_a_newer_minor_file_with_more_columns_is_read() -> None:
    wider = TableSchema(
        SEGMENTS.file, SEGMENTS.version, (*SEGMENTS.columns, Column("side", "str", "", "left or right"))
    )
    one = segments()
    sides = {"side": np.array(["r", "l", "l"], dtype=object)}
    written = parquet.encode_table(Table(wider, {**one.columns, **sides}), ORIGIN)
    assert parquet.decode_table(written, SEGMENTS)[0].frame["side"].tolist() == ["r", "l", "l"]


def test_a_missing_artefact_is_named(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"planar.parquet is missing"):
        Folder(tmp_path).read("planar.parquet")


def test_outputs_of_one_computation_belong_together(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([segments(), chain(), Document("summary.json", b"{}")], ORIGIN)
    files = ["segments.parquet", "chain.h5", "summary.json"]
    assert folder.origin("segment", files) == ORIGIN
    folder.write([chain()], Origin("segment", 3, {}, {}, "another key", 1.0))
    assert folder.origin("segment", files) is None


def test_documents_are_identified_by_their_content(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([Document("report.html", b"one"), Document("figures/a.svg", b"two")], ORIGIN)
    assert folder.origin("segment", ["report.html"]) == ORIGIN
    (tmp_path / "figures" / "a.svg").write_bytes(b"edited")
    assert folder.origin("segment", ["report.html"]) is None


def test_a_document_that_is_no_longer_made_is_removed(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([Document("report.html", b"one"), Document("figures/a.svg", b"two")], ORIGIN)
    folder.write([Document("report.html", b"one")], ORIGIN)
    assert not (tmp_path / "figures" / "a.svg").exists()


def test_a_record_never_reaches_outside_its_folder(tmp_path: Path) -> None:
    """Run folders are passed on: a record that names files outside must not delete them."""
    precious = tmp_path / "precious"
    precious.write_text("mine")
    folder = Folder(tmp_path / "run")
    (tmp_path / "run").mkdir()
    folder.write([Document("report.html", b"one")], ORIGIN)
    record = tmp_path / "run" / ".mocap-id" / "segment.json"
    record.write_text(record.read_text().replace("report.html", "../precious"))
    folder.write([Document("report.html", b"two")], ORIGIN)
    assert precious.exists()


def test_events_keep_missing_times(tmp_path: Path) -> None:
    frame = pd.DataFrame({c.name: [np.nan] for c in EVENTS.columns[:5]}).assign(complete=False, why="no chair")
    folder = Folder(tmp_path)
    folder.write([Table.from_frame(EVENTS, frame)], ORIGIN)
    table = folder.read("events.parquet")
    assert isinstance(table, Table)
    assert table.frame.iloc[0, :5].isna().all()
