"""``mocap-id status`` and ``mocap-id clean``: what runs have left, and taking it away."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import Annotated

import typer

from mocap_id import runner
from mocap_id.config import Trial
from mocap_id.errors import ConfigError
from mocap_id.stages import LINEUP
from mocap_id.store import Folder
from mocap_id.workflows.batch import find
from mocap_id_cli.run import short

Trials = Annotated[
    list[str],
    typer.Argument(
        metavar="TRIALS...",
        help="Files of trials or studies, folders that hold some, or patterns.",
        show_default=False,
    ),
]


def status(
    named: Trials, *, as_json: Annotated[bool, typer.Option("--json", help="Print every stage as JSON.")] = False
) -> None:
    """Tell what of the trials is done, what would be computed anew and why, and what failed.

    Nothing is computed and nothing written.
    """
    trials, unreadable = find(named)
    found = [(trial, runner.status(trial)) for trial in trials]
    if as_json:
        told = [
            {"trial": trial.name, "folder": short(trial.out), "done": one.done, **asdict(one)} for trial, one in found
        ]
        told += [{"trial": None, "file": short(one.file), "failure": str(one.error)} for one in unreadable]
        typer.echo(json.dumps(told, indent=2, ensure_ascii=False))
        return
    width = max((len(trial.name) for trial, _ in found), default=0)
    for trial, one in found:
        typer.echo("\n".join(_lines(trial, one, width)))
    for wrong in unreadable:
        typer.echo(str(wrong.error))
    counted = Counter("done" if one.done else "to do" for _, one in found) + Counter({"unreadable": len(unreadable)})
    typer.echo(f"{len(found) + len(unreadable)} trials: " + ", ".join(f"{n} {what}" for what, n in counted.items()))


def clean(
    named: Trials,
    *,
    first: Annotated[
        str | None, typer.Option("--from", metavar="STAGE", help="Keep what the stages before this one made.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would go and take nothing away.")] = False,
) -> None:
    """Take away what runs have made; recordings, configurations and anybody else's files stay."""
    if first is not None and first not in LINEUP:
        raise ConfigError(f"--from {first}: there is no such stage, expected one of {', '.join(LINEUP)}")
    trials, unreadable = find(named)
    if unreadable:
        raise ConfigError("\n".join(str(one.error) for one in unreadable))
    for trial in trials:
        there = Folder(trial.out).there()
        if there and not dry_run:
            runner.clean(trial, first)
        did = ("would be cleaned" if dry_run else "cleaned") if there else "has nothing"
        typer.echo(f"{trial.name}: {short(trial.out)} {did}")


def _lines(trial: Trial, one: runner.Status, width: int) -> Iterator[str]:
    if one.running:
        yield f"{trial.name:<{width}}  running at the moment"
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
