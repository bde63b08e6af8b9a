"""A trial whose dynamics are there to be used: from its YAML, run as far as needed, or from its run folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics.bands import Bands
from mocap_id.dynamics.carry import Skeleton
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.motion import chain_motion
from mocap_id.dynamics.reference_term import Prior, deviations
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.stages.trajectories import PlanarView
from mocap_id.store import Folder, LongTable, Table, Tree
from mocap_id.workflows.moving_bodies import MovingBodies, on_measured_poses
from mocap_id.workflows.run_folder import check_origins

_LAST = "identify-dim"
_READ = (
    "planar.parquet",
    "wrench.parquet",
    "chain.h5",
    "states.parquet",
    "poses.parquet",
    "dynamics.parquet",
    "dynamics.h5",
)


@dataclass(frozen=True)
class Finished:
    """What other trials may ask of one.

    Parameters
    ----------
    name : str
        The trial's name.
    source : Path
        As given on the command line.
    folder : Path
        Of the run.
    chain : MovingBodies
        The segments of the pinned chain, n + 1 of them.
    measured : MovingBodies or None
        The bodies on their own measured poses that the model was identified on; None where that was the chain.
    q, dq, ddq : (T, n) arrays
        Joint angles and derivatives, rad; NaN where unknown.
    dynamics : DataFrame
        Rows of `dynamics.parquet`.
    parameters : (4K,) array
        Full parameters of the K :attr:`bodies`; NaN where nothing was identified.
    covariance : (4K, 4K) array
        Of these. On the chain it is that of the base parameters, and the reference's deviations in what they leave
        open. NaN where nothing was identified or no reference applies.
    reference : (4K,) array
        Those of the allometric body; NaN where none applies.
    facts : mapping
        Of `dynamics.h5`.
    mass : float or None
        What the plates show while the person stands, kg.
    cop_threshold : float
        Vertical force up to which there is no centre of pressure, N.
    """

    name: str
    source: Path
    folder: Path
    chain: MovingBodies
    measured: MovingBodies | None
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

    @property
    def bodies(self) -> MovingBodies:
        """The K bodies that the trial's own model was identified on."""
        return self.measured or self.chain

    @property
    def skeleton(self) -> Skeleton:
        """Of :attr:`bodies`."""
        return self.bodies.skeleton

    def regressor(self) -> FloatArray:
        """Of the wrench on :attr:`bodies`, (T, 3, 4K), unfiltered."""
        return self.bodies.regressor

    def torque_regressor(self, regressor: FloatArray) -> FloatArray:
        """Of the joint torques, (T, n, 4K), from that of the wrench."""
        return torque_regressor(self.bodies.motion, regressor)

    @property
    def bands(self) -> Bands:
        """Cut-offs of x, y and angle of measured poses, Hz: the model's, else the usual ones."""
        return _choice(self.facts)[1]

    @cached_property
    def planar(self) -> PlanarView:
        """The markers in the plane."""
        artefact = Folder(self.folder).read("planar.parquet")
        assert isinstance(artefact, LongTable)
        return PlanarView(artefact)

    def in_band(self, signal: FloatArray) -> FloatArray:
        """A signal (T, ...) in the band in which the trial compares model and plate: that of the fit on measured poses.

        A model of the chain is compared without a filter.
        """
        if self.measured is None:
            return signal
        time = self.dynamics["time"].to_numpy(dtype=np.float64)
        lowpass = LowPass(float(self.facts["cutoff_hz"]), (len(time) - 1) / (time[-1] - time[0]))
        return lowpass(signal)


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
    states, wrench, poses = (_table(folder, f"{name}.parquet") for name in ("states", "wrench", "poses"))
    asked = folder.provenance("dynamics.h5").origin.parameters
    skeleton, gravity = _skeleton(chain), float(asked[_LAST]["gravity"])
    joints = range(1, len(skeleton.segments))
    names = ("theta", "dtheta", "ddtheta")
    q, dq, ddq = (states.stack([f"{name}_{j}" for j in joints]) for name in names)
    used, bands = _choice(dynamics.facts)
    reference = _array(dynamics, "bodies", "reference").astype(np.float64)
    prior = Prior(reference, deviations(reference, float(asked[_LAST]["reference_sd"])))
    return Finished(
        name=str(asked["trial"]),
        source=source,
        folder=path,
        chain=MovingBodies(skeleton, chain_motion(skeleton.centres, q, dq, ddq), gravity),
        measured=on_measured_poses(poses, skeleton.centres, used, bands, gravity) if used else None,
        q=q,
        dq=dq,
        ddq=ddq,
        dynamics=_table(folder, "dynamics.parquet").frame,
        parameters=_array(dynamics, "bodies", "value").astype(np.float64),
        covariance=_array(dynamics, "bodies", "covariance") if used else _covariance(dynamics, prior),
        reference=reference,
        facts=dynamics.facts,
        mass=wrench.facts.get("mass_kg"),
        cop_threshold=float(wrench.facts["cop_threshold_N"]),
    )


def _choice(facts: Mapping[str, Any]) -> tuple[list[int], Bands]:
    """Places in poses.parquet of the bodies that were identified, and cut-offs, Hz; no places for the chain."""
    motion = facts["motion"] or {}
    bands = motion.get("bands_hz")
    return list(motion.get("used", ())), USUAL if bands is None else (bands["x"], bands["y"], bands["angle"])


def _covariance(dynamics: Tree, prior: Prior) -> FloatArray:
    known, regrouping = _array(dynamics, "base", "covariance"), _array(dynamics, "base", "regrouping")
    if not (np.isfinite(known).all() and np.isfinite(prior.mean).all()):
        return np.full((len(prior.mean), len(prior.mean)), np.nan)
    return prior.completed(known.astype(np.float64), regrouping.astype(np.float64))


def _skeleton(chain: Tree) -> Skeleton:
    centres = _array(chain, "joints", "centre").astype(np.float64)
    joints = len(centres)
    return Skeleton(
        segments=tuple(map(str, _array(chain, "segments", "name"))),
        centres=centres,
        between=np.column_stack([np.arange(joints), np.arange(1, joints + 1)]),
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
