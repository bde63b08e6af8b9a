"""Readers of an arm and its joint limits: from a trial's artefacts, or from a chain's YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config.chain import ChainFile, is_chain, load_chain
from mocap_id.config.parsing import suggest_name
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry import Chain, Revolute, se3
from mocap_id.prescription.arms import PlanarArm, SpatialArm
from mocap_id.prescription.joint_limits import JointLimits, find_limits
from mocap_id.store import Folder, Table, Tree
from mocap_id.store.views import Skeleton, joint_columns
from mocap_id.workflows.run_folder import check_provenance, open_run_to

_LAST = "ukf-smooth"


@dataclass(frozen=True)
class SubjectArm:
    """An arm with its joint limits."""

    name: str
    joints: tuple[str, ...]
    arm: PlanarArm | SpatialArm
    limits: JointLimits
    tip: str  # a marker, or a point
    observed: FloatArray  # (T, n) recorded postures, rad; empty for a chain in YAML
    notes: tuple[str, ...]  # limitations of the result


def read_arm(
    path: Path, tip: str | None = None, quantile: float = 0.0, progress: runner.Progress = lambda step: None
) -> SubjectArm:
    """Return the arm from a trial's YAML file or run folder, or from a chain's YAML file.

    Parameters
    ----------
    path : Path
        A trial's YAML file is run up to the joint states, which needs no forces.
    tip : str, optional
        A marker of the last segment, or a point ``x,y`` in its frame, m; by default the marker farthest from the joint.
    quantile : float
        Fraction of the samples that is left out at each end of the range of an observed angle.
    progress : callable, optional
        Called with each step of the run if ``path`` is a trial's YAML file.

    Raises
    ------
    ConfigError
        The file, the tip or the quantile is wrong.
    RecordingError
        The motion does not determine the joint limits.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`.
    """
    if not path.is_dir() and is_chain(path):
        if tip is not None or quantile:
            raise ConfigError(
                f"{path}: a chain's YAML file contains `tip:` and limits; leave out `--tip` and `--quantile`"
            )
        return _read_chain(load_chain(path))
    folder, trial = open_run_to(path, _LAST, progress)
    return read_folder(folder, path.name if trial is None else trial.name, path, tip, quantile)


def read_folder(folder: Folder, name: str, source: Path, tip: str | None, quantile: float) -> SubjectArm:
    """Return the arm from the artefacts in a run folder; ``source`` is the path in messages.

    Raises
    ------
    StoreError
        An artefact is missing or damaged, or was not computed from the other artefacts in the folder.
    ConfigError, RecordingError
        As for :func:`read_arm`.
    """
    check_provenance(folder, ("chain.h5", "states.parquet"))
    chain, states = folder.read("chain.h5"), folder.read("states.parquet")
    assert isinstance(chain, Tree) and isinstance(states, Table)
    skeleton = Skeleton.from_tree(chain)
    centres, covariance = skeleton.centres, skeleton.covariance
    tip_name, local, error = _find_tip(skeleton, chain.numbers("markers/residual"), tip, source)
    notes = []
    if not np.isfinite(covariance).all():
        covariance = np.zeros_like(covariance)
        notes.append(
            "the joints have no standard deviations, so the interval includes only the uncertainty of the limits"
        )
    q, sd, observed = (joint_columns(states, name, len(centres)) for name in ("theta", "sd_theta", "observed"))
    seen = observed.astype(bool)
    if not np.isfinite(sd[seen & np.isfinite(q)]).all():
        notes.append("some angles have no standard deviation, so the interval is too narrow")
    try:
        limits = find_limits(q, np.nan_to_num(sd), seen, quantile)
    except ValueError as wrong:
        kind = ConfigError if "quantile" in str(wrong) else RecordingError
        raise kind(f"{source}: {wrong}") from wrong
    # The frame of the tip starts at the last joint, so the error of this joint also belongs to the tip.
    arm = PlanarArm(centres, local, covariance, covariance[-1] + error**2 * np.eye(2))
    complete = q[np.all(seen & np.isfinite(q), axis=1)]
    return SubjectArm(name, skeleton.joints, arm, limits, tip_name, complete, tuple(notes))


def _read_chain(chain: ChainFile) -> SubjectArm:
    """Return the arm of a chain's YAML file."""
    limits = JointLimits.given(chain.limits[:, 0], chain.limits[:, 1])
    arm: PlanarArm | SpatialArm
    if chain.planar:
        arm = PlanarArm.exact(chain.places[:, :2], chain.tip[:2])
    else:
        joints = tuple(Revolute((float(x), float(y), float(z))) for x, y, z in chain.axes)
        arm = SpatialArm(Chain(joints, se3.pose(np.eye(3), chain.places)), chain.tip)
    point = ", ".join(f"{x:g}" for x in chain.tip)
    return SubjectArm(chain.name, chain.joints, arm, limits, f"({point}) m", np.zeros((0, limits.dimension)), ())


def _find_tip(skeleton: Skeleton, residual: FloatArray, tip: str | None, source: Path) -> tuple[str, FloatArray, float]:
    """Return name and position (2,) of the tip in the last segment's frame, and the rms error of this position, m."""
    labels, segment, local, last = skeleton.markers, skeleton.marker_segment, skeleton.local, len(skeleton.centres)
    if tip is not None and "," in tip:
        return f"({tip}) m", _parse_point(tip), 0.0
    own = [k for k in range(len(labels)) if segment[k] == last]
    if not own:
        raise RecordingError(f"{source}: the last segment has no marker: give the tip as a point, `--tip x,y`")
    if tip is None:
        k = max(own, key=lambda k: float(np.linalg.norm(local[k])))
    elif tip in labels and labels.index(tip) in own:
        k = labels.index(tip)
    else:
        known = [labels[k] for k in own]
        about = "is not on the last segment" if tip in labels else "is not a marker of the chain"
        raise ConfigError(f"{source}: the tip `{tip}` {about}: {suggest_name(tip, known)}")
    return labels[k], local[k], float(np.nan_to_num(residual[k]))


def _parse_point(text: str) -> FloatArray:
    """Return the point (2,) in the text of `--tip`; raise ConfigError if it is not two numbers."""
    try:
        point = np.array([float(part) for part in text.split(",")])
    except ValueError:
        point = np.zeros(0)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ConfigError(f"--tip {text}: expected a marker of the last segment, or a point `x,y` in its frame, m")
    return point
