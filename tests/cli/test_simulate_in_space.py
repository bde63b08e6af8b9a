"""``mocap-id simulate arm`` and ``chain``: folders ready to run, and options that are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

FILES = {"trial.c3d", "trial.yaml", "truth.json", "truth.npz"}


@pytest.mark.parametrize(
    "arguments",
    [
        ("arm", "--movement", "curl", "--repetitions", "1", "--rate", "60"),
        ("chain", "--kinds", "ST", "--duration", "4"),
    ],
)
def test_a_trial_in_space_is_simulated(cli, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    kind, *options = arguments
    said = cli("simulate", kind, tmp_path / "trial", *options)
    assert (said.code, said.out) == (0, f"{tmp_path / 'trial' / 'trial.yaml'}\n")
    assert {path.name for path in (tmp_path / "trial").iterdir()} == FILES


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("arm", "--severity", "2"), "`severity` is 2.0; expected 0 … 1"),
        (("arm", "--subject", "-1"), "`subject` is -1; expected 0 or more"),
        (("chain", "--kinds", "SB"), "`kinds` is 'SB'; expected 1 … 8 of the letters S, H, T"),
    ],
)
def test_an_impossible_trial_is_refused(cli, tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    kind, *options = arguments
    answer = cli("simulate", kind, tmp_path / "trial", *options)
    assert (answer.code, answer.out) == (2, "")
    assert said in answer.err
    assert not (tmp_path / "trial").exists()
