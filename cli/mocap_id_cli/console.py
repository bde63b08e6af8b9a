"""Options of the command line that several commands have, and functions that print results."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only the result and errors.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Also print warnings of the computation.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", min=1, help="Number of trials that run at the same time.")]
TrialFiles = Annotated[
    list[str],
    typer.Argument(
        metavar="TRIALS...", help="Trial or study files, folders of such files, or patterns.", show_default=False
    ),
]
TrialPath = Annotated[
    Path, typer.Argument(metavar="TRIAL", help="A trial's YAML file or run folder.", show_default=False)
]


def offer(*values: str) -> Callable[[], list[str]]:
    """Return a function that lists the values of an option for completion in the shell."""
    return lambda: list(values)


def make_group(text: str, **commands: Callable[..., None]) -> typer.Typer:
    """Return a group of commands whose help is ``text``; underscores in the names of the commands become hyphens."""
    app = typer.Typer(no_args_is_help=True, add_completion=False, rich_markup_mode=None, help=text)
    app.callback()(lambda: None)
    for name, function in commands.items():
        app.command(name.replace("_", "-"))(function)
    return app


def log_to_stderr(quiet: bool, verbose: bool) -> None:
    """Write log messages to standard error.

    Errors of mocap-id are always written, its warnings unless ``quiet``; if ``verbose``, also its information and the
    warnings of libraries.
    """
    logging.captureWarnings(True)
    logging.basicConfig(stream=sys.stderr, format="mocap-id: %(message)s", level=logging.ERROR, force=True)
    logging.getLogger("mocap_id").setLevel(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING)
    logging.getLogger("py.warnings").setLevel(logging.WARNING if verbose else logging.CRITICAL)


def print_json(data: Any, default: Callable[[Any], Any] | None = None) -> None:
    """Print data as indented JSON; ``default`` converts objects that JSON cannot represent."""
    typer.echo(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False, default=default))


def print_result(as_json: bool, document: Any, lines: Iterable[str]) -> None:
    """Print a result: ``document`` as JSON if ``as_json``, otherwise ``lines`` of text."""
    if as_json:
        print_json(document)
    else:
        typer.echo("\n".join(lines))


def shorten(path: Path) -> str:
    """Return a path as text; it is relative if the path is in the working folder."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def count_trials(count: int) -> str:
    """Return a text such as ``1 trial`` or ``3 trials``."""
    return f"{count} trial{'s' * (count != 1)}"


def describe_verdict(row: Mapping[str, Any]) -> str:
    """Return a text with verdict and codes of a trial, or with the exit code if the trial failed.

    Parameters
    ----------
    row : mapping
        ``verdict``, ``exit_code``, and ``codes`` as a text or a list.
    """
    codes = row["codes"] if isinstance(row["codes"], str) else ", ".join(row["codes"])
    about = f"exit code {row['exit_code']}" if row["verdict"] == "failed" else codes
    return f"{row['verdict']} ({about})" if about else str(row["verdict"])


def align(rows: Sequence[Sequence[str]], *, numbers: bool = False) -> Iterator[str]:
    """Yield rows as lines with aligned columns; if ``numbers``, all columns except the first are right-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *rest in rows:
        cells = (
            cell.rjust(width) if numbers else cell.ljust(width) for cell, width in zip(rest, widths[1:], strict=True)
        )
        yield "  ".join([first.ljust(widths[0]), *cells]).rstrip()
