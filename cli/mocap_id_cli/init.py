"""``mocap-id init``: a first study file for a folder of recordings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id_cli.console import align

if TYPE_CHECKING:
    from mocap_id.workflows.study.discovery import Discovery

_PLURALS = {"strategy": "strategies", "session": "sessions", "side": "sides"}


def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the recordings.", show_default=False)],
    *,
    pattern: Annotated[
        str | None,
        typer.Option(
            help="Pattern that says where a recording's path contains person and strategy, such as "
            "'{subject}/{strategy}*.c3d'; default: determined from the paths."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="STUDY.yaml", help="File to write.")] = Path("study.yaml"),
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what was found, and write nothing.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    keep_names: Annotated[
        bool, typer.Option("--keep-names", help="Use the names in the recordings' paths as ids, instead of s01, s02 …")
    ] = False,
) -> None:
    """Write a study file for a folder of recordings.

    The recordings are C3D files, TRC files with their MOT files, exports of QTM, Motive or Nexus, or skeletons of a
    depth camera or markerless software. For markers of an arm without a force plate, and for skeletons, the file is of
    a study of reaches. People get ids. Keep subjects.csv, which is written beside the file: it lists names and ids.
    """
    from mocap_id.workflows.study import discovery  # noqa: PLC0415  no other command has to wait for it

    known = {} if keep_names else discovery.read_known_ids(out)
    found = discovery.discover(folder, pattern, keep_names=keep_names, known=known)
    typer.echo("\n".join(_lines(found, folder)))
    if dry_run:
        typer.echo("nothing written: --dry-run")
        return
    written = discovery.write_draft(found, out, keep_names=keep_names, force=force)
    typer.echo("\n".join(f"wrote {path}" for path in written))


def _lines(found: Discovery, folder: Path) -> Iterator[str]:
    yield f"pattern: {found.pattern}"
    if found.tried and ("{subject}" not in found.pattern or any("pattern" in why for why in found.left_out.values())):
        yield f"tried: {', '.join(found.tried)}; give another pattern with --pattern"
    labels = ("session", "side") if found.reach else ("strategy",)
    rows = [["trial", "subject", "called", *labels, "recording"]]
    for trial in found.trials:
        files = [path.relative_to(folder).as_posix() for path in (trial.markers, trial.forces) if path is not None]
        values = [getattr(trial, name) or "–" for name in labels]
        rows.append([trial.trial, trial.subject, trial.name, *values, " + ".join(files)])
    yield from align(rows)
    counts = ", ".join(f"{len({getattr(trial, name) for trial in found.trials})} {_PLURALS[name]}" for name in labels)
    named = [trial for trial in found.trials if trial.name.casefold() in trial.markers.stem.casefold()]
    if named and named[0].name != named[0].subject:
        yield (
            f"note: {named[0].markers.name} contains the name of {named[0].subject}, and the report of a trial shows "
            "the name of its file: rename such files before you give reports to others"
        )
    yield from (f"note: {doubt}" for doubt in found.doubts)
    yield f"{len(found.trials)} trials of {len(found.names)} people, {counts}"
    for path, why in found.left_out.items():
        yield f"left out: {path.relative_to(folder).as_posix()}: {why}"
