"""Functions that run a trial from a YAML file, a recording or arrays, and that open an existing run."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager, nullcontext
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id import runner
from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.interface.run_result import Run
from mocap_id.workflows.run_folder import open_lazily

if TYPE_CHECKING:
    from mocap_id.recording.model import Recording

RECORDINGS = (".c3d", ".trc", ".tsv", ".csv", ".txt", ".zip")
"""Endings of the names of recordings; any other file is treated as a trial's YAML file."""


def run(
    source: str | PathLike[str] | Recording,
    /,
    *,
    forces: str | PathLike[str] | None = None,
    save: str | PathLike[str] | None = None,
    progress: runner.Progress = lambda step: None,
    **settings: Any,
) -> Run:
    """Run the whole pipeline on a trial, and return its results; results that are up to date are reused.

    Parameters
    ----------
    source : path or Recording
        A trial's YAML file, or a recording: a C3D or TRC file, a text export, or arrays in memory. The results of a
        recording are written to ``runs/<trial>`` in the working folder, with the settings in ``trial.yaml``.
    forces : path, optional
        MOT file with the ground forces of a TRC file; by default the MOT file of the same name beside it.
    save : path, optional
        YAML file to which the settings are written instead of ``trial.yaml``; the results are then in ``runs/<trial>``
        beside it.
    progress : callable, optional
        Called with each step of the run.
    **settings
        Keys of a trial's YAML file, such as ``protocol="free"``, ``window=(1, 5)``, ``subject={"mass": 70}`` or
        ``fit_joints={...}``; only with a recording. Space and protocol are guessed from the motion if they are not
        given; the log and the note ``guessed`` of the verdict contain the guesses.

    Raises
    ------
    ConfigError, RecordingError, NumericalError, StoreError
        As described in :mod:`mocap_id.errors`; ConfigError also if the motion of a recording without settings fits no
        protocol. A refused trial raises no exception: see the verdict of the run.
    """
    given = Path(source) if isinstance(source, str | PathLike) else source
    if not isinstance(given, Path) or given.suffix.lower() in RECORDINGS:
        from mocap_id.workflows.recording_trial import make_trial  # noqa: PLC0415  a YAML file does not need it

        keys = settings if forces is None else {"forces": forces, **settings}
        trial = make_trial(given, keys, None if save is None else Path(save))
    elif settings or forces is not None or save is not None:
        raise ConfigError(
            f"{source} contains the settings of its trial, so no settings can be given here: change the file, or give "
            "the recording instead"
        )
    else:
        trial = load(given)
    with _limit_threads():
        outcome = runner.run(trial, progress=progress)
    return Run(open_lazily(outcome.folder), outcome.steps)


def _limit_threads() -> AbstractContextManager[object]:
    """Return a context in which the linear algebra uses one thread, unless environment variables set the number.

    The matrices are so small that several threads would wait for each other longer than they compute.
    """
    if {"OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"} & os.environ.keys():
        return nullcontext()
    import scipy.linalg  # noqa: F401, PLC0415  the limit applies only to loaded libraries
    from threadpoolctl import threadpool_limits  # noqa: PLC0415

    limit: AbstractContextManager[object] = threadpool_limits(1, "blas")
    return limit


def open(folder: str | PathLike[str]) -> Run:
    """Open a run folder such as ``runs/s01``, and return its results; nothing is computed.

    Raises
    ------
    StoreError
        The folder contains no artefacts of a run.
    """
    return Run(open_lazily(Path(folder)))
