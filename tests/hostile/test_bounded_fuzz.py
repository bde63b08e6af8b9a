"""A short, reproducible fuzzing run (`make fuzz` makes long ones), and properties tested by hypothesis."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import fuzz
import mutations_stored
import numpy as np
import oracles
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mocap_id.config import load
from mocap_id.config.parsing import read_source
from mocap_id.config.study import load_study
from mocap_id.errors import ConfigError, RecordingError, StoreError
from mocap_id.recording.text_tables import parse_table
from mocap_id.store.atomic import resolve_path

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="bounds and pipes are those of other systems")
NUMBER, SEED = 60, 20_001

UNHURRIED = settings(
    max_examples=40, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def test_hundreds_of_spoiled_files() -> None:
    """No traceback, no hang, no excessive memory, no silently wrong count."""
    tally = fuzz.Tally()
    for told in fuzz.campaign(SEED, iter(range(NUMBER)), shared=False):
        tally.add(told)
    assert tally.number == NUMBER
    assert tally.findings == [], tally.findings
    for form in oracles.SHARES:  # each format was run, and some files were accepted
        assert sum(tally.outcomes[f"{form} {outcome}"] for outcome in ("read", "refused")) > 0, form
    assert sum(tally.outcomes[f"{form} read"] for form in oracles.SHARES) > NUMBER // 10


def test_a_case_is_always_the_same(tmp_path: Path, made: Path) -> None:
    first, again = (oracles.Bench(tmp_path, with_shared=False) for _ in range(2))
    for index in range(40):
        form = ("c3d", "trc", "mot", "csv", "trial", "study")[index % 6]
        assert first.case(3, index, form) == again.case(3, index, form)


@pytest.mark.parametrize(
    ("broken", "outcome"),
    [
        ("raise ValueError('x')", "finding"),
        ("raise RecordingError('no name')", "finding"),
        ("raise RecordingError(case.name)", "refused"),
        ("return 'wrong count'", "finding"),
        ("return ''", "read"),
    ],
)
def test_the_judge_can_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str, outcome: str) -> None:
    names: dict[str, object] = {"RecordingError": RecordingError}
    exec(f"def reader(bench, case):\n    {broken}", names)
    monkeypatch.setitem(oracles.READERS, "c3d", names["reader"])
    assert oracles.Bench(tmp_path).judge(oracles.Case("c3d", "a.c3d", b"")).outcome == outcome


@pytest.mark.slow
def test_the_watch_sees_what_no_reader_can_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that allocates a gigabyte, hangs or crashes is found, and a new process runs the next case."""
    script = tmp_path / "spoiled.py"
    script.write_text(
        f"import os, sys, time\nsys.path.insert(0, {str(fuzz.HERE)!r})\nimport fuzz, oracles\n"
        "broken = [lambda: bytearray(1 << 30), lambda: time.sleep(60), os.abort, lambda: None]\n"
        "fuzz.warm_up = lambda bench, only: None\n"
        "oracles.Bench.case = lambda bench, seed, index, only: oracles.Case('c3d', 'x', b'', index)\n"
        "oracles.READERS['c3d'] = lambda bench, case: broken[case.frames]() and ''\n"
        "fuzz.worker(5, 'c3d', False)\n"
    )
    monkeypatch.setattr(fuzz, "__file__", str(script))
    found = list(fuzz.campaign(5, iter(range(4)), shared=False, only="c3d", hang=1.0))
    assert [each["index"] for each in found] == [0, 1, 2, 3]
    assert [each["outcome"] for each in found] == ["finding"] * 3 + ["read"]
    assert [found[0]["said"][:11], found[1]["said"][:5], found[2]["said"][:17]] == [
        "MemoryError",
        "hangs",
        "the process ended",
    ]


def test_making_a_case_takes_no_machine_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutations leave very large tables unchanged: adding three thousand columns once exhausted memory."""
    stream = io.BytesIO()
    pq.write_table(pa.table({"time": [0.0, 0.1], "frame": [1, 2]}), stream)
    bomb, made = pa.table({"time": [1.0]}), 0

    def count(*_: object) -> pa.Table:
        nonlocal made
        made += 1
        return bomb

    def change(table: pa.Table, rng: np.random.Generator) -> pa.Table:
        assert table is not bomb
        return table

    monkeypatch.setattr(mutations_stored, "parquet_bomb", count)
    monkeypatch.setattr(mutations_stored, "parquet_columns", change)
    monkeypatch.setattr(mutations_stored, "parquet_metadata", change)
    for seed in range(500):
        mutations_stored._edit_parquet(bytearray(stream.getvalue()), np.random.default_rng(seed))
    assert made > 3


def test_a_long_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    def call(number: int) -> str:
        options = ["--number", str(number), "--seed", "4", "--only", "csv", "--alone", "--state", str(tmp_path)]
        command = [sys.executable, fuzz.__file__, *options]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    assert "6 cases of seed 4, 0 findings" in call(6)
    before = (tmp_path / "seed-4-csv-alone.jsonl").read_text()
    assert "9 cases of seed 4, 0 findings" in call(9)
    after = (tmp_path / "seed-4-csv-alone.jsonl").read_text()
    assert after.startswith(before)
    assert after.count("\n") == 9


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=12), inner, max_size=4),
    max_leaves=12,
)
KEYS = st.sampled_from(("trial", "recording", "window", "plates", "external", "subject", "segment", "planarise", "out"))


@UNHURRIED
@given(keys=st.dictionaries(KEYS, VALUES, max_size=5))
def test_any_values_are_a_trial_or_a_mistake_told(tmp_path: Path, keys: dict[str, object]) -> None:
    import json

    path = tmp_path / "trial.yaml"
    path.write_text(json.dumps({"trial": "x", "recording": "x.c3d"} | keys), "utf-8")
    for reader in (load, load_study):
        try:
            reader(path)
        except ConfigError as error:
            assert "trial.yaml" in str(error)


@UNHURRIED
@given(text=st.text(st.sampled_from("ab:-?[]{}&*!|>'\"%@`#, \n\t\0\x85\ufeff~<.01"), max_size=60))
def test_any_characters_are_yaml_or_told_to_be_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "trial.yaml"
    path.write_text(text, "utf-8")
    try:
        source = read_source(path)
    except ConfigError as error:
        assert "trial.yaml" in str(error)
    else:
        assert source.where(("a", 0, "b")).startswith(str(path))


@UNHURRIED
@given(cells=st.lists(st.lists(st.sampled_from(oracles.mutations_text.CELLS), min_size=2, max_size=4), max_size=6))
def test_any_cells_are_a_table_or_told_to_be_none(cells: list[list[str]]) -> None:
    rows = ["\t".join(row) for row in cells]
    text = "\n".join(["x", "endheader", "time\ta\tb", "0\t1\t2", *rows])
    try:
        table = parse_table(Path("x.mot"), text)
    except RecordingError as error:
        assert "x.mot" in str(error)
    else:
        kept = [row for row in rows if row.strip()]
        assert len(table.time) == 1 + len(kept)


@UNHURRIED
@given(parts=st.lists(st.sampled_from(("..", ".", "a", "", "/", "\\", "b\0", "link", "~")), min_size=1, max_size=5))
def test_no_name_leads_out_of_the_folder(tmp_path: Path, parts: list[str]) -> None:
    run = tmp_path / "run"
    run.mkdir(exist_ok=True)
    if not (run / "link").is_symlink():
        (run / "link").symlink_to(tmp_path)
    try:
        path = resolve_path(run, "/".join(parts))
    except StoreError:
        return
    assert path.parent.resolve().is_relative_to(run.resolve())
    assert path != run
