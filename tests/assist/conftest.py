"""The arm of the shared recordings, taken through the real pipeline once."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_id_assist.workspaces import SubjectArm, read_arm


@pytest.fixture(scope="session")
def reaching_arm(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial's YAML over `arm-reach`, run as far as its joint states."""
    folder = tmp_path_factory.mktemp("arm-reach")
    recording = recordings / "simulated" / "arm-reach" / "trial.c3d"
    file = folder / "trial.yaml"
    file.write_text(f"trial: arm\nrecording: {recording}\nprotocol: free\n", "utf-8")
    found: SubjectArm = read_arm(file)
    assert found.arm.joints == 2
    return file
