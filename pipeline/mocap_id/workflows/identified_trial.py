"""Trials with identified dynamics, for other workflows, and their bodies with their motion in other trials.

From top to bottom: bodies with their motion, which are the segments of the pinned chain or bodies with measured poses;
the identified trial; the bodies of one trial with their motion in another trial, matched by their markers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.identification import Cutoffs
from mocap_id.dynamics.measured_motion import USUAL, BodyPoses, close_gaps, fill_gaps, filter_motion
from mocap_id.dynamics.prediction import BodyFrames
from mocap_id.dynamics.preparation import LowPass
from mocap_id.dynamics.priors import ReferencePrior, compute_reference_sd
from mocap_id.dynamics.regressor import PlanarMotion, move_chain, torque_regressor, wrench_regressor
from mocap_id.errors import ConfigError
from mocap_id.geometry import planar
from mocap_id.kinematics.clusters import measure_cluster
from mocap_id.stages.identify_dim.segment_fit import bridge_gaps, read_bodies
from mocap_id.store import Folder, Table
from mocap_id.store.artefacts import Skeleton, Trajectories, joint_columns
from mocap_id.workflows.run_folder import check_provenance, open_run_to

_LAST = "identify-dim"
_TABLES = ("wrench.parquet", "states.parquet", "poses.parquet", "dynamics.parquet")
_FILES = ("planar.parquet", *_TABLES, "chain.h5", "dynamics.h5")


@dataclass(frozen=True)
class MovingBodies:
    """K bodies and their motion."""

    skeleton: BodyFrames
    motion: PlanarMotion
    gravity: float  # m/s²

    @cached_property
    def regressor(self) -> FloatArray:
        """Unfiltered regressor (T, 3, 4K) of the wrench that the motion requires."""
        return wrench_regressor(self.motion, self.gravity)

    @cached_property
    def torque_regressor(self) -> FloatArray:
        """Unfiltered regressor (T, n, 4K) of the torques of the chain's n joints."""
        return torque_regressor(self.motion, self.regressor)


def read_measured_bodies(
    poses: Table, chain: Skeleton, motion: Mapping[str, Any], bands: Cutoffs, gravity: float
) -> MovingBodies:
    """Return bodies whose motion follows from their measured poses; short gaps are filled.

    The ``poses`` are low-pass filtered with the cut-off frequencies ``bands`` (x, y, angle), Hz. ``motion`` is a fact
    of dynamics.h5, which names the bodies and the joints that are pinned.
    """
    ready = bridge_gaps(read_bodies(poses, chain.centres, motion["used"]))
    pinned = [chain.joint_names.index(name) for name, gap in motion["joints"].items() if gap["pinned"]]
    joints, body = ready.poses.joints, ready.poses.body
    frames = BodyFrames(
        segments=ready.names,
        centres=ready.poses.centres[joints],
        between=np.array([(body[j], body[j + 1]) for j in joints], dtype=np.int64).reshape(-1, 2),
        markers=tuple(label for each in ready.markers for label in each),
        segment=np.repeat(np.arange(len(ready.names)), [len(each) for each in ready.markers]),
        local=np.array([place for each in ready.markers for place in each.values()]),
    )
    return MovingBodies(frames, filter_motion(close_gaps(ready.poses, pinned), bands), gravity)


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
        return Trajectories(folder.long("planar.parquet"), segments.facts.get("bad_stretches", ()))

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

    ``path``, ``progress`` and the errors are as for :func:`mocap_id.workflows.run_folder.open_run_to`; only results up
    to `identify-dim` are computed.
    """
    folder, _ = open_run_to(path, _LAST, progress)
    parameters = check_provenance(folder, _FILES)["dynamics.h5"].origin.parameters
    skeleton, tree = Skeleton(folder.tree("chain.h5")), folder.tree("dynamics.h5")
    wrench, states, poses, dynamics = map(folder.table, _TABLES)
    joints, gravity = len(skeleton.centres), float(parameters[_LAST]["gravity"])
    between = np.column_stack([np.arange(joints), np.arange(1, joints + 1)])
    markers = (skeleton.markers, skeleton.marker_segment, skeleton.local)
    frames = BodyFrames(skeleton.segments, skeleton.centres, between, *markers)
    q, dq, ddq = (joint_columns(states, name, joints) for name in ("theta", "dtheta", "ddtheta"))
    used, bands = _read_measured(tree.facts)
    reference = tree.numbers("bodies/reference")
    if used:
        covariance = tree.array("bodies/covariance")
    else:
        prior = ReferencePrior(reference, compute_reference_sd(reference, float(parameters[_LAST]["reference_sd"])))
        known, regrouping = tree.array("base/covariance"), tree.array("base/regrouping")
        if (common := tree.facts.get("calibration_covariance")) is not None:
            known = known - np.asarray(common)  # the same in all trials with these instruments
        covariance = np.full((len(prior.mean), len(prior.mean)), np.nan)
        if np.isfinite(known).all() and np.isfinite(prior.mean).all():
            covariance = prior.complete(known.astype(np.float64), regrouping.astype(np.float64))
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
        covariance=covariance,
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


def match_bodies(source: IdentifiedTrial, target: IdentifiedTrial) -> MovingBodies:
    """Return the bodies of the source's model with their measured motion in the target.

    Two trials of a person may have chains with different segments, and a marker may belong to the foot in one and to
    the shank in the other. Parameters belong to the marker groups of the trial on which they were identified. The
    target's markers are therefore grouped as in the source: each group keeps its mass and has its own measured pose.
    ConfigError is raised if the target's markers do not determine the pose of a body.

    No joint is pinned. Joint torques are about the target's joints; they are NaN for joints that the source lacks.
    """
    frames, view = source.skeleton, target.planar
    columns = {label: column for column, label in enumerate(view.labels)}
    own, clusters = [], []
    for k, name in enumerate(frames.segments):
        markers = [i for i in np.flatnonzero(frames.segment == k) if frames.markers[i] in columns]
        points = view.read_positions(np.array([columns[frames.markers[i]] for i in markers], dtype=np.int64), axes="xy")
        local = frames.local[np.array(markers, dtype=np.int64)]
        pose = measure_cluster(np.asarray(points @ [1.0, 1.0j]), np.asarray(local @ [1.0, 1.0j]))
        if pose is None:
            raise ConfigError(
                f"{target.source}: trial {target.name} has {len(markers)} of the {int((frames.segment == k).sum())} "
                f"markers on the {name} of trial {source.name}, too few to measure its pose; expected at least two, "
                "visible together and a few centimetres apart. Markers are matched by label, so markers at the same "
                "position need the same label"
            )
        own += markers
        clusters.append(pose)
    poses, _ = fill_gaps(
        BodyPoses(
            time=view.time,
            position=np.stack([np.column_stack([pose.position.real, pose.position.imag]) for pose in clusters], axis=1),
            angle=np.column_stack([pose.angle for pose in clusters]),
            centroid=np.array([[pose.local.mean().real, pose.local.mean().imag] for pose in clusters]),
            information=np.ones((len(clusters), 2)),
            body=np.zeros(1, dtype=np.int64),
            centres=np.zeros((0, 2)),
        )
    )
    motion = filter_motion(poses, target.bands)
    # The target's n' joints and the K bodies that are beyond each (n', K): a body is in the target's segment to which
    # most of its markers belong. The centre of each joint, in the body before it, is NaN if the target lacks the joint.
    chain, joint = target.chain.skeleton, target.bodies.motion.joint  # (T, n', 2)
    joints = len(chain.centres)
    segment_of = dict(zip(chain.markers, chain.segment.tolist(), strict=True))
    segment = np.zeros(len(frames.segments), dtype=np.int64)
    for k in range(1, len(segment)):
        labels = [frames.markers[i] for i in np.flatnonzero(frames.segment == k)]
        segment[k] = Counter(segment_of.get(label, joints) for label in labels).most_common(1)[0][0]
    beyond = np.asarray(segment > np.arange(joints)[:, None])
    shared, centres = np.zeros(joint.shape[1], dtype=bool), np.full(frames.centres.shape, np.nan)
    for row, (below, above) in enumerate(frames.between):
        for j in np.flatnonzero(~beyond[:, below] & beyond[:, above]):
            centre = planar.rotate(-motion.angle[:, below], joint[:, j] - motion.origin[:, below])
            known = centre[np.isfinite(centre).all(axis=1)]
            if len(known):
                shared[j], centres[row] = True, known.mean(axis=0)
    motion = replace(motion, joint=np.where(shared[:, None], joint, np.nan), beyond=beyond)
    placed, every = np.concatenate([pose.local for pose in clusters]), np.array(own, dtype=np.int64)
    skeleton = replace(
        frames,
        centres=centres,
        markers=tuple(frames.markers[i] for i in every),
        segment=frames.segment[every],
        local=np.column_stack([placed.real, placed.imag]),
    )
    return MovingBodies(skeleton, motion, target.chain.gravity)
