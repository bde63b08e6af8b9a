"""Export formats, and the export of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mocap_id import runner
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store.atomic import write_files
from mocap_id.workflows.export.files import ExportFiles
from mocap_id.workflows.export.forces import forces
from mocap_id.workflows.export.free_bodies import free_model, free_poses, free_states
from mocap_id.workflows.export.kinetics_toolkit import kinetics_toolkit
from mocap_id.workflows.export.markers import markers
from mocap_id.workflows.export.motions import angles, states, torques
from mocap_id.workflows.export.opensim import opensim
from mocap_id.workflows.export.space import forces as spatial_forces
from mocap_id.workflows.export.space import model as spatial_model
from mocap_id.workflows.export.space import motions as spatial_motions
from mocap_id.workflows.export.space import spreadsheets as spatial_spreadsheets
from mocap_id.workflows.export.spreadsheets import spreadsheets
from mocap_id.workflows.run_folder import RunFolder, open_run

FORMATS: Mapping[str, tuple[Callable[[RunFolder], ExportFiles], ...]] = {
    "trc": (markers,),
    "mot": (angles, forces, free_poses),
    "sto": (states, torques, free_states),
    "csv": (spreadsheets,),
    "osim": (opensim, free_model),
    "ktk": (kinetics_toolkit,),
}
"""Functions that make the files of each format, for a trial in the plane."""

IN_SPACE: Mapping[str, tuple[Callable[[RunFolder], ExportFiles], ...]] = {
    "trc": (markers,),
    "mot": (spatial_motions.model_motion, spatial_motions.joint_angles, spatial_forces.forces),
    "sto": (spatial_motions.states,),
    "csv": (spatial_spreadsheets.spreadsheets,),
    "osim": (spatial_model.opensim,),
    "ktk": (kinetics_toolkit,),
}
"""Functions that make the files of each format, for a trial in space."""


@dataclass(frozen=True)
class Export:
    """Written files, and notes on missing content and on assumptions."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def export(
    trial: Path,
    formats: Sequence[str],
    out: Path | None = None,
    *,
    force: bool = False,
    progress: runner.Progress = lambda step: None,
) -> Export:
    """Write a run in the formats of other programs.

    Parameters
    ----------
    trial : Path
        As for :func:`mocap_id.workflows.run_folder.open_run`.
    formats : sequence of str
        Some of :data:`FORMATS`.
    out : Path, optional
        Output folder, created if necessary; by default ``export`` in the run folder.
    force : bool
        Overwrite existing files.
    progress : callable, optional
        Called with each step of a run.

    Raises
    ------
    ConfigError
        A format is unknown.
    StoreError
        A file exists already, the folder cannot be written, or the run has no content for these formats.
    RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        found = f"unknown format {unknown[0]!r}" if unknown else "no format"
        raise ConfigError(f"{found}; expected some of {', '.join(FORMATS)}")
    run = open_run(trial, progress)
    folder = run.path / "export" if out is None else out
    makers = [make for name in FORMATS if name in formats for make in (IN_SPACE if run.in_space else FORMATS)[name]]
    made = sum((make(run) for make in makers), ExportFiles())
    if not made.files:
        raise StoreError(f"{run.path} has no data for the formats {', '.join(formats)}: {'; '.join(made.notes)}")
    existing = [folder / name for name in made.files if (folder / name).exists()]
    if existing and not force:
        raise StoreError(
            f"{existing[0]} exists already: choose another folder with `out=` or `--out`, or overwrite it with "
            "`force=True` or `--force`"
        )
    write_files(folder, made.files)
    return Export(tuple(folder / name for name in made.files), made.notes)
