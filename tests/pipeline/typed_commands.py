"""Commands of a tutorial, typed one after another."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from mocap_id_cli.__main__ import main


class Terminal:
    """Runs commands of mocap-id."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys, self.progress = monkeypatch, capsys, ""

    def type(self, command: str) -> str:
        """Run a command, which must succeed, and return its output."""
        self._monkeypatch.setattr(sys, "argv", shlex.split(command))
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main()
        out, self.progress = self._capsys.readouterr()
        assert not left.value.code, f"{command}: {self.progress}"
        return str(out)


def blocks_of(page: Path, kind: str) -> list[str]:
    """Return the code blocks of a kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```$", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)


def run_page(page: Path, terminal: Terminal, after: Mapping[str, Callable[[], None]]) -> dict[str, list[str]]:
    """Run all commands of a page, compare what it shows, and return what each printed.

    Parameters
    ----------
    page : Path
    terminal : Terminal
    after : mapping
        What the reader does after a command, by the command.
    """
    said: dict[str, list[str]] = {}
    for session in blocks_of(page, "console"):
        commands = [line[2:] for line in session.splitlines() if line.startswith("$ ")]
        shown = [line for line in session.splitlines() if not line.startswith("$ ")]
        for command in commands:
            said.setdefault(command, []).append(terminal.type(command))
            after.get(command, lambda: None)()
        if shown:
            assert said[commands[-1]][-1].splitlines() == shown, "the page shows what is printed"
    return said
