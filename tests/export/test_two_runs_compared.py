"""Comparison of two runs: no differences with itself, opposite signs in reverse order, and all changes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mocap_id.errors import StoreError
from mocap_id.store.artefacts import Table
from mocap_id.store.provenance import STATES
from mocap_id.workflows.regress import RunComparison, compare_numbers, compare_runs, compare_tables, flatten
from mocap_id.workflows.run_folder import RunFolder, open_run


@pytest.fixture(scope="module")
def other(links) -> Path:
    """The same recording with a lower cut-off frequency."""
    return Path(links(True, **{"identify-dim": {"cutoff_hz": 2.5}}))


def by_name(found: RunComparison) -> dict[tuple[str, str], object]:
    return {(row.section, row.name): row for row in found.changed}


def test_a_run_is_identical_to_itself(links) -> None:
    found = compare_runs(links(), links())
    assert found.identical
    assert found.changed == ()
    assert len(found.rows) > 100


def test_the_other_way_round_every_difference_changes_its_sign(links, other: Path) -> None:
    there, back = compare_runs(links(), other), compare_runs(other, links())
    assert not there.identical
    forth = {(row.section, row.name): row for row in back.rows}
    told = 0
    for row in there.rows:
        reverse = forth.get((row.section, row.name))
        if reverse is None:  # a reason that is gained the one way is lost the other
            assert row.section == "verdict"
            continue
        assert (reverse.a, reverse.b) == (row.b, row.a)
        if row.difference is not None and row.section != "series":
            assert reverse.difference == -row.difference
            told += 1
        if row.in_sd is not None:
            assert reverse.in_sd == pytest.approx(-row.in_sd)
        if row.section == "series":
            assert reverse.difference == pytest.approx(row.difference)
    assert told > 30


def test_a_setting_is_found_with_what_follows_from_it_alone(links, other: Path) -> None:
    changed = compare_runs(links(), other).changed
    settings = {row.name: (row.a, row.b) for row in changed if row.section == "settings"}
    assert settings == {"identify-dim.cutoff_hz": (None, 2.5)}
    sections = {row.section for row in changed}
    assert "base parameters" in sections
    assert not sections & {"inputs", "versions", "segments", "markers", "joints", "lengths", "noise"}
    hashes = {row.name for row in changed if row.section == "artefacts"}
    assert "dynamics.h5" in hashes
    assert not hashes & {"planar.parquet", "chain.h5", "states.parquet"}
    assert {row.name for row in changed if row.section == "series"} <= {
        *(f"{name}{model}" for name in ("Fx", "Fy", "tauz", "cop_x") for model in ("", "_model")),
        "tau_1",
        "tau_2",
    }


def test_without_its_plate_a_run_loses_its_parameters_and_gains_a_reason(links) -> None:
    changed = compare_runs(links(), links(False)).changed
    told = {row.name for row in changed if row.section == "verdict"}
    assert "no-plate gained" in told
    lost = [row for row in changed if row.section == "base parameters" and not row.name.endswith("verdict")]
    assert lost
    assert all(row.b is None and row.difference is None for row in lost)
    assert any(row.section == "inputs" for row in changed)


def test_in_combined_standard_deviations() -> None:
    row = compare_numbers("s", "n", 2.0, 3.0, "kg", sds=(0.3, 0.4))
    assert (row.difference, row.percent, row.in_sd) == (1.0, 50.0, pytest.approx(2.0))
    assert compare_numbers("s", "n", 2.0, 3.0, sds=(0.3, None)).in_sd is None
    assert compare_numbers("s", "n", 0.0, 3.0).percent is None
    assert not compare_numbers("s", "n", 1e-17, -1e-17).differs


def test_series_are_compared_on_common_times(links) -> None:
    """Compares with a copy that starts later, is sampled at other times, and differs by a constant."""
    run = open_run(links())
    table = run.artefacts["states.parquet"]
    assert isinstance(table, Table)
    shifted = table.frame.iloc[100:].copy()
    middles = {name: (shifted[name].to_numpy()[1:] + shifted[name].to_numpy()[:-1]) / 2 for name in ("time", "theta_1")}
    frame = shifted.iloc[1:].assign(time=middles["time"], theta_1=middles["theta_1"] + 0.01)
    moved = replace(run, artefacts={**run.artefacts, "states.parquet": Table.from_frame(STATES, frame)})
    found = {row.name: row.difference for row in compare_tables(run, moved)}
    assert found["theta_1"] == pytest.approx(0.01, rel=0.02)
    assert {row.name: row.difference for row in compare_tables(run, run)}["theta_1"] == 0.0


def test_no_common_time_is_no_difference(links) -> None:
    run = open_run(links())
    table = run.artefacts["states.parquet"]
    assert isinstance(table, Table)
    later = table.with_columns(time=table["time"] + 1e3)
    moved = replace(run, artefacts={"states.parquet": later})
    assert list(compare_tables(run, moved)) == []


def test_nested_settings_become_keys() -> None:
    nested = {"a": {"b": [1, 2], "c": None}, "d": [{"name": "rail"}]}
    assert dict(flatten(nested)) == {"a.b": "1, 2", "a.c": None, "d": "name: rail"}


def test_a_folder_that_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no artefacts of a run"):
        compare_runs(tmp_path, tmp_path)


def test_a_run_that_was_put_together_from_two_is_told(links, other: Path, tmp_path: Path) -> None:
    for source, names in ((links(), ("dynamics.h5", "chain.h5")), (links(False), ("wrench.parquet",))):
        for name in names:
            (tmp_path / name).write_bytes((source / name).read_bytes())
    with pytest.raises(StoreError, match="was not made from the wrench"):
        open_run(tmp_path)


def test_the_table_and_the_json_say_the_same(cli, links, other: Path, tmp_path: Path) -> None:
    import json

    said = cli("compare", links(), other, "--json", "--out", tmp_path / "t" / "c.csv")
    assert said.code == 0
    found = json.loads(said.out)
    table = pd.read_csv(tmp_path / "t" / "c.csv")
    assert [row["name"] for row in found["differences"]] == table["name"].tolist()
    np.testing.assert_allclose(
        table["difference"],
        [math.nan if row["difference"] is None else row["difference"] for row in found["differences"]],
    )
    assert "identical" in cli("compare", links(), links()).out
    assert "identify-dim.cutoff_hz" in cli("compare", links(), other).out
    assert cli("compare", links(), other, "--out", "c.txt").code == 2
    assert cli("compare", links(), tmp_path / "nowhere").code == 2


def test_run_folder_knows_its_name_and_what_is_missing(links) -> None:
    run = open_run(links())
    assert isinstance(run, RunFolder)
    assert run.name == "two-links"
    assert "no force plates" in open_run(links(False)).why_missing("dynamics.h5")
