"""All that ``mocap-id export`` does: whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mocap_id import runner
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.export.forces import forces
from mocap_id.workflows.export.free_bodies import free_model, free_poses, free_states
from mocap_id.workflows.export.markers import markers
from mocap_id.workflows.export.motions import angles, states, torques
from mocap_id.workflows.export.opensim import opensim
from mocap_id.workflows.export.parts import Parts
from mocap_id.workflows.export.spreadsheets import spreadsheets
from mocap_id.workflows.run_folder import RunFolder, open_run

FORMATS: Mapping[str, tuple[Callable[[RunFolder], Parts], ...]] = {
    "trc": (markers,),
    "mot": (angles, forces, free_poses),
    "sto": (states, torques, free_states),
    "csv": (spreadsheets,),
    "osim": (opensim, free_model),
}
"""What makes the files of each format."""


@dataclass(frozen=True)
class Exported:
    """What was written, and sentences on what is missing or what it rests on."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def export(
    trial: Path,
    formats: Sequence[str],
    out: Path | None = None,
    *,
    force: bool = False,
    progress: runner.Progress = lambda step: None,
) -> Exported:
    """Write a run in other programs' formats.

    Parameters
    ----------
    trial : Path
        As for :func:`mocap_id.workflows.run_folder.open_run`.
    formats : sequence of str
        Some of :data:`FORMATS`.
    out : Path, optional
        The folder, made where it is not there; by default ``export`` in the run folder.
    force : bool
        Overwrite what is there.
    progress : callable, optional
        Told of every stage of a YAML file.

    Raises
    ------
    ConfigError
        There is no such format.
    StoreError
        A file is there already, the folder cannot be written, or the run has nothing for any of these formats.
    RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        raise ConfigError(f"--to: {unknown[0] if unknown else 'nothing'}: expected some of {', '.join(FORMATS)}")
    run = open_run(trial, progress)
    folder = run.path / "export" if out is None else out
    wanted = [make for name in FORMATS if name in formats for make in FORMATS[name]]
    parts = sum((make(run) for make in wanted), Parts())
    if not parts.files:
        raise StoreError(f"{run.path} holds nothing for {', '.join(formats)}: {'; '.join(parts.notes)}")
    there = [folder / name for name in parts.files if (folder / name).exists()]
    if there and not force:
        raise StoreError(f"{there[0]} is there already: choose another folder with --out, or overwrite with --force")
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    replace_together(folder, parts.files)
    return Exported(tuple(folder / name for name in parts.files), parts.notes)
