"""Where an arm and its limits come from: a trial's artefacts, or a chain's YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.config.chain import ChainFile, is_chain, load_chain
from mocap_id.config.explain import nearest
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry import Chain, Revolute, se3
from mocap_id.prescription.limits import Limits, observed_limits
from mocap_id.prescription.reach import PlanarArm, SpatialArm
from mocap_id.store import Folder, Table, Tree
from mocap_id.workflows.run_folder import check_origins

_LAST = "ukf-smooth"


@dataclass(frozen=True)
class Subject:
    """An arm, its limits, and what is known of it.

    Parameters
    ----------
    name : str
    joints : tuple of str
    arm : PlanarArm or SpatialArm
    limits : Limits
    tip : str
        A marker, or a point.
    observed : (T, n) array
        Postures of the recording, rad; none for a chain written in YAML.
    notes : tuple of str
        What to know before believing it.
    """

    name: str
    joints: tuple[str, ...]
    arm: PlanarArm | SpatialArm
    limits: Limits
    tip: str
    observed: FloatArray
    notes: tuple[str, ...]


def subject(
    path: Path, tip: str | None = None, quantile: float = 0.0, progress: runner.Progress = lambda step: None
) -> Subject:
    """An arm of a trial's YAML file or run folder, or of a chain's YAML file.

    Parameters
    ----------
    path : Path
        A trial's YAML file is run as far as the joint states, which needs no forces.
    tip : str, optional
        A marker of the last segment, or a point ``x,y`` in its frame, m. By default its marker farthest from the joint.
    quantile : float
        Share of the samples left out at either end of an observed angle.
    progress : callable, optional
        Told of every stage of a trial's YAML file.

    Raises
    ------
    ConfigError
        The file, the tip or the quantile is wrong.
    RecordingError
        The motion shows no limits.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`.
    """
    if not path.is_dir() and is_chain(path):
        if tip is not None or quantile:
            raise ConfigError(f"{path}: a chain in YAML has its own `tip:` and limits; leave `--tip`, `--quantile` out")
        return _of_chain(load_chain(path))
    if path.is_dir():
        return of_folder(Folder(path), path.name, path, tip, quantile)
    trial = load(path)
    outcome = runner.run_to(trial, _LAST, progress=progress)
    if outcome.refused is not None:
        raise outcome.refused
    return of_folder(Folder(outcome.folder), trial.name, path, tip, quantile)


def of_folder(folder: Folder, name: str, source: Path, tip: str | None, quantile: float) -> Subject:
    """An arm of the artefacts in a run folder; `source` is what messages call it.

    Raises
    ------
    StoreError
        An artefact is missing, damaged, or was made from others than those beside it.
    ConfigError, RecordingError
        As for :func:`subject`.
    """
    check_origins(folder.path, {file: folder.provenance(file) for file in ("chain.h5", "states.parquet")})
    chain, states = folder.read("chain.h5"), folder.read("states.parquet")
    assert isinstance(chain, Tree) and isinstance(states, Table)
    centres = _array(chain, "joints", "centre")
    where, local, error = _tip(chain, tip, source)
    covariance = _array(chain, "joints", "covariance")
    notes = []
    if not np.isfinite(covariance).all():
        covariance = np.zeros_like(covariance)
        notes.append("the joints have no standard deviations, so the interval holds those of the limits alone")
    columns = [
        states.stack([f"{prefix}_{j}" for j in range(1, len(centres) + 1)])
        for prefix in ("theta", "sd_theta", "observed")
    ]
    q, sd, seen = columns[0].astype(float), columns[1].astype(float), columns[2].astype(bool)
    if not np.isfinite(sd[seen & np.isfinite(q)]).all():
        notes.append("some angles have no standard deviation, so the interval holds less than it should")
    try:
        limits = observed_limits(q, np.nan_to_num(sd), seen, quantile)
    except ValueError as wrong:
        kind = ConfigError if "quantile" in str(wrong) else RecordingError
        raise kind(f"{source}: {wrong}") from wrong
    # The tip is given in a frame that starts at the last joint, so that joint's error is the tip's too.
    arm = PlanarArm(centres, local, covariance, covariance[-1] + error**2 * np.eye(2))
    names = tuple(map(str, np.asarray(_node(chain, "joints", "name"))))
    shown = q[np.all(seen & np.isfinite(q), axis=1)]
    return Subject(name, names, arm, limits, where, shown, tuple(notes))


def _of_chain(chain: ChainFile) -> Subject:
    limits = Limits.given(chain.limits[:, 0], chain.limits[:, 1])
    arm: PlanarArm | SpatialArm
    if chain.planar:
        arm = PlanarArm.exact(chain.places[:, :2], chain.tip[:2])
    else:
        joints = tuple(Revolute((float(x), float(y), float(z))) for x, y, z in chain.axes)
        arm = SpatialArm(Chain(joints, se3.pose(np.eye(3), chain.places)), chain.tip)
    point = ", ".join(f"{x:g}" for x in chain.tip)
    return Subject(chain.name, chain.joints, arm, limits, f"({point}) m", np.zeros((0, limits.dimension)), ())


def _tip(chain: Tree, tip: str | None, source: Path) -> tuple[str, FloatArray, float]:
    """What the tip is called, its place in the last segment's frame, m, and the error of that, m."""
    labels = [str(label) for label in np.asarray(_node(chain, "markers", "name"))]
    segment = _array(chain, "markers", "segment").astype(np.int64)
    local, residual = _array(chain, "markers", "local"), _array(chain, "markers", "residual")
    last = len(_array(chain, "joints", "centre"))
    if tip is not None and "," in tip:
        return f"({tip}) m", _point(tip), 0.0
    own = [k for k in range(len(labels)) if segment[k] == last]
    if not own:
        raise RecordingError(f"{source}: the last segment has no marker: give the tip as a point, `--tip x,y`")
    if tip is None:
        k = max(own, key=lambda k: float(np.linalg.norm(local[k])))
    elif tip in labels and labels.index(tip) in own:
        k = labels.index(tip)
    else:
        known = [labels[k] for k in own]
        about = "is not on the last segment" if tip in labels else "is no marker of the chain"
        raise ConfigError(f"{source}: the tip `{tip}` {about}: {nearest(tip, known)}")
    return labels[k], local[k], float(np.nan_to_num(residual[k]))


def _point(text: str) -> FloatArray:
    try:
        point = np.array([float(part) for part in text.split(",")])
    except ValueError:
        point = np.zeros(0)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ConfigError(f"--tip {text}: expected a marker of the last segment, or a point `x,y` in its frame, m")
    return point


def _node(tree: Tree, group: str, name: str) -> Any:
    branch: Any = tree.data[group]
    return branch[name]


def _array(tree: Tree, group: str, name: str) -> FloatArray:
    return np.asarray(_node(tree, group, name), dtype=np.float64)
