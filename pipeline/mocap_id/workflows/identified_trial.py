"""Trials with identified dynamics, for other workflows."""

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
from mocap_id.dynamics.identification import Cutoffs
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.parameter_transfer import BodyFrames
from mocap_id.dynamics.preparation import LowPass
from mocap_id.dynamics.priors import ReferencePrior, compute_reference_sd
from mocap_id.dynamics.regressor import move_chain
from mocap_id.store import Folder, Tree
from mocap_id.store.views import Skeleton, Trajectories, joint_columns
from mocap_id.workflows.moving_bodies import MovingBodies, read_measured_bodies
from mocap_id.workflows.run_folder import check_provenance, open_run_to

_LAST = "identify-dim"
_TABLES = ("wrench.parquet", "states.parquet", "poses.parquet", "dynamics.parquet")
_FILES = ("planar.parquet", *_TABLES, "chain.h5", "dynamics.h5")


@dataclass(frozen=True)
class IdentifiedTrial:
    """A trial with its K bodies, their motion and their identified parameters, SI."""

    name: str  # name of the trial
    source: Path  # path that the user gave
    folder: Path  # run folder
    chain: MovingBodies  # the n + 1 segments of the pinned chain
    # bodies with measured poses, if the model was identified on them; None if the model was identified on the chain
    measured: MovingBodies | None
    q: FloatArray  # (T, n) joint angles, rad; NaN if unknown
    dq: FloatArray  # (T, n) rad/s
    ddq: FloatArray  # (T, n) rad/s²
    dynamics: pd.DataFrame  # rows of `dynamics.parquet`
    parameters: FloatArray  # (4K,) full parameters of :attr:`bodies`; NaN if nothing was identified
    # (4K, 4K) covariance of the parameters. For the chain, it combines the covariance of the base parameters with the
    # standard deviations of the reference, where the base parameters do not determine the full parameters. NaN if
    # nothing was identified or there is no reference
    covariance: FloatArray
    reference: FloatArray  # (4K,) parameters of the allometric body; NaN if there is none
    facts: Mapping[str, Any]  # facts of `dynamics.h5`
    mass: float | None  # mass that the plates measure while the person stands, kg; None if unknown
    cop_threshold: float  # vertical force below which the centre of pressure is undefined, N

    @property
    def bodies(self) -> MovingBodies:
        """The bodies on which the trial's own model was identified."""
        return self.measured or self.chain

    @property
    def skeleton(self) -> BodyFrames:
        """Coordinate frames of :attr:`bodies`."""
        return self.bodies.skeleton

    @property
    def bands(self) -> Cutoffs:
        """Cut-off frequencies for x, y and angle of measured poses, Hz: those of the model, or else the defaults."""
        return _read_measured(self.facts)[1]

    @cached_property
    def planar(self) -> Trajectories:
        """The trajectories of the markers in the plane."""
        folder = Folder(self.folder)
        segments = folder.table("segments.parquet")
        return Trajectories(folder.long_table("planar.parquet"), segments.facts.get("bad_stretches", ()))

    def in_band(self, signal: FloatArray) -> FloatArray:
        """Return a signal (T, ...) in the frequency band in which the trial's model is compared with the plate.

        For measured poses, this is the band of the fit. For the chain, the signal is returned unfiltered.
        """
        if self.measured is None:
            return signal
        time = self.dynamics["time"].to_numpy(dtype=np.float64)
        lowpass = LowPass(float(self.facts["cutoff_hz"]), (len(time) - 1) / (time[-1] - time[0]))
        return lowpass(signal)


def open_identified_trial(path: Path, progress: runner.Progress = lambda step: None) -> IdentifiedTrial:
    """Open a trial, and return it with its motion and identified dynamics.

    ``path`` and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`; only results up to
    `identify-dim` are computed.

    Raises
    ------
    Refused
        The trial was refused.
    StoreError
        The folder lacks an artefact, or contains artefacts of different runs.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    folder, _ = open_run_to(path, _LAST, progress)
    parameters = check_provenance(folder, _FILES)["dynamics.h5"].origin.parameters
    skeleton, tree = Skeleton.from_tree(folder.tree("chain.h5")), folder.tree("dynamics.h5")
    wrench, states, poses, dynamics = map(folder.table, _TABLES)
    frames, gravity = _make_frames(skeleton), float(parameters[_LAST]["gravity"])
    q, dq, ddq = (joint_columns(states, name, len(skeleton.centres)) for name in ("theta", "dtheta", "ddtheta"))
    used, bands = _read_measured(tree.facts)
    reference = tree.numbers("bodies/reference")
    prior = ReferencePrior(reference, compute_reference_sd(reference, float(parameters[_LAST]["reference_sd"])))
    return IdentifiedTrial(
        name=str(parameters["trial"]),
        source=path,
        folder=folder.path,
        chain=MovingBodies(frames, move_chain(frames.centres, q, dq, ddq), gravity),
        measured=read_measured_bodies(poses, skeleton, tree.facts["motion"], bands, gravity) if used else None,
        q=q,
        dq=dq,
        ddq=ddq,
        dynamics=dynamics.frame,
        parameters=tree.numbers("bodies/value"),
        covariance=tree.array("bodies/covariance") if used else _combine_covariance(tree, prior),
        reference=reference,
        facts=tree.facts,
        mass=wrench.facts.get("mass_kg"),
        cop_threshold=float(wrench.facts["cop_threshold_N"]),
    )


def _read_measured(facts: Mapping[str, Any]) -> tuple[list[int], Cutoffs]:
    """Return the indices in poses.parquet of the identified bodies (empty for the chain) and the cut-offs, Hz."""
    motion = facts["motion"] or {}
    bands = motion.get("bands_hz")
    return list(motion.get("used", ())), USUAL if bands is None else (bands["x"], bands["y"], bands["angle"])


def _combine_covariance(dynamics: Tree, prior: ReferencePrior) -> FloatArray:
    """Return the covariance (4K, 4K) of the chain's full parameters; NaN without base parameters or reference."""
    known, regrouping = dynamics.array("base/covariance"), dynamics.array("base/regrouping")
    if (common := dynamics.facts.get("calibration_covariance")) is not None:
        known = known - np.asarray(common)  # the same in all trials with these instruments
    if not (np.isfinite(known).all() and np.isfinite(prior.mean).all()):
        return np.full((len(prior.mean), len(prior.mean)), np.nan)
    return prior.complete(known.astype(np.float64), regrouping.astype(np.float64))


def _make_frames(chain: Skeleton) -> BodyFrames:
    joints = len(chain.centres)
    between = np.column_stack([np.arange(joints), np.arange(1, joints + 1)])
    return BodyFrames(chain.segments, chain.centres, between, chain.markers, chain.marker_segment, chain.local)
