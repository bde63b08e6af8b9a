"""Export of a run to other programs: OpenSim files, and tables with units in their headers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from mocap_id import runner
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store.atomic import write_files
from mocap_id.store.folder import check_owner, store_owner
from mocap_id.workflows.export.opensim_model import export_model, export_spatial_model
from mocap_id.workflows.export.opensim_tables import (
    export_anatomical_angles,
    export_angles,
    export_forces,
    export_free_model,
    export_free_poses,
    export_free_states,
    export_model_motion,
    export_states,
    export_torques,
)
from mocap_id.workflows.export.tables import (
    ExportFiles,
    export_kinetics_toolkit,
    export_markers,
    export_spatial_tables,
    export_tables,
)
from mocap_id.workflows.run_folder import RunFolder, find_owner_of_files, open_run

Exporters: TypeAlias = Mapping[str, tuple[Callable[[RunFolder, ExportFiles], None], ...]]
"""Functions that add the files of each format, by the name of the format."""

FORMATS: Exporters = {
    "trc": (export_markers,),
    "mot": (export_angles, export_forces, export_free_poses),
    "sto": (export_states, export_torques, export_free_states),
    "csv": (export_tables,),
    "osim": (export_model, export_free_model),
    "ktk": (export_kinetics_toolkit,),
}
"""Exporters of a trial in the plane."""

_NO_STATES = "sto: not available in space: the CSV tables contain velocities and accelerations"
IN_SPACE: Exporters = {
    "trc": (export_markers,),
    "mot": (export_model_motion, export_anatomical_angles, export_forces),
    "sto": (lambda _, out: out.note(_NO_STATES),),
    "csv": (export_spatial_tables,),
    "osim": (export_spatial_model,),
    "ktk": (export_kinetics_toolkit,),
}
"""Exporters of a trial in space."""


@dataclass(frozen=True)
class Export:
    """Paths of the written files, and notes on missing content and on assumptions."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def export_run(
    trial: Path,
    formats: Sequence[str],
    out: Path | None = None,
    *,
    force: bool = False,
    progress: runner.Progress = lambda step: None,
) -> Export:
    """Write a run in some of the :data:`FORMATS` of other programs, and return the paths of the files.

    ``trial`` and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`. The files are in ``out``, by
    default in ``export`` in the run folder. With ``force``, existing files of the same recording are overwritten.

    Raises
    ------
    ConfigError
        A format is unknown.
    StoreError
        A file exists already, the folder cannot be written or contains files of another recording with this trial's
        name, or the run has no content for these formats.
    RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        found = f"unknown format {unknown[0]!r}" if unknown else "no format"
        raise ConfigError(f"{found}; expected some of {', '.join(FORMATS)}")
    run = open_run(trial, progress)
    folder = run.path / "export" if out is None else out
    made = ExportFiles()
    for name, exporters in (IN_SPACE if run.in_space else FORMATS).items():
        for add_files in exporters if name in formats else ():
            add_files(run, made)
    if not made.files:
        raise StoreError(f"{run.path} has no data for the formats {', '.join(formats)}: {'; '.join(made.notes)}")
    owner, output = find_owner_of_files(run.path), f"export-{run.name.lower()}"  # the trial's name begins all names
    if out is not None:
        check_owner(folder, owner, output, path=folder / next(iter(made.files)))
    existing = [folder / name for name in made.files if (folder / name).exists()]
    if existing and not force:
        raise StoreError(
            f"{existing[0]} exists already: choose another folder with `out=` or `--out`, or overwrite it with "
            "`force=True` or `--force`"
        )
    write_files(folder, made.files)
    if out is not None:
        store_owner(folder, owner, output)
    return Export(tuple(folder / name for name in made.files), tuple(made.notes))
