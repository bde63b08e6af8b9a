"""Every shared recording gives a result or a refusal in the whole pipeline, never another failure."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from mocap_id.config import load
from mocap_id.errors import RecordingError
from mocap_id.runner import run

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(os.environ.get("MOCAP_ID_RECORDINGS", ROOT.parent / "shared" / "recordings")) / "c3d"
FILES = sorted(path.name for path in FOLDER.iterdir()) if FOLDER.is_dir() else []


@pytest.mark.recordings
@pytest.mark.parametrize("name", FILES)
def test_a_result_or_a_refusal(recordings: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "trial.yaml").write_text(
        json.dumps({"trial": "t", "recording": str(recordings / "c3d" / name), "protocol": "free"})
    )
    try:
        outcome = run(load(tmp_path / "trial.yaml"))
    except RecordingError as error:
        assert name in str(error)
        assert not (tmp_path / "runs").exists()
        return
    verdict = outcome.summary()["verdict"]
    assert (verdict["level"] == "refused") is (outcome.refused is not None)
    assert (outcome.folder / "report.html").is_file()
