"""Commands that run one trial: ``run``, those of the single stages, and ``demo``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, get_args

import typer
from typer import Argument, Option

import mocap_id
from mocap_id import runner
from mocap_id.config import load
from mocap_id.errors import Refused, StoreError
from mocap_id.stages import STAGES
from mocap_id.stages.trial_keys import Protocol
from mocap_id.verdict import Reason
from mocap_id_cli.console import Output, Quiet, Verbose, common_options, offer, print_json, shorten

_Source = Annotated[
    Path, Argument(metavar="TRIAL", help="The trial's YAML file, or a recording: C3D, TRC or a text export.")
]
_TrialFile = Annotated[Path, Argument(metavar="TRIAL.yaml", help="The trial's configuration.")]
_PROTOCOLS = get_args(Protocol)


@common_options
def run(
    trial: _Source,
    *,
    forces: Annotated[Path | None, Option(help="MOT file with the forces of a TRC file.")] = None,
    protocol: Annotated[
        str | None, Option(help="free, sit-to-stand, robot-joint, reach or curl.", autocompletion=offer(*_PROTOCOLS))
    ] = None,
    space: Annotated[str | None, Option(help="plane or 3d.", autocompletion=offer("plane", "3d"))] = None,
    side: Annotated[
        str | None, Option(help="Arm of a trial in space: right or left.", autocompletion=offer("right", "left"))
    ] = None,
    window: Annotated[
        tuple[float, float] | None, Option(metavar="FIRST LAST", help="First and last time to use, s.")
    ] = None,
    height: Annotated[float | None, Option(help="Height of the person, m.")] = None,
    mass: Annotated[float | None, Option(help="Mass of the person, kg.")] = None,
    out: Annotated[
        Path | None, Option(metavar="FOLDER", help="Folder of the results; default: runs/<recording>.")
    ] = None,
    save: Annotated[
        Path | None, Option(metavar="TRIAL.yaml", help="Write the settings that were used to this file.")
    ] = None,
    open_report: Annotated[bool, Option("--open", help="Open the report in the browser.")] = False,
    output: Output,
) -> None:
    """Run the whole pipeline on a trial.

    Results that are up to date are reused. For a recording without a YAML file, options give the settings; space and
    protocol are guessed if they are not given. Only a YAML file can have all settings; --save writes one.
    """
    subject = {name: value for name, value in (("height", height), ("mass", mass)) if value is not None}
    options = {"protocol": protocol, "space": space, "side": side, "window": window, "subject": subject, "out": out}
    settings = {name: value for name, value in options.items() if value}
    result = mocap_id.run(trial, forces=forces, save=save, progress=output.report_stage, **settings)
    _print_run(result, output.as_json)
    if open_report and not result.open_report():
        typer.echo("no browser could be opened: open the report yourself", err=True)
    if result.refused:
        raise typer.Exit(Refused.exit_code)


def make_stage_command(name: str) -> Callable[..., None]:
    """Return the function of the command that runs a trial up to the stage ``name``."""
    stage = next(stage for stage in STAGES if stage.name == name)

    def command(trial: _TrialFile, *, output: Output) -> None:
        outcome = runner.run_stage(load(trial), stage.name, progress=output.report_stage)
        if outcome.refused is not None:
            _print_run(mocap_id.open(outcome.folder), output.as_json, outcome.steps)
            raise typer.Exit(Refused.exit_code)
        files = [shorten(outcome.folder / file) for file in stage.outputs]
        if output.as_json:
            print_json({"folder": shorten(outcome.folder), "steps": outcome.steps, "files": files}, asdict)
        else:
            typer.echo("\n".join(files))

    command.__doc__ = stage.help
    return common_options(command)


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


def demo(
    folder: Annotated[Path, Argument(metavar="[FOLDER]", help="Folder of the trial.")] = Path("mocap-id-demo"),
    *,
    open_report: Annotated[
        bool, Option("--open/--no-open", help="Open the report in the browser, if there is one.")
    ] = True,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Simulate a sit-to-stand, run it and open its report.

    You need no recording. FOLDER then contains the simulated recording, its exact truth, trial.yaml and the results,
    as for a trial of your own. If you repeat the command, the files are reused.
    """
    trial = folder / "trial.yaml"
    if not trial.exists():
        mocap_id.simulate("sit-to-stand", folder, seed=1, repetitions=3)
    elif not _is_demo(folder):
        raise StoreError(
            f"{folder} contains another trial, not the demonstration: choose a new folder, or run that trial with "
            f"`mocap-id run {trial}`"
        )
    typer.echo(f"trial: {shorten(trial.absolute())}")
    run(trial=trial, open_report=open_report, quiet=quiet, verbose=verbose)


def _is_demo(folder: Path) -> bool:
    """Return whether the trial in a folder is the simulated sit-to-stand of this command."""
    try:
        truth = json.loads((folder / "truth.json").read_text("utf-8"))
        return (truth["kind"], truth["seed"]) == ("sts", 1)
    except (OSError, ValueError, KeyError, TypeError):
        return False
