"""No output contains names, prefixes or free text from the header of a C3D file."""

from __future__ import annotations

from pathlib import Path

import ezc3d
import pandas as pd
import pytest
from typer.testing import CliRunner

from mocap_id import recording
from mocap_id.config import load
from mocap_id.runner import run
from mocap_id_cli.commands import build
from mocap_id_simulation import Options, simulate

MARK = "Qarblifoxen"
TEXTS = (
    *("SUBJECTS:NAMES", "SUBJECTS:LABEL_PREFIXES", "SUBJECTS:MARKER_SETS", "TRIAL:DESCRIPTION", "PROCESSING:NAME"),
    *("MANUFACTURER:COMPANY", "MANUFACTURER:SOFTWARE", "MANUFACTURER:VERSION_LABEL", "EVENT:SUBJECTS"),
)


def marked(folder: Path, prefix: str) -> Path:
    """Write a simulated trial with a person's name throughout its header; return its configuration."""
    file = simulate("sit-to-stand", folder, Options(seed=5400001, repetitions=2))
    c3d = ezc3d.c3d(str(folder / "trial.c3d"))
    labels = c3d["parameters"]["POINT"]["LABELS"]["value"]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = tuple(f"{prefix}{label}" for label in labels)
    for name in TEXTS:
        group, parameter = name.split(":")
        c3d.add_parameter(group, parameter, [prefix if name.endswith("PREFIXES") else MARK])
    c3d.add_parameter("SUBJECTS", "USES_PREFIXES", [1])
    c3d.add_parameter("POINT", "DESCRIPTIONS", [f"{MARK}'s marker"] * len(labels))
    c3d.add_parameter("ANALOG", "DESCRIPTIONS", [f"{MARK}'s plate"] * 6)
    c3d.write(str(folder / "trial.c3d"))
    return file


def holds(data: bytes) -> bool:
    return MARK.lower().encode() in data.lower() or MARK.encode("utf-16-le") in data


def text_columns(path: Path) -> bytes:
    """Return the decoded content of a Parquet file, which a search of its bytes would miss."""
    frame = pd.read_parquet(path)
    texts = [frame[name].astype(str).unique() for name in frame if not pd.api.types.is_numeric_dtype(frame[name])]
    return "\n".join(str(text) for column in texts for text in column).encode()


@pytest.mark.parametrize(
    "prefix", [f"{MARK}:", *(pytest.param(f"{MARK}{sign}", marks=pytest.mark.slow) for sign in "_ ")]
)
def test_no_output_of_a_run_names_the_person(tmp_path: Path, prefix: str, capfd: pytest.CaptureFixture[str]) -> None:
    file = marked(tmp_path / "trial", prefix)
    assert holds((tmp_path / "trial" / "trial.c3d").read_bytes())
    outcome = run(load(file))
    written = [path for path in outcome.folder.rglob("*") if path.is_file()]
    assert len(written) > 10
    assert [path.name for path in written if holds(path.read_bytes()) or holds(str(path).encode())] == []
    columns = [text_columns(path) for path in written if path.suffix == ".parquet"]
    assert any(b"LANK" in texts for texts in columns)
    assert not any(holds(texts) for texts in columns)
    told = capfd.readouterr()
    assert not holds((told.out + told.err).encode())


def test_inspect_does_not_name_the_person(tmp_path: Path) -> None:
    marked(tmp_path / "trial", f"{MARK}:")
    for options in ([], ["--json"]):
        done = CliRunner().invoke(build(), ["inspect", str(tmp_path / "trial" / "trial.c3d"), *options])
        assert done.exit_code == 0
        assert "subject names" in done.output
        assert not holds(done.output.encode())


def test_a_subject_name_in_the_file_name_is_reported(tmp_path: Path) -> None:
    marked(tmp_path / "trial", f"{MARK}:")
    named = tmp_path / f"{MARK.lower()} 1.c3d"
    named.write_bytes((tmp_path / "trial" / "trial.c3d").read_bytes())
    oddities = recording.read(named).oddities
    assert any("contains the name of a subject" in oddity and not holds(oddity.encode()) for oddity in oddities)
    assert not any("called after" in oddity for oddity in recording.read(tmp_path / "trial" / "trial.c3d").oddities)
