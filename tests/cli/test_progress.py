"""The progress display on the terminal."""

from __future__ import annotations

import io
import sys

import pytest

from mocap_id_cli import progress


class Terminal(io.StringIO):
    """Standard error that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_progress_and_is_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    progress.show("segment")
    progress.show("trials", total=3)
    progress.advance()
    progress.stop()
    drawn = sys.stderr.getvalue()
    assert "segment" in drawn
    assert "1/3" in drawn
    assert drawn.count("\x1b[?25l") == drawn.count("\x1b[?25h") == 2, "the cursor is hidden and shown again"


def test_nothing_is_shown_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    progress.show("segment")
    progress.advance()
    progress.stop()
    assert capsys.readouterr() == ("", "")


def test_no_color_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    progress.show("segment")
    progress.stop()
    assert "\x1b[3" not in sys.stderr.getvalue()
