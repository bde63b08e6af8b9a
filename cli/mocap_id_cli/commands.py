"""All commands, each with one line of help, and the program; a command's module is imported only when it is called."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from mocap_id import __version__
from mocap_id.stages import STAGE_HELP


@dataclass(frozen=True)
class Entry:
    """A command whose module is not imported yet."""

    name: str
    help: str  # the first sentence of its help
    load: Callable[[], Any]  # returns the function of the command, or the Typer app of a group of commands


def _load(module: str, name: str) -> Any:
    return getattr(import_module(f"mocap_id_cli.{module}"), name)


def _load_stage(name: str) -> Any:
    return _load("run", "make_stage_command")(name)


_BEFORE_STAGES = (
    ("run", "run", "Run the whole pipeline on a trial."),
    ("run", "demo", "Simulate a sit-to-stand, run it and open its report."),
)
_AFTER_STAGES = (
    ("studies", "init", "Write a study file for a folder of recordings."),
    ("studies", "study", "Run all trials of a study and write its tables and page."),
    ("trials", "batch", "Run many trials and write one table of their results."),
    ("trials", "regress", "Recompute trials, and compare their results with a baseline."),
    ("trials", "status", "Show what is done, what has to be computed, and what failed."),
    ("trials", "clean", "Delete the results of runs."),
    ("results", "transfer", "Apply the body identified from one trial to other trials."),
    ("results", "payload", "Identify what a robot carries from two trials in space."),
    ("results", "compare", "Compare two runs: show what changed, and by how much."),
    ("results", "export", "Write a run as OpenSim files or as tables."),
    ("results", "figures", "Draw the figures of a page as SVG and PDF files."),
    ("help", "explain", "Explain a verdict's code, an error or an exit code."),
    ("help", "doctor", "Check this installation and say how to repair it."),
    ("devices", "workspace", "Compute what the tip of a chain reaches within its limits."),
    ("devices", "prescribe", "Find springs that let a weak person hold a wider range."),
    ("studies", "sensitivity", "Perturb a trial and report which errors it tolerates."),
    ("advise", "advise", "Propose the movement to record next."),
    ("inspect", "inspect", "Print what a recording contains."),
    ("simulate", "simulate", "Simulate recordings whose exact truth is known."),
    ("validate", "validate", "Repeat the validation studies of the thesis."),
    ("devices", "pneumatic", "Describe a pneumatic spring, and choose its pressures."),
    ("stages", "schema", "Print the JSON Schema of a trial's YAML file, for editors."),
    ("stages", "stages", "List the stages in order, with their inputs and outputs."),
)
"""Module, name and help of each command; the module has a function or a group of commands with this name."""

COMMANDS = (
    *(Entry(name, text, partial(_load, module, name)) for module, name, text in _BEFORE_STAGES),
    *(Entry(name, text, partial(_load_stage, name)) for name, text in STAGE_HELP.items()),
    *(Entry(name, text, partial(_load, module, name)) for module, name, text in _AFTER_STAGES),
)
"""The commands in the order of ``mocap-id --help``."""


class _Commands(TyperGroup):
    """A group that has the name and help of each command, but imports only the command that is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for entry in COMMANDS:
            self.add_command(TyperCommand(entry.name, help=entry.help, rich_markup_mode=None))

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        own = {name for parameter in self.get_params(ctx) for name in parameter.opts}
        if args and args[0].startswith("-") and args[0] not in own and any(name in self.commands for name in args[1:]):
            ctx.fail(
                f"No such option: {args[0]}. Give the options of a command after its name: mocap-id COMMAND {args[0]} …"
            )
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None and command is not None:
            command = load_command(next(entry for entry in COMMANDS if entry.name == name))
        return name, command, rest


def load_command(entry: Entry) -> Any:
    """Import the module of a command, and return the command for click."""
    loaded = entry.load()
    if not isinstance(loaded, typer.Typer):
        function, loaded = loaded, typer.Typer(add_completion=False, rich_markup_mode=None)
        loaded.command(entry.name)(function)
    command = get_command(loaded)
    command.name = entry.name
    return command


def build() -> typer.Typer:
    """Return the command line with all commands."""
    app = typer.Typer(
        name="mocap-id", cls=_Commands, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
    )
    app.callback()(_top)
    return app


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"mocap-id {__version__}")
        raise typer.Exit


def _top(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Recover skeleton, joint states and inertial parameters of an individual from one motion-capture recording."""
