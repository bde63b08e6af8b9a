"""The command line, put together so that asking for help loads none of the commands."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from mocap_id import __version__
from mocap_id_cli.commands import COMMANDS, Entry


class _Commands(TyperGroup):
    """A group that knows its commands by name and line, and loads the one that is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for entry in COMMANDS:
            self.add_command(TyperCommand(entry.name, help=entry.help, rich_markup_mode=None))

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        own = {name for parameter in self.get_params(ctx) for name in parameter.opts}
        if args and args[0].startswith("-") and args[0] not in own and any(name in self.commands for name in args[1:]):
            ctx.fail(f"No such option: {args[0]}. A command's options stand after it: mocap-id COMMAND {args[0]} …")
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None and command is not None:
            command = loaded(next(entry for entry in COMMANDS if entry.name == name))
        return name, command, rest


def loaded(entry: Entry) -> Any:
    """The command itself."""
    found = entry.load()
    if not isinstance(found, typer.Typer):
        function, found = found, typer.Typer(add_completion=False, rich_markup_mode=None)
        found.command(entry.name)(function)
    command = get_command(found)
    command.name = entry.name
    return command


def build() -> typer.Typer:
    """The whole command line."""
    app = typer.Typer(
        name="mocap-id",
        cls=_Commands,
        no_args_is_help=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    app.callback()(_top)
    return app


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"mocap-id {__version__}")
        raise typer.Exit


def _top(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Skeleton, joint states and inertial parameters of an individual from one motion-capture recording."""
