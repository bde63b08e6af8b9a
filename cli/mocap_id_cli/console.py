"""Options and output that the commands share."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only the result and errors.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Also print warnings of the computation.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
TrialFiles = Annotated[
    list[str],
    typer.Argument(
        metavar="TRIALS...", help="Trial or study files, folders of such files, or patterns.", show_default=False
    ),
]
TrialPath = Annotated[
    Path, typer.Argument(metavar="TRIAL", help="A trial's YAML file or run folder.", show_default=False)
]


def one_of(*values: str) -> Callable[[], list[str]]:
    """Return a shell completion that offers the values of an option."""
    return lambda: list(values)


def log_to_stderr(quiet: bool, verbose: bool) -> None:
    """Log the runner's warnings unless ``quiet``, and the libraries' warnings if ``verbose``."""
    logging.captureWarnings(True)
    logging.basicConfig(stream=sys.stderr, format="mocap-id: %(message)s", level=logging.ERROR, force=True)
    logging.getLogger("mocap_id").setLevel(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING)
    logging.getLogger("py.warnings").setLevel(logging.WARNING if verbose else logging.CRITICAL)


def print_json(data: Any, default: Callable[[Any], Any] | None = None) -> None:
    """Print data as indented JSON."""
    typer.echo(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False, default=default))


def short(path: Path) -> str:
    """Return a path relative to the working folder if it is below it."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def aligned(rows: Sequence[Sequence[str]], *, numbers: bool = False) -> Iterator[str]:
    """Yield rows as lines with aligned columns; with ``numbers``, all columns but the first are right-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *rest in rows:
        cells = (
            cell.rjust(width) if numbers else cell.ljust(width) for cell, width in zip(rest, widths[1:], strict=True)
        )
        yield "  ".join([first.ljust(widths[0]), *cells]).rstrip()
