"""What is told of many trials on standard error while they run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mocap_id_cli import progress as live

if TYPE_CHECKING:
    from mocap_id.workflows.performing import Performed

_LEVELS = {0: "", 4: "refused"}


def counting(quiet: bool) -> Callable[[int], None]:
    """What is told how many trials there are."""
    return (lambda trials: None) if quiet else (lambda trials: live.show("trials", trials))


def teller(quiet: bool) -> Callable[[Performed], None]:
    """What is told of every trial that is done."""
    return (lambda done: None) if quiet else _tell


def _tell(done: Performed) -> None:
    what = _LEVELS.get(done.exit_code, "failed") or (f"{done.seconds:8.2f} s" if done.computed else "reused")
    live.say(f"{done.trial:<28}{what:>10}")
    live.advance()
