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

    A folder stands for the files of trials and studies in it, and for the run folders in it. Nothing is computed or
    written.
    """
    trials, unreadable = find_trials(named, runs=True)
    states = [(trial, runner.status(trial)) for trial in trials]
    if as_json:
        entries = [
            {"trial": trial.name, "folder": shorten(trial.out), "done": _describe(one) == "done"}
            | {"refused": _describe(one) == "refused", **asdict(one)}
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
    counts = Counter(_describe(one) for _, one in states) + Counter({"unreadable": len(unreadable)})
    text = ", ".join(f"{count} {state}" for state, count in counts.items())
    typer.echo(f"{count_trials(len(states) + len(unreadable))}: {text}")


def _describe(one: runner.TrialStatus) -> str:
    """Return ``done``, ``to do``, or ``refused`` for a trial that a run would refuse again."""
    return "to do" if not one.done else "refused" if any(stage.state == "refused" for stage in one.stages) else "done"


def _lines(trial: Trial, one: runner.TrialStatus, width: int) -> Iterator[str]:
    if one.running:
        yield f"{trial.name:<{width}}  is running at the moment"
    states = Counter(stage.state for stage in one.stages)
    if one.done:
        yield f"{trial.name:<{width}}  {_describe(one)}"
        return
    yield f"{trial.name:<{width}}  {states['done']} of {len(one.stages)} stages done"
    for stage in one.stages:
        if stage.state not in ("done", "waiting"):
            yield f"{'':<{width}}    {stage.stage}: {stage.state}: {stage.why}"
    if one.failure is not None:
        yield f"{'':<{width}}    last run: {one.failure}"
