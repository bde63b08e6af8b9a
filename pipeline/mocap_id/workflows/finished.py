"""A trial whose dynamics are there to be used: from its YAML, run as far as needed, or from its run folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics.carry import Skeleton
from mocap_id.dynamics.reference_term import Prior, deviations
from mocap_id.dynamics.regressor import planar_regressor, planar_torque_regressor
from mocap_id.store import Folder, Table, Tree
from mocap_id.workflows.run_folder import check_origins

_LAST = "identify-dim"
_READ = ("wrench.parquet", "chain.h5", "states.parquet", "dynamics.parquet", "dynamics.h5")


@dataclass(frozen=True)
class Finished:
    """What other trials may ask of one.

    Parameters
    ----------
    name : str
        The trial's name.
    source : Path
        As given on the command line.
    skeleton : Skeleton
    q, dq, ddq : (T, n) arrays
        Joint angles and derivatives, rad; NaN where unknown.
    dynamics : DataFrame
        Rows of `dynamics.parquet`.
    parameters : (4(n + 1),) array
        Full parameters; NaN where nothing was identified.
    covariance : (4(n + 1), 4(n + 1)) array
        Of the full parameters: the base parameters' own, and the reference's deviations in what these leave open. NaN
        where nothing was identified or no reference applies.
    reference : (4(n + 1),) array
        Those of the allometric body; NaN where none applies.
    facts : mapping
        Of `dynamics.h5`.
    mass : float or None
        What the plates show while the person stands, kg.
    cop_threshold : float
        Vertical force up to which there is no centre of pressure, N.
    gravity : float
        m/s².
    """

    name: str
    source: Path
    skeleton: Skeleton
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    dynamics: pd.DataFrame
    parameters: FloatArray
    covariance: FloatArray
    reference: FloatArray
    facts: Mapping[str, Any]
    mass: float | None
    cop_threshold: float
    gravity: float

    def regressor(self) -> FloatArray:
        """Of the ground's wrench, (T, 3, 4(n + 1)), unfiltered."""
        return planar_regressor(self.skeleton.centres, self.q, self.dq, self.ddq, self.gravity)

    def torque_regressor(self, regressor: FloatArray) -> FloatArray:
        """Of the joint torques, (T, n, 4(n + 1)), from that of the wrench."""
        return planar_torque_regressor(self.skeleton.centres, self.q, regressor)


def finished(path: Path, progress: runner.Progress = lambda step: None) -> Finished:
    """A trial with its dynamics.

    Parameters
    ----------
    path : Path
        Its YAML file: what is missing or out of date is computed, up to `identify-dim`. Or its run folder, which is
        taken as it is.
    progress : callable, optional
        Told of every stage of a YAML file.

    Raises
    ------
    Refused
        The trial was refused.
    StoreError
        The folder lacks an artefact, or holds artefacts that were not made from one another.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    if path.is_dir():
        return _read(path, path)
    trial = load(path)
    outcome = runner.run_to(trial, _LAST, progress=progress)
    if outcome.refused is not None:
        raise outcome.refused
    return _read(path, outcome.folder)


def _read(source: Path, path: Path) -> Finished:
    folder = Folder(path)
    check_origins(path, {file: folder.provenance(file) for file in _READ})
    chain, dynamics = _tree(folder, "chain.h5"), _tree(folder, "dynamics.h5")
    states, wrench = _table(folder, "states.parquet").frame, _table(folder, "wrench.parquet")
    asked = folder.provenance("dynamics.h5").origin.parameters
    skeleton = _skeleton(chain)
    reference = _array(dynamics, "full", "reference").astype(np.float64)
    prior = Prior(reference, deviations(reference, float(asked[_LAST]["reference_sd"])))

    def columns(name: str) -> FloatArray:
        return np.column_stack([states[f"{name}_{j}"].to_numpy() for j in range(1, len(skeleton.segments))])

    return Finished(
        name=str(asked["trial"]),
        source=source,
        skeleton=skeleton,
        q=columns("theta"),
        dq=columns("dtheta"),
        ddq=columns("ddtheta"),
        dynamics=_table(folder, "dynamics.parquet").frame,
        parameters=_array(dynamics, "full", "value").astype(np.float64),
        covariance=_covariance(dynamics, prior),
        reference=reference,
        facts=dynamics.facts,
        mass=wrench.facts.get("mass_kg"),
        cop_threshold=float(wrench.facts["cop_threshold_N"]),
        gravity=float(asked[_LAST]["gravity"]),
    )


def _covariance(dynamics: Tree, prior: Prior) -> FloatArray:
    known, regrouping = _array(dynamics, "base", "covariance"), _array(dynamics, "base", "regrouping")
    if not (np.isfinite(known).all() and np.isfinite(prior.mean).all()):
        return np.full((len(prior.mean), len(prior.mean)), np.nan)
    return prior.completed(known.astype(np.float64), regrouping.astype(np.float64))


def _skeleton(chain: Tree) -> Skeleton:
    return Skeleton(
        segments=tuple(map(str, _array(chain, "segments", "name"))),
        centres=_array(chain, "joints", "centre").astype(np.float64),
        markers=tuple(map(str, _array(chain, "markers", "name"))),
        segment=_array(chain, "markers", "segment").astype(np.int64),
        local=_array(chain, "markers", "local").astype(np.float64),
    )


def _array(tree: Tree, group: str, name: str) -> np.ndarray[Any, Any]:
    node: Any = tree.data[group]
    return np.asarray(node[name])


def _tree(folder: Folder, file: str) -> Tree:
    artefact = folder.read(file)
    assert isinstance(artefact, Tree)
    return artefact


def _table(folder: Folder, file: str) -> Table:
    artefact = folder.read(file)
    assert isinstance(artefact, Table)
    return artefact
