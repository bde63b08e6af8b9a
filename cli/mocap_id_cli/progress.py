"""What moves on the terminal while something is computed: standard error alone, and nothing where it is no terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

_shown: list[Progress] = []


def show(what: str, total: int | None = None) -> None:
    """Show that something is being computed, and for how long; what was shown before goes.

    Parameters
    ----------
    what : str
    total : int, optional
        Of the parts that :func:`advance` counts.
    """
    stop()
    if not sys.stderr.isatty():
        return
    from rich.console import Console  # noqa: PLC0415  most calls show nothing
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn  # noqa: PLC0415

    counted = () if total is None else (BarColumn(), MofNCompleteColumn())
    columns = (SpinnerColumn(), TextColumn("{task.description}"), *counted, TimeElapsedColumn())
    shown = Progress(*columns, console=Console(stderr=True), transient=True)
    shown.add_task(what, total=total)
    shown.start()
    _shown.append(shown)


def say(line: str) -> None:
    """Print a line on standard error, above whatever moves there."""
    if _shown:
        _shown[-1].console.print(line, highlight=False, markup=False, soft_wrap=True)
    else:
        print(line, file=sys.stderr)


def advance() -> None:
    """Count one part more."""
    for shown in _shown:
        shown.advance(shown.task_ids[0])


def stop() -> None:
    """Leave the terminal as it was."""
    while _shown:
        _shown.pop().stop()
