"""``mocap-id run`` and the commands of the single stages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, get_args

import typer

import mocap_id
from mocap_id import runner
from mocap_id.config import load
from mocap_id.errors import Refused
from mocap_id.stages import STAGES
from mocap_id.stages.trial_keys import Protocol
from mocap_id.verdict import Reason
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, Verbose, log_to_stderr, offer, print_json, shorten

_Source = Annotated[
    Path,
    typer.Argument(
        metavar="TRIAL", help="The trial's YAML file, or a recording: C3D, TRC or a text export.", show_default=False
    ),
]
_TrialFile = Annotated[
    Path, typer.Argument(metavar="TRIAL.yaml", help="The trial's configuration.", show_default=False)
]
_PROTOCOLS = get_args(Protocol)


def run(
    trial: _Source,
    *,
    forces: Annotated[Path | None, typer.Option(help="MOT file with the forces of a TRC file.")] = None,
    protocol: Annotated[
        str | None,
        typer.Option(help="free, sit-to-stand, robot-joint, reach or curl.", autocompletion=offer(*_PROTOCOLS)),
    ] = None,
    space: Annotated[str | None, typer.Option(help="plane or 3d.", autocompletion=offer("plane", "3d"))] = None,
    side: Annotated[
        str | None,
        typer.Option(help="Arm of a trial in space: right or left.", autocompletion=offer("right", "left")),
    ] = None,
    window: Annotated[
        tuple[float, float] | None, typer.Option(metavar="FIRST LAST", help="First and last time to use, s.")
    ] = None,
    height: Annotated[float | None, typer.Option(help="Height of the person, m.")] = None,
    mass: Annotated[float | None, typer.Option(help="Mass of the person, kg.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of the results; default: runs/<recording>.")
    ] = None,
    save: Annotated[
        Path | None, typer.Option(metavar="TRIAL.yaml", help="Write the settings that were used to this file.")
    ] = None,
    open_report: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run the whole pipeline on a trial.

    Results that are up to date are reused. For a recording without a YAML file, options give the settings; space and
    protocol are guessed if they are not given. Only a YAML file can have all settings; --save writes one.
    """
    log_to_stderr(quiet, verbose)
    subject = {name: value for name, value in (("height", height), ("mass", mass)) if value is not None}
    options = {"protocol": protocol, "space": space, "side": side, "window": window, "subject": subject, "out": out}
    settings = {name: value for name, value in options.items() if value}
    result = mocap_id.run(trial, forces=forces, save=save, progress=progress.report_stages(quiet), **settings)
    _print_run(result, as_json)
    if open_report and not result.open_report():
        typer.echo("no browser could be opened: open the report yourself", err=True)
    if result.refused:
        raise typer.Exit(Refused.exit_code)


def make_stage_command(name: str) -> Callable[..., None]:
    """Return the function of the command that runs a trial up to the stage ``name``."""
    stage = next(stage for stage in STAGES if stage.name == name)

    def command(trial: _TrialFile, *, as_json: AsJson = False, quiet: Quiet = False, verbose: Verbose = False) -> None:
        log_to_stderr(quiet, verbose)
        outcome = runner.run_stage(load(trial), stage.name, progress=progress.report_stages(quiet))
        if outcome.refused is not None:
            _print_run(mocap_id.open(outcome.folder), as_json, outcome.steps)
            raise typer.Exit(Refused.exit_code)
        files = [shorten(outcome.folder / file) for file in stage.outputs]
        if as_json:
            print_json({"folder": shorten(outcome.folder), "steps": outcome.steps, "files": files}, asdict)
        else:
            typer.echo("\n".join(files))

    command.__doc__ = stage.help
    return command


def _print_run(run: mocap_id.Run, as_json: bool, steps: tuple[runner.Step, ...] = ()) -> None:
    """Print verdict, reasons and path of the report; ``steps`` are printed if the run has no steps of its own."""
    report = shorten(run.report)
    if as_json:
        result = {"trial": run.name, "verdict": run.summary["verdict"], "folder": shorten(run.folder)}
        print_json(result | {"report": report, "steps": run.steps or steps}, asdict)
        return
    typer.echo(f"verdict: {run.verdict.level}")
    for note in run.verdict.notes:
        if note.code == "guessed":  # the user must see a guess, also with --quiet
            typer.echo(f"  {note.code}: {note.message}")
    for reason in run.verdict.reasons:
        typer.echo(f"  {reason.code}: {reason.message}{_format_numbers(reason)}")
    typer.echo(f"report: {report}")


def _format_numbers(reason: Reason) -> str:
    numbers = (("value", reason.value), ("limit", reason.limit))
    known = [f"{name} {value:.4g}" for name, value in numbers if value is not None]
    return f" ({', '.join(known)})" if known else ""
