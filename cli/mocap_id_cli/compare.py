"""``mocap-id compare``: the differences between two runs."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id.workflows.run_folder import find_owner_of_files
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, Verbose, align, log_to_stderr, print_result

if TYPE_CHECKING:
    from mocap_id.workflows.compare import Comparison, Difference
    from mocap_id.workflows.compare.difference import Value

_LONGEST = 40  # characters of a text in the table


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A trial's YAML file or run folder.", show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", help="The other run: YAML file or run folder.", show_default=False)],
    *,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table to this file, .csv.", show_default=False)
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Also show equal values.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Compare two runs: show what changed, and by how much.

    If A or B is a YAML file, missing or outdated results are computed first; a run folder is read unchanged.
    """
    from mocap_id.workflows import compare as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    if out is not None:
        workflow.check_format(out)
    comparison = workflow.compare(a, b, progress.report_stages(quiet))
    rows = comparison.rows if everything else comparison.changed
    if out is not None:
        workflow.write(rows, out, find_owner_of_files(a, b))
    print_result(as_json, workflow.as_json(comparison, rows), _lines(comparison, rows))


def _lines(comparison: Comparison, rows: tuple[Difference, ...]) -> Iterator[str]:
    for letter, run in (("A", comparison.a), ("B", comparison.b)):
        yield f"{letter}: {run.name} ({run.source})"
    if comparison.identical:
        yield "identical: all artefacts have the same content"
    for section, group in groupby(rows, key=lambda row: row.section):
        members = list(group)
        unit = "rms in A, in B, and of B - A" if section == "series" else "A, B, B - A, of A, in combined sd"
        yield f"\n{section}" + (f" ({unit})" if any(row.difference is not None for row in members) else "")
        yield from align([_cells(row) for row in members], numbers=True)


def _cells(row: Difference) -> list[str]:
    name = f"{row.name} ({row.unit})" if row.unit else row.name
    numbers = (
        "" if row.difference is None else f"{row.difference:{'' if row.section == 'series' else '+'}.4g}",
        "" if row.percent is None else f"{row.percent:+.2f} %",
        "" if row.in_sd is None else f"{row.in_sd:+.1f} sd",
    )
    return [f"  {name}", _format(row.a), _format(row.b), *numbers]


def _format(value: Value) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.6g}"
    text = str(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
