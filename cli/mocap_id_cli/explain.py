"""``mocap-id explain``: a code of a verdict or an exit code in plain words."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from mocap_id.workflows.explaining import Entry

_WIDTH = 100


def explain(
    code: Annotated[
        str | None,
        typer.Argument(
            metavar="[CODE]",
            help="A verdict's code, an exit code or an error's name; without one, all are listed.",
            show_default=False,
        ),
    ] = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say what a code of a verdict, an error or an exit code means, how it is judged, and what to do."""
    from mocap_id.workflows import explaining  # noqa: PLC0415  no other command has to wait for it

    found = list(explaining.answers().values()) if code is None else [explaining.explain(code)]
    if as_json:
        shown = [asdict(answer) for answer in found]
        typer.echo(json.dumps(shown if code is None else shown[0], indent=2, ensure_ascii=False))
        return
    typer.echo("\n".join(_listed(found) if code is None else _told(found[0])))


def _listed(found: list[Entry]) -> Iterator[str]:
    width = max(len(answer.code) for answer in found)
    for answer in found:
        levels = " or ".join(answer.levels) or "exit code"
        yield f"{answer.code:<{width}}  {levels:<15}  {answer.title}"


def _told(answer: Entry) -> Iterator[str]:
    levels = f" ({' or '.join(answer.levels)})" if answer.levels else ""
    yield f"{answer.code}{levels}: {answer.title}"
    for name, text in (("means", answer.meaning), ("judged", answer.judged), ("to do", answer.action)):
        if text:
            yield ""
            yield from textwrap.wrap(f"{name:<8}{text}", _WIDTH, subsequent_indent=" " * 8, break_on_hyphens=False)
