"""Whole trials whose forces come late or early: the offset is found over seconds, and the results stay the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from mocap_id.config import load
from mocap_id.runner import run
from mocap_id_simulation import Options, simulate


@dataclass(frozen=True)
class Finished:
    """The summary and events.parquet of a run."""

    summary: dict[str, Any]
    events: pd.DataFrame

    def reason(self, code: str) -> dict[str, Any]:
        verdict = self.summary["verdict"]
        return next(each for each in (*verdict["reasons"], *verdict["notes"]) if each["code"] == code)


def finish(yaml: Path) -> Finished:
    outcome = run(load(yaml))
    return Finished(dict(outcome.summary()), pd.read_parquet(outcome.folder / "events.parquet"))


def person(folder: Path, offset: float, **options: Any) -> Finished:
    made = Options(seed=5, repetitions=2, clock_offset=offset, **options)
    return finish(simulate("sit-to-stand", folder / f"at{offset:g}", made))


@pytest.mark.parametrize("options", [{}, pytest.param({"seat_plate": True}, marks=pytest.mark.slow)])
def test_a_person(tmp_path: Path, options: dict[str, Any]) -> None:
    """Half a second is nearly a seat-off: contact and events would be wrong if they used the clock of the plates."""
    right, late = person(tmp_path, 0.0, **options), person(tmp_path, -0.5, **options)
    assert late.summary["dynamics"]["clock_offset_s"] == pytest.approx(-0.5, abs=0.001)
    assert late.reason("clock-offset-large")["value"] == pytest.approx(-0.5, abs=0.001)
    for column in ("seat_off", "seat_on", "seat_off_72"):
        np.testing.assert_allclose(late.events[column], right.events[column], atol=0.03)
    mass = late.summary["dynamics"]["base"][0]
    assert mass["value"] == pytest.approx(right.summary["dynamics"]["base"][0]["value"], rel=0.002)
    assert late.summary["dynamics"]["cop_rms_m"] < 0.003


def test_a_board(tmp_path: Path) -> None:
    """Its clock is off by more than the fit searches; this is only a note."""
    yaml = simulate("sit-to-stand", tmp_path / "t", Options(seed=3, repetitions=3, board=True))
    text = yaml.read_text()
    yaml.write_text(text.replace("board.csv}", "board.csv, clock_offset_s: 0.22}"))
    assert yaml.read_text() != text
    done = finish(yaml)
    assert done.summary["dynamics"]["clock_offset_s"] == pytest.approx(-0.22, abs=0.002)
    assert done.reason("clock-offset-large")["level"] == "ok"
    assert done.summary["dynamics"]["cop_rms_m"] < 0.003


@pytest.mark.recordings
@pytest.mark.slow
@pytest.mark.parametrize("offset", [-1.5, 0.6])
@pytest.mark.parametrize("name", ["STS1", "squats1"])
def test_real_trials(tmp_path: Path, recordings: Path, name: str, offset: float) -> None:
    """Times in the MOT file shifted: the offset shifts by the same time; -6 … -8 ms are this session's own."""
    source = recordings / "sit-to-stand"
    lines = (source / f"{name}_grf.mot").read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line.strip().lower().startswith("time"))
    rows = [line.split() for line in lines[head + 1 :] if line.strip()]
    moved = ["\t".join([f"{float(row[0]) - offset:.6f}", *row[1:]]) for row in rows]
    (tmp_path / "late.mot").write_text("\n".join([*lines[: head + 1], *moved]) + "\n")
    yaml = tmp_path / "trial.yaml"
    yaml.write_text(
        f"trial: t\nrecording: {{markers: {source / name}.trc, forces: late.mot}}\nprotocol: sit-to-stand\n"
    )
    done = finish(yaml)
    assert done.summary["dynamics"]["clock_offset_s"] == pytest.approx(offset - 0.007, abs=0.002)
    assert done.reason("clock-offset-large")["level"] == "caution"
