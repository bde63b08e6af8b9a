"""``mocap-id explain``: explanations of codes of a verdict, errors and exit codes."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id_cli.console import AsJson, print_result

if TYPE_CHECKING:
    from mocap_id.workflows.code_lookup import Entry

_WIDTH = 100


def _complete_code() -> list[tuple[str, str]]:
    """Return each code with its title, for completion in the shell."""
    from mocap_id.workflows.code_lookup import list_entries  # noqa: PLC0415  only completion needs it

    return [(entry.code, entry.title) for entry in list_entries().values()]


def explain(
    code: Annotated[
        str | None,
        typer.Argument(
            metavar="[CODE]",
            help="A verdict's code, an exit code or an error's name; all codes are listed if omitted.",
            show_default=False,
            autocompletion=_complete_code,
        ),
    ] = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Explain a verdict's code, an error or an exit code.

    The explanation contains the meaning, the criterion and what to do.
    """
    from mocap_id.workflows import code_lookup as workflow  # noqa: PLC0415  no other command has to wait for it

    if code is None:
        entries = list(workflow.list_entries().values())
        print_result(as_json, [asdict(entry) for entry in entries], _list_codes(entries))
    else:
        entry = workflow.explain(code)
        print_result(as_json, asdict(entry), _describe(entry))


def _list_codes(entries: list[Entry]) -> Iterator[str]:
    width = max(len(entry.code) for entry in entries)
    for entry in entries:
        levels = " or ".join(entry.levels) or "exit code"
        yield f"{entry.code:<{width}}  {levels:<15}  {entry.title}"


def _describe(entry: Entry) -> Iterator[str]:
    levels = f" ({' or '.join(entry.levels)})" if entry.levels else ""
    yield f"{entry.code}{levels}: {entry.title}"
    for name, text in (("means", entry.meaning), ("judged", entry.judged), ("to do", entry.action)):
        if text:
            yield ""
            yield from textwrap.wrap(f"{name:<8}{text}", _WIDTH, subsequent_indent=" " * 8, break_on_hyphens=False)
