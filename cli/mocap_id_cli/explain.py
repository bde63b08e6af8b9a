"""``mocap-id explain``: codes of a verdict and exit codes in plain words."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id_cli.console import AsJson, print_json

if TYPE_CHECKING:
    from mocap_id.workflows.code_lookup import Entry

_WIDTH = 100


def _codes() -> list[tuple[str, str]]:
    """Return the codes with their titles, for completion in the shell."""
    from mocap_id.workflows import code_lookup as workflow  # noqa: PLC0415  only completion needs it

    return [(entry.code, entry.title) for entry in workflow.entries().values()]


def explain(
    code: Annotated[
        str | None,
        typer.Argument(
            metavar="[CODE]",
            help="A verdict's code, an exit code or an error's name; all codes are listed if omitted.",
            show_default=False,
            autocompletion=_codes,
        ),
    ] = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Explain a verdict's code, an error or an exit code.

    The explanation has the meaning, the criterion and what to do.
    """
    from mocap_id.workflows import code_lookup as workflow  # noqa: PLC0415  no other command has to wait for it

    found = list(workflow.entries().values()) if code is None else [workflow.explain(code)]
    if as_json:
        shown = [asdict(entry) for entry in found]
        print_json(shown if code is None else shown[0])
        return
    typer.echo("\n".join(_list(found) if code is None else _details(found[0])))


def _list(found: list[Entry]) -> Iterator[str]:
    width = max(len(entry.code) for entry in found)
    for entry in found:
        levels = " or ".join(entry.levels) or "exit code"
        yield f"{entry.code:<{width}}  {levels:<15}  {entry.title}"


def _details(entry: Entry) -> Iterator[str]:
    levels = f" ({' or '.join(entry.levels)})" if entry.levels else ""
    yield f"{entry.code}{levels}: {entry.title}"
    for name, text in (("means", entry.meaning), ("judged", entry.judged), ("to do", entry.action)):
        if text:
            yield ""
            yield from textwrap.wrap(f"{name:<8}{text}", _WIDTH, subsequent_indent=" " * 8, break_on_hyphens=False)
