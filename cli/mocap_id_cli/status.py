"""``mocap-id status``: which stages of trials are done, have to be computed, or failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict

import typer

from mocap_id import runner
from mocap_id.config import Trial
from mocap_id.workflows.batch import find_trials
from mocap_id_cli.console import AsJson, TrialFiles, count_trials, print_json, shorten


def status(named: TrialFiles, *, as_json: AsJson = False) -> None:
    """Show what is done, what has to be computed, and what failed.

    Nothing is computed or written.
    """
    trials, unreadable = find_trials(named)
    states = [(trial, runner.status(trial)) for trial in trials]
    if as_json:
        entries = [
            {"trial": trial.name, "folder": shorten(trial.out), "done": one.done, **asdict(one)}
            for trial, one in states
        ]
        entries += [{"trial": None, "file": shorten(one.file), "failure": str(one.error)} for one in unreadable]
        print_json(entries)
        return
    width = max((len(trial.name) for trial, _ in states), default=0)
    for trial, one in states:
        typer.echo("\n".join(_lines(trial, one, width)))
    for wrong in unreadable:
        typer.echo(str(wrong.error))
    counts = Counter("done" if one.done else "to do" for _, one in states) + Counter({"unreadable": len(unreadable)})
    text = ", ".join(f"{count} {state}" for state, count in counts.items())
    typer.echo(f"{count_trials(len(states) + len(unreadable))}: {text}")


def _lines(trial: Trial, one: runner.TrialStatus, width: int) -> Iterator[str]:
    if one.running:
        yield f"{trial.name:<{width}}  is running at the moment"
    states = Counter(stage.state for stage in one.stages)
    if one.done:
        yield f"{trial.name:<{width}}  {'refused' if states['refused'] else 'done'}"
        return
    yield f"{trial.name:<{width}}  {states['done']} of {len(one.stages)} stages done"
    for stage in one.stages:
        if stage.state not in ("done", "waiting"):
            yield f"{'':<{width}}    {stage.stage}: {stage.state}: {stage.why}"
    if one.failure is not None:
        yield f"{'':<{width}}    last run: {one.failure}"
