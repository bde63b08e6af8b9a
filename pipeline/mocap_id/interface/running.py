"""Functions that run a trial from a YAML file, a recording or arrays, and that open an existing run."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import mocap_id_simulation as simulation
from mocap_id import runner
from mocap_id.config import load
from mocap_id.config.parsing import suggest_name
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


Kind: TypeAlias = Literal[
    "sit-to-stand", "robot", "arm", "chain", "robot-in-space", "robot-set", "cohort", "reach-cohort", "curl-study"
]

_TRIALS: dict[str, tuple[Callable[..., Path], Any]] = {
    "sit-to-stand": (partial(simulation.simulate, "sit-to-stand"), simulation.Options),
    "robot": (partial(simulation.simulate, "robot"), simulation.Options),
    "arm": (simulation.write_arm, simulation.ArmOptions),
    "chain": (simulation.write_chain, simulation.ChainOptions),
    "robot-in-space": (simulation.simulate_space_robot, simulation.SpaceRobotOptions),
}
_SETS: dict[str, tuple[Callable[..., Path], Any]] = {
    "robot-set": (simulation.simulate_robot_set, simulation.RobotSet),
    "cohort": (simulation.simulate_cohort, simulation.Cohort),
    "reach-cohort": (simulation.simulate_reach_cohort, simulation.ReachCohort),
    "curl-study": (simulation.simulate_curl_study, simulation.CurlStudy),
}


def simulate(kind: Kind, folder: str | PathLike[str], **options: Any) -> Path:
    """Simulate recordings with their exact truth, and return the path of the YAML file of the trial or study.

    Parameters
    ----------
    kind : str
        Name of a command of ``mocap-id simulate``.
    folder : path
        A new folder, to which all files are written.
    **options
        Options of this command, such as ``seed=1``.

    Raises
    ------
    ConfigError
        There is no such kind or option, or a value is out of range.
    StoreError
        The folder already contains a trial, or cannot be written.
    """
    if kind not in {**_TRIALS, **_SETS}:
        raise ConfigError(f"simulate: there is no kind {kind!r}: {suggest_name(kind, (*_TRIALS, *_SETS))}")
    write, model = {**_TRIALS, **_SETS}[kind]
    chosen = model()
    own = [each.name for each in fields(model) if each.name != "options"]
    common = [each.name for each in fields(chosen.options)] if kind in _SETS else []
    for name in options:
        if name not in (*own, *common):
            raise ConfigError(f"simulate {kind}: there is no option {name!r}: {suggest_name(name, (*own, *common))}")
    if common:
        shared = replace(chosen.options, **{name: options.pop(name) for name in common if name in options})
        options["options"] = shared
    return write(Path(folder), replace(chosen, **options))
