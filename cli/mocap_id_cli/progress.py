"""Progress messages on standard error, with an animated display if it is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

    from mocap_id import runner
    from mocap_id.workflows.parallel import TrialRun

_displays: list[Progress] = []
_OUTCOMES = {0: "", 4: "refused"}


def show(text: str, total: int | None = None) -> None:
    """Replace the display by a new one, with a progress bar if ``total`` is given.

    Parameters
    ----------
    text : str
        Name of the task that is running.
    total : int, optional
        Number of steps, which :func:`advance` counts.
    """
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


def report_stages(quiet: bool) -> runner.Progress:
    """Return a callback that reports each stage of a run; it does nothing if ``quiet``."""

    def report(step: runner.Step) -> None:
        if step.action == "begun":
            show(step.stage)
            return
        stop()
        outcome = f"{step.seconds:8.2f} s" if step.action == "computed" else f"{step.action:>10}"
        print(f"{step.stage:<14}{outcome}", file=sys.stderr)

    return (lambda step: None) if quiet else report


def show_trial_count(quiet: bool) -> Callable[[int], None]:
    """Return a callback that starts a display for a number of trials; it does nothing if ``quiet``."""
    return (lambda trials: None) if quiet else (lambda trials: show("trials", trials))


def report_trials(quiet: bool) -> Callable[[TrialRun], None]:
    """Return a callback that reports each finished trial; it does nothing if ``quiet``."""

    def report(done: TrialRun) -> None:
        time = f"{done.seconds:8.2f} s" if done.computed else "reused"
        say(f"{done.trial:<28}{_OUTCOMES.get(done.exit_code, 'failed') or time:>10}")
        advance()

    return (lambda done: None) if quiet else report
