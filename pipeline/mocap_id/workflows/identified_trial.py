"""Trials with identified dynamics, opened for use by other workflows."""

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
from mocap_id.dynamics.cutoffs import Cutoffs
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.motion import move_chain
from mocap_id.dynamics.parameter_transfer import BodyFrames
from mocap_id.dynamics.reference_prior import ReferencePrior, compute_reference_sd
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.store import Folder, LongTable, Table, Tree
from mocap_id.store.views import Skeleton, Trajectories, joint_columns
from mocap_id.workflows.moving_bodies import MovingBodies, on_measured_poses
from mocap_id.workflows.run_folder import check_provenance, open_run_to

_LAST = "identify-dim"
_FILES = (
    "planar.parquet",
    "wrench.parquet",
    "chain.h5",
    "states.parquet",
    "poses.parquet",
    "dynamics.parquet",
    "dynamics.h5",
)


@dataclass(frozen=True)
class IdentifiedTrial:
    """A trial with its bodies, their motion and their identified parameters.

    Parameters
    ----------
    name : str
        The trial's name.
    source : Path
        The path given on the command line.
    folder : Path
        The run folder.
    chain : MovingBodies
        The n + 1 segments of the pinned chain.
    measured : MovingBodies or None
        The bodies on measured poses from which the model was identified; None if it was identified on the chain.
    q, dq, ddq : (T, n) arrays
        Joint angles and derivatives, rad; NaN where unknown.
    dynamics : DataFrame
        Rows of `dynamics.parquet`.
    parameters : (4K,) array
        Full parameters of the K :attr:`bodies`, SI; NaN if nothing was identified.
    covariance : (4K, 4K) array
        Covariance of these parameters. On the chain, it combines the covariance of the base parameters with the
        reference's deviations where they leave the full parameters open. NaN if nothing was identified or no reference
        applies.
    reference : (4K,) array
        Parameters of the allometric body; NaN if none applies.
    facts : mapping
        Facts of `dynamics.h5`.
    mass : float or None
        Mass that the plates measure while the person stands, kg.
    cop_threshold : float
        Vertical force below which the centre of pressure is undefined, N.
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
        """The K bodies on which the trial's own model was identified."""
        return self.measured or self.chain

    @property
    def skeleton(self) -> BodyFrames:
        """Frames of :attr:`bodies`."""
        return self.bodies.skeleton

    def regressor(self) -> FloatArray:
        """Return the unfiltered regressor of the wrench on :attr:`bodies`, (T, 3, 4K)."""
        return self.bodies.regressor

    def torque_regressor(self, regressor: FloatArray) -> FloatArray:
        """Return the regressor of the joint torques, (T, n, 4K), given that of the wrench."""
        return torque_regressor(self.bodies.motion, regressor)

    @property
    def bands(self) -> Cutoffs:
        """Cut-off frequencies for x, y and angle of measured poses, Hz: the model's, else the default."""
        return _measured_bodies(self.facts)[1]

    @cached_property
    def planar(self) -> Trajectories:
        """The markers in the plane."""
        artefact, segments = (Folder(self.folder).read(f"{name}.parquet") for name in ("planar", "segments"))
        assert isinstance(artefact, LongTable)
        assert isinstance(segments, Table)
        return Trajectories(artefact, segments.facts.get("bad_stretches", ()))

    def in_band(self, signal: FloatArray) -> FloatArray:
        """Return a signal (T, ...) filtered as for the trial's comparison of model and plate.

        On measured poses, this is the low-pass of the fit; a model of the chain is compared unfiltered.
        """
        if self.measured is None:
            return signal
        time = self.dynamics["time"].to_numpy(dtype=np.float64)
        lowpass = LowPass(float(self.facts["cutoff_hz"]), (len(time) - 1) / (time[-1] - time[0]))
        return lowpass(signal)


def open_identified_trial(path: Path, progress: runner.Progress = lambda step: None) -> IdentifiedTrial:
    """Open a trial with its dynamics.

    Parameters
    ----------
    path : Path
        The trial's YAML file: missing or outdated results are computed first, up to `identify-dim`. Or its run folder,
        which is read unchanged.
    progress : callable, optional
        Called with each step of a run.

    Raises
    ------
    Refused
        The trial was refused.
    StoreError
        The folder lacks an artefact, or holds artefacts of different runs.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    folder, _ = open_run_to(path, _LAST, progress)
    parameters = check_provenance(folder, _FILES)["dynamics.h5"].origin.parameters
    skeleton, dynamics = Skeleton.from_tree(_tree(folder, "chain.h5")), _tree(folder, "dynamics.h5")
    states, wrench, poses = (_table(folder, f"{name}.parquet") for name in ("states", "wrench", "poses"))
    frames, gravity = _chain_frames(skeleton), float(parameters[_LAST]["gravity"])
    q, dq, ddq = (joint_columns(states, name, len(skeleton.centres)) for name in ("theta", "dtheta", "ddtheta"))
    used, bands = _measured_bodies(dynamics.facts)
    reference = dynamics.numbers("bodies/reference")
    prior = ReferencePrior(reference, compute_reference_sd(reference, float(parameters[_LAST]["reference_sd"])))
    return IdentifiedTrial(
        name=str(parameters["trial"]),
        source=path,
        folder=folder.path,
        chain=MovingBodies(frames, move_chain(frames.centres, q, dq, ddq), gravity),
        measured=on_measured_poses(poses, frames.centres, used, bands, gravity) if used else None,
        q=q,
        dq=dq,
        ddq=ddq,
        dynamics=_table(folder, "dynamics.parquet").frame,
        parameters=dynamics.numbers("bodies/value"),
        covariance=dynamics.array("bodies/covariance") if used else _chain_covariance(dynamics, prior),
        reference=reference,
        facts=dynamics.facts,
        mass=wrench.facts.get("mass_kg"),
        cop_threshold=float(wrench.facts["cop_threshold_N"]),
    )


def _measured_bodies(facts: Mapping[str, Any]) -> tuple[list[int], Cutoffs]:
    """Return the indices in poses.parquet of the identified bodies (none for the chain) and the cut-offs, Hz."""
    motion = facts["motion"] or {}
    bands = motion.get("bands_hz")
    return list(motion.get("used", ())), USUAL if bands is None else (bands["x"], bands["y"], bands["angle"])


def _chain_covariance(dynamics: Tree, prior: ReferencePrior) -> FloatArray:
    known, regrouping = dynamics.array("base/covariance"), dynamics.array("base/regrouping")
    if (common := dynamics.facts.get("calibration_covariance")) is not None:
        known = known - np.asarray(common)  # the predicted wrench is measured by the same instruments
    if not (np.isfinite(known).all() and np.isfinite(prior.mean).all()):
        return np.full((len(prior.mean), len(prior.mean)), np.nan)
    return prior.complete(known.astype(np.float64), regrouping.astype(np.float64))


def _chain_frames(chain: Skeleton) -> BodyFrames:
    joints = len(chain.centres)
    between = np.column_stack([np.arange(joints), np.arange(1, joints + 1)])
    return BodyFrames(chain.segments, chain.centres, between, chain.markers, chain.marker_segment, chain.local)


def _tree(folder: Folder, file: str) -> Tree:
    artefact = folder.read(file)
    assert isinstance(artefact, Tree)
    return artefact


def _table(folder: Folder, file: str) -> Table:
    artefact = folder.read(file)
    assert isinstance(artefact, Table)
    return artefact
