"""``mocap-id init``: the first version of a study's file, from a folder of recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from mocap_id.workflows.study.discovery import Discovery


def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Holds the recordings.", show_default=False)],
    *,
    pattern: Annotated[
        str | None,
        typer.Option(
            help="Where person and strategy stand in a recording's path, such as '{subject}/{strategy}*.c3d'; found "
            "otherwise."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="STUDY.yaml", help="File to write.")] = Path("study.yaml"),
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what was found and write nothing.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite what is there.")] = False,
    keep_names: Annotated[
        bool, typer.Option("--keep-names", help="Call people what their recordings do, and not s01, s02 …")
    ] = False,
) -> None:
    """Write the file of a study from a folder of recordings: C3D files, or TRC files with their MOT.

    People get ids; who is who goes to subjects.csv beside the file, which you keep.
    """
    from mocap_id.workflows.study import discovery, drafting  # noqa: PLC0415  no other command has to wait for it

    found = discovery.discover(
        folder, pattern, keep_names=keep_names, known={} if keep_names else drafting.known_names(out)
    )
    typer.echo("\n".join(_lines(found, folder)))
    if dry_run:
        typer.echo("nothing written: --dry-run")
        return
    written = drafting.write(found, out, keep_names=keep_names, force=force)
    typer.echo("\n".join(f"wrote {path}" for path in written))


def _lines(found: Discovery, folder: Path) -> Iterator[str]:
    yield f"pattern: {found.pattern}"
    rows = [["trial", "subject", "called", "strategy", "recording"]]
    for trial in found.trials:
        files = [path.relative_to(folder).as_posix() for path in (trial.markers, trial.forces) if path is not None]
        rows.append([trial.trial, trial.subject, trial.name, trial.strategy, " + ".join(files)])
    yield from aligned(rows)
    people, strategies = len(found.names), len({trial.strategy for trial in found.trials})
    shown = [trial for trial in found.trials if trial.name.casefold() in trial.markers.stem.casefold()]
    if shown and shown[0].name != shown[0].subject:
        yield (
            f"note: {shown[0].markers.name} tells what {shown[0].subject} is called, and a trial's report shows "
            "the name of its file: rename such files before reports are passed on"
        )
    yield f"{len(found.trials)} trials of {people} people, {strategies} strategies"
    for path, why in found.left_out.items():
        yield f"left out: {path.relative_to(folder).as_posix()}: {why}"


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows with their columns below one another."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
