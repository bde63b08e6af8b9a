"""What the commands share: their common options, and functions that print results and progress."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from mocap_id_cli import progress

if TYPE_CHECKING:
    from mocap_id import runner
    from mocap_id.workflows.parallel import TrialRun

Quiet = Annotated[bool, Option("--quiet", "-q", help="Print only the result and errors.")]
Verbose = Annotated[bool, Option("--verbose", "-v", help="Also print warnings of the computation.")]
AsJson = Annotated[bool, Option("--json", help="Print the result as JSON.")]
Jobs = Annotated[int, Option("--jobs", "-j", min=1, help="Number of trials that run at the same time.")]
TrialFiles = Annotated[
    list[str], Argument(metavar="TRIALS...", help="Trial or study files, folders of such files, or patterns.")
]
TrialPath = Annotated[Path, Argument(metavar="TRIAL", help="A trial's YAML file or run folder.")]
_OUTCOMES = {0: "", 4: "refused"}


@dataclass(frozen=True)
class Output:
    """What a command prints besides errors; its methods that report progress print nothing if ``quiet``."""

    as_json: bool = False
    quiet: bool = False

    def print_result(self, document: Any, lines: Iterable[str]) -> None:
        """Print a result: ``document`` as JSON if ``as_json``, otherwise ``lines`` of text."""
        if self.as_json:
            print_json(document)
        else:
            typer.echo("\n".join(lines))

    def say(self, line: str) -> None:
        """Print a line on standard error."""
        if not self.quiet:
            typer.echo(line, err=True)

    def report_stage(self, step: runner.Step) -> None:
        """Report a stage of a run."""
        if self.quiet:
            return
        if step.action == "begun":
            progress.show(step.stage)
            return
        progress.stop()
        outcome = f"{step.seconds:8.2f} s" if step.action == "computed" else f"{step.action:>10}"
        print(f"{step.stage:<14}{outcome}", file=sys.stderr)

    def show_trial_count(self, trials: int) -> None:
        """Start a display for a number of trials."""
        if not self.quiet:
            progress.show("trials", trials)

    def report_trial(self, done: TrialRun) -> None:
        """Report a finished trial."""
        if not self.quiet:
            time = f"{done.seconds:8.2f} s" if done.computed else "reused"
            progress.say(f"{done.trial:<28}{_OUTCOMES.get(done.exit_code, 'failed') or time:>10}")
            progress.advance()


def common_options(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options --json, --quiet and --verbose, from which it gets its argument ``output``."""

    @wraps(function)
    def command(*, as_json: bool = False, quiet: bool = False, verbose: bool = False, **values: Any) -> None:
        log_to_stderr(quiet, verbose)
        function(**values, output=Output(as_json, quiet))

    own = [each for each in signature(function, eval_str=True).parameters.values() if each.name != "output"]
    options = {"as_json": AsJson, "quiet": Quiet, "verbose": Verbose}.items()
    made = [Parameter(name, Parameter.KEYWORD_ONLY, default=False, annotation=kind) for name, kind in options]
    set_parameters(command, [*own, *made])
    return command


def set_parameters(command: Callable[..., None], parameters: Sequence[Parameter]) -> None:
    """Set the parameters of a function that takes any keywords, from which its options are made."""
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}


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


def shorten(path: Path) -> str:
    """Return a path as text; it is relative if the path is in the working folder."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def count_trials(count: int) -> str:
    """Return a text such as ``1 trial`` or ``3 trials``."""
    return f"{count} trial{'s' * (count != 1)}"


def describe_verdict(row: Mapping[str, Any]) -> str:
    """Return a text with verdict and codes (a text or a list) of a trial, or with the exit code if the trial failed."""
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
