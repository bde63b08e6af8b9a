"""``mocap-id sensitivity``: a trial perturbed in every way, and what it tolerates."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mocap_id import __version__, runner
from mocap_id.errors import ConfigError
from mocap_id.store import Folder, Table
from mocap_id.store.atomic import replace_together
from mocap_id.store.parquet import arrow
from mocap_id.workflows.sensitivity.asking import Asked
from mocap_id.workflows.sensitivity.columns import TABLES
from mocap_id.workflows.sensitivity.kinds import KINDS
from mocap_id.workflows.sensitivity.plan import Wish, plan
from mocap_id.workflows.sensitivity.responses import result
from mocap_id.workflows.sensitivity.studied import Studied
from mocap_id.workflows.sensitivity.subject import Perturbed, located, read
from mocap_id.workflows.sensitivity.tables import document, tables
from mocap_id.workflows.sensitivity.trying import Tried, try_all
from mocap_id.workflows.study.writing import csv, parquet

DOCUMENT, PAGE = "sensitivity.json", "sensitivity.html"


@dataclass(frozen=True)
class Outcome:
    """A sensitivity study and where it stands.

    Parameters
    ----------
    studied : Studied
    folder : Path
        Where everything was written.
    document : mapping
        What sensitivity.json holds.
    """

    studied: Studied
    folder: Path
    document: Mapping[str, Any]


Tell = Callable[[Tried, int, int], None]
"""Told of each perturbation once it is done: the how-many-th of how many."""


def sensitivity(
    path: Path,
    asked: Asked | None = None,
    *,
    jobs: int = 2,
    out: Path | None = None,
    progress: runner.Progress = lambda step: None,
    tell: Tell = lambda done, number, count: None,
) -> Outcome:
    """Perturb a trial and write what came of it.

    Parameters
    ----------
    path : Path
        The trial's YAML file, or its run folder. The run folder is only read, once the trial is computed.
    asked : Asked, optional
        What to try; everything by default.
    jobs : int
        Perturbations at a time, each in a process of its own. The answers do not depend on it.
    out : Path, optional
        Folder of the results; by default the run folder's name with ``-sensitivity``, beside it.
    progress : callable, optional
        Told of the stages that have to run first.
    tell : callable, optional
        Told of each perturbation.

    Raises
    ------
    ConfigError
        There is nothing to try on this trial, or the results would go into its run folder.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.workflows.sensitivity.subject.located`.
    """
    asked = asked or Asked()
    source = located(path, progress)
    folder = out or source.folder.with_name(f"{source.folder.name}-sensitivity")
    if folder.resolve() == source.folder.resolve():
        raise ConfigError(f"--out {folder}: this is the trial's own run folder: choose another")
    trial = read(source)
    wishes, note = _possible(asked.wishes, trial)
    changes = plan(wishes, trial.joints, asked.seed)
    with Folder(folder).locked():
        tried = try_all(source, changes, jobs, _counting(tell, len(changes)))
        studied = Studied(source.name, asked, result(trial), tried, note)
        frames = tables(studied)
        files = {**_table_files(frames), **_shown(studied, frames)}
        told = document(studied, frames, files)
        text = json.dumps(told, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        replace_together(folder, {**files, DOCUMENT: text.encode()})
    return Outcome(studied, folder, told)


def _possible(wishes: Sequence[Wish], trial: Perturbed) -> tuple[tuple[Wish, ...], str]:
    """The wishes that make sense on a trial, and what was left out."""
    if trial.has_plate:
        samples = int(trial.tree("dynamics.h5").facts["samples"] or 0)
        why = trial.tree("dynamics.h5").facts["why"]
        return tuple(
            wishes
        ), "" if samples else f"nothing was identified ({why}): lengths and states alone are compared"
    left = tuple(wish for wish in wishes if not KINDS[wish.kind].needs_plate)
    if not left:
        raise ConfigError(f"trial {trial.source.name} has no force plate: no perturbation of the wrench can be tried")
    without = [KINDS[wish.kind].title for wish in wishes if wish not in left]
    about = f"; left out: {', '.join(without)}" if without else ""
    return left, f"there is no force plate: lengths and states alone are compared{about}"


def _counting(tell: Tell, count: int) -> Callable[[Tried], None]:
    done: list[None] = []

    def told(one: Tried) -> None:
        done.append(None)
        tell(one, len(done), count)

    return told


def _table_files(frames: Mapping[str, pd.DataFrame]) -> dict[str, bytes]:
    """CSV and Parquet of each table."""
    files = {}
    for name, frame in frames.items():
        whole = arrow(Table.from_frame(TABLES[name], frame))
        files[f"{name}.csv"] = csv(whole)
        files[f"{name}.parquet"] = parquet(whole, TABLES[name], "sensitivity")
    return files


def _shown(studied: Studied, frames: Mapping[str, pd.DataFrame]) -> dict[str, bytes]:
    """The page."""
    from mocap_id.reporting.sensitivity import material, page  # noqa: PLC0415  whoever writes a page loads templates

    changes, parameters = [one.change for one in studied.tried], studied.own.parameters
    seen = material.SensitivityMaterial(
        trial=studied.trial,
        product=__version__,
        verdict=studied.own.level,
        note=studied.note,
        share=studied.asked.tolerance,
        seed=studied.asked.seed,
        parameters=tuple(
            material.ParameterEntry(name, one.unit, one.value, one.sd, one.size)
            for name, one in parameters.items()
            if name in studied.counted
        ),
        titles={change.kind: change.of.title for change in changes},
        tables=frames,
    )
    return {PAGE: page.page(seen)}
