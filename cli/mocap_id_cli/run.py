"""``mocap-id run`` and the commands of the single stages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from mocap_id import runner
from mocap_id.config import load
from mocap_id.errors import Refused
from mocap_id.stages import STAGES
from mocap_id.verdict import Reason
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, Verbose, log_to_stderr, print_json, short

TrialFile = Annotated[Path, typer.Argument(metavar="TRIAL.yaml", help="The trial's configuration.", show_default=False)]


def run(trial: TrialFile, *, as_json: AsJson = False, quiet: Quiet = False, verbose: Verbose = False) -> None:
    """Run the whole pipeline on a trial.

    Results that are up to date are reused.
    """
    log_to_stderr(quiet, verbose)
    _print_outcome(runner.run(load(trial), progress=progress.of_stages(quiet)), as_json)


def stage_command(name: str) -> Callable[..., None]:
    """Return the command of one stage."""
    stage = next(stage for stage in STAGES if stage.name == name)

    def command(trial: TrialFile, *, as_json: AsJson = False, quiet: Quiet = False, verbose: Verbose = False) -> None:
        log_to_stderr(quiet, verbose)
        outcome = runner.run_stage(load(trial), stage.name, progress=progress.of_stages(quiet))
        if outcome.refused is not None:
            _print_outcome(outcome, as_json)
        files = [short(outcome.folder / file) for file in stage.outputs]
        if as_json:
            print_json({"folder": short(outcome.folder), "steps": outcome.steps, "files": files}, asdict)
        else:
            typer.echo("\n".join(files))

    command.__doc__ = stage.help
    return command


def _print_outcome(outcome: runner.Outcome, as_json: bool) -> None:
    """Print the verdict, its reasons and the report's path; exit with the code of a refusal."""
    summary, report = outcome.summary(), short(outcome.folder / "report.html")
    if as_json:
        result = {"trial": summary["trial"], "verdict": summary["verdict"], "folder": short(outcome.folder)}
        print_json(result | {"report": report, "steps": outcome.steps}, asdict)
    else:
        _print_verdict(summary["verdict"], report)
    if outcome.refused is not None:
        raise typer.Exit(Refused.exit_code)


def _print_verdict(verdict: Mapping[str, Any], report: str) -> None:
    typer.echo(f"verdict: {verdict['level']}")
    for reason in map(Reason.from_dict, verdict["reasons"]):
        if reason.level != "ok":
            typer.echo(f"  {reason.code}: {reason.message}{_numbers(reason)}")
    typer.echo(f"report: {report}")


def _numbers(reason: Reason) -> str:
    numbers = [
        f"{name} {value:.4g}" for name, value in (("value", reason.value), ("limit", reason.limit)) if value is not None
    ]
    return f" ({', '.join(numbers)})" if numbers else ""
