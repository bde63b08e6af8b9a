"""The command line, assembled so that printing its help does not import the modules of the commands."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from mocap_id import __version__
from mocap_id_cli.commands import COMMANDS, Entry


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
