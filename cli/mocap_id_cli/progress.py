"""Progress messages on standard error, with an animated display if it is a terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

_displays: list[Progress] = []


def show(text: str, total: int | None = None) -> None:
    """Replace the display by one of a task; with a ``total`` number of steps, :func:`advance` moves its bar."""
    stop()
    if not sys.stderr.isatty():
        return
    from rich.console import Console  # noqa: PLC0415  most calls show nothing
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn  # noqa: PLC0415

    bar = () if total is None else (BarColumn(), MofNCompleteColumn())
    columns = (SpinnerColumn(), TextColumn("{task.description}"), *bar, TimeElapsedColumn())
    display = Progress(*columns, console=Console(stderr=True), transient=True)
    display.add_task(text, total=total)
    display.start()
    _displays.append(display)


def say(line: str) -> None:
    """Print a line on standard error, above the display if there is one."""
    if _displays:
        _displays[-1].console.print(line, highlight=False, markup=False, soft_wrap=True)
    else:
        print(line, file=sys.stderr)


def advance() -> None:
    """Add one step to the progress bar, if there is a display."""
    for display in _displays:
        display.advance(display.task_ids[0])


def stop() -> None:
    """Remove the display and restore the terminal."""
    while _displays:
        _displays.pop().stop()
