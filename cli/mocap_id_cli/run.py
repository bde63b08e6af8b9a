"""``mocap-id run`` and the commands of the stages: what was done on stderr, what came of it on stdout."""

from __future__ import annotations

import json
import logging
import sys
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
from mocap_id_cli import progress as live

TrialFile = Annotated[Path, typer.Argument(metavar="TRIAL.yaml", help="The trial's configuration.", show_default=False)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print the result and errors alone.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print warnings of the computation too.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def run(trial: TrialFile, *, as_json: AsJson = False, quiet: Quiet = False, verbose: Verbose = False) -> None:
    """Run the whole pipeline on a trial; what is up to date is not computed again."""
    log_to_stderr(quiet, verbose)
    outcome = runner.run(load(trial), progress=progress(quiet))
    _say(outcome, as_json)


def stage_command(name: str) -> Callable[..., None]:
    """The command of one stage."""
    stage = next(stage for stage in STAGES if stage.name == name)

    def command(trial: TrialFile, *, as_json: AsJson = False, quiet: Quiet = False, verbose: Verbose = False) -> None:
        log_to_stderr(quiet, verbose)
        outcome = runner.run_stage(load(trial), stage.name, progress=progress(quiet))
        if outcome.refused is not None:
            _say(outcome, as_json)
        files = [short(outcome.folder / file) for file in stage.outputs]
        if as_json:
            typer.echo(_json({"folder": short(outcome.folder), "steps": outcome.steps, "files": files}))
        else:
            typer.echo("\n".join(files))

    command.__doc__ = stage.help
    return command


def _say(outcome: runner.Outcome, as_json: bool) -> None:
    """The verdict, its reasons and where the report is; the exit code of a refusal."""
    summary, report = outcome.summary(), short(outcome.folder / "report.html")
    if as_json:
        told = {"trial": summary["trial"], "verdict": summary["verdict"], "folder": short(outcome.folder)}
        typer.echo(_json(told | {"report": report, "steps": outcome.steps}))
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


def _json(told: Mapping[str, Any]) -> str:
    return json.dumps(told, indent=2, ensure_ascii=False, allow_nan=False, default=asdict)


def _numbers(reason: Reason) -> str:
    numbers = [
        f"{name} {value:.4g}" for name, value in (("value", reason.value), ("limit", reason.limit)) if value is not None
    ]
    return f" ({', '.join(numbers)})" if numbers else ""


def progress(quiet: bool) -> runner.Progress:
    """What is told of each stage on standard error; nothing where it is to be quiet."""

    def tell(step: runner.Step) -> None:
        if step.action == "begun":
            live.show(step.stage)
            return
        live.stop()
        outcome = f"{step.seconds:8.2f} s" if step.action == "computed" else f"{step.action:>10}"
        typer.echo(f"{step.stage:<14}{outcome}", err=True)

    return (lambda step: None) if quiet else tell


def log_to_stderr(quiet: bool, verbose: bool) -> None:
    """What the libraries warn of is shown when asked for; what the runner warns of, unless told to be quiet."""
    logging.captureWarnings(True)
    logging.basicConfig(stream=sys.stderr, format="mocap-id: %(message)s", level=logging.ERROR, force=True)
    logging.getLogger("mocap_id").setLevel(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING)
    logging.getLogger("py.warnings").setLevel(logging.WARNING if verbose else logging.CRITICAL)


def short(path: Path) -> str:
    """A path as seen from the working folder."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
