"""What moves on the terminal while something is computed."""

from __future__ import annotations

import io
import sys

import pytest

from mocap_id_cli import progress as progress as live


class Terminal(io.StringIO):
    """Standard error that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_is_shown_what_is_computed_and_left_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    live.show("segment")
    live.show("trials", total=3)
    live.advance()
    live.stop()
    drawn = sys.stderr.getvalue()
    assert "segment" in drawn
    assert "1/3" in drawn
    assert drawn.count("\x1b[?25l") == drawn.count("\x1b[?25h") == 2, "the cursor is hidden and shown again"


def test_nothing_moves_where_it_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    live.show("segment")
    live.advance()
    live.stop()
    assert capsys.readouterr() == ("", "")


def test_colours_are_left_out_where_they_are_not_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    live.show("segment")
    live.stop()
    assert "\x1b[3" not in sys.stderr.getvalue()
