"""The body that is to be helped: its geometry, its weights, its limits and the person's strength."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.config.prescription import JointWish, PrescriptionConfig
from mocap_id.errors import ConfigError
from mocap_id.prescription.gravity import Weights
from mocap_id.prescription.limits import Limits
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.reach import PlanarArm
from mocap_id.prescription.sampling import sobol
from mocap_id.store import Folder, Tree
from mocap_id.workflows.run_folder import check_origins
from mocap_id.workflows.workspace.sources import Subject, of_folder

_LAST = "identify-dim"


@dataclass(frozen=True)
class Body:
    """A planar chain of n joints with what a prescription asks of it.

    Parameters
    ----------
    joints : tuple of str
    arm : PlanarArm
    weights : Weights or None
        None where the trial's dynamics were not identified.
    limits : Limits
    strength : (n, 2) array
        N·m; NaN where it is a share of weights that are not known.
    inertia : float or None
        Of one joint, kg·m².
    subject : Subject or None
        The trial that it comes from.
    why : str
        Why there are no weights.
    """

    joints: tuple[str, ...]
    arm: PlanarArm
    weights: Weights | None
    limits: Limits
    strength: FloatArray
    inertia: float | None
    subject: Subject | None
    why: str = ""

    def one_joint(self) -> OneJoint:
        """The body as one joint."""
        assert self.weights is not None
        limits = float(self.limits.lower[0]), float(self.limits.upper[0])
        return self.weights.one_joint(0, np.zeros(1), limits, (float(self.strength[0, 0]), float(self.strength[0, 1])))


def body(config: PrescriptionConfig, progress: runner.Progress) -> Body:
    """The body of a configuration; a trial's YAML file is run as far as its dynamics.

    Raises
    ------
    ConfigError
        The trial has another number of joints, or there is no weight.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`.
    """
    wishes = config.wishes
    if wishes.arm is not None:
        arm = wishes.arm
        down = np.array([[arm.mass_kg, 0.0, -arm.mass_kg * arm.lever_m]])
        inertia = arm.inertia_kgm2 if arm.inertia_kgm2 is not None else arm.mass_kg * arm.lever_m**2
        chain = PlanarArm.exact(np.zeros((1, 2)), np.array([0.0, -arm.lever_m]))
        return _body(config, ("joint",), chain, down, None, inertia, wishes.gravity)
    if wishes.chain is not None:
        chain = PlanarArm.exact(np.array([part.at_m for part in wishes.chain]), np.array(wishes.tip_m))
        masses = np.array([[1.0, *part.centre_m] for part in wishes.chain])
        masses *= np.array([[part.mass_kg] for part in wishes.chain])
        names = tuple(part.name for part in wishes.chain)
        return _body(config, names, chain, masses, None, None, wishes.gravity)
    return _of_trial(config, progress)


def _of_trial(config: PrescriptionConfig, progress: runner.Progress) -> Body:
    wishes = config.wishes
    assert wishes.trial is not None
    if wishes.trial.is_dir():
        path, name = wishes.trial, wishes.trial.name
    else:
        trial = load(wishes.trial)
        outcome = runner.run_to(trial, _LAST, progress=progress)
        if outcome.refused is not None:
            raise outcome.refused
        path, name = outcome.folder, trial.name
    folder = Folder(path)
    subject = of_folder(folder, name, wishes.trial, wishes.tip, 0.0)
    check_origins(path, {file: folder.provenance(file) for file in ("chain.h5", "states.parquet", "dynamics.h5")})
    dynamics = folder.read("dynamics.h5")
    assert isinstance(dynamics, Tree) and isinstance(subject.arm, PlanarArm)
    n = subject.arm.joints
    if len(wishes.joints) != n:
        raise ConfigError(
            f"{config.where('joints')}: {len(wishes.joints)} joints are described, trial {name} has {n}: "
            f"{', '.join(subject.joints)}"
        )
    full = np.asarray(_values(dynamics, "full"), dtype=np.float64).reshape(n + 1, 4)[1:]
    known = np.isfinite(full[:, :3]).all()
    gravity = float(folder.provenance("dynamics.h5").origin.parameters[_LAST]["gravity"])
    why = "" if known else str(dynamics.facts.get("why") or "its inertial parameters are not all known")
    inertia = float(full[0, 3]) if n == 1 and known else None
    return _body(config, subject.joints, subject.arm, full[:, :3] if known else None, subject, inertia, gravity, why)


def _values(tree: Tree, group: str) -> FloatArray:
    branch: Any = tree.data[group]
    return np.asarray(branch["value"])


def _body(  # noqa: PLR0917
    config: PrescriptionConfig,
    names: tuple[str, ...],
    arm: PlanarArm,
    masses: FloatArray | None,
    subject: Subject | None,
    inertia: float | None,
    gravity: float,
    why: str = "",
) -> Body:
    """Put together, with the limits of the configuration over those of the trial."""
    wishes = config.wishes
    seen = subject.limits if subject is not None else None
    lower, upper = np.empty(len(names)), np.empty(len(names))
    for j, joint in enumerate(wishes.joints):
        if joint.limits_deg is not None:
            lower[j], upper[j] = np.radians(joint.limits_deg)
        else:
            assert seen is not None
            lower[j], upper[j] = seen.lower[j], seen.upper[j]
    limits = Limits.given(lower, upper)
    try:
        weights = None if masses is None else Weights(arm.centres, masses, gravity)
    except ValueError as error:
        raise ConfigError(f"{config.where()}: {error}") from error
    largest = np.full(len(names), np.nan) if weights is None else _largest(weights, limits)
    strength = np.array([_strength(joint, size) for joint, size in zip(wishes.joints, largest, strict=True)])
    return Body(names, arm, weights, limits, strength, inertia, subject, why)


def _largest(weights: Weights, limits: Limits) -> FloatArray:
    """Largest moment of gravity about each joint, whatever its own limits: others within theirs, (n,) N·m."""
    q = limits.lower + sobol(2048, limits.dimension, 0) * (limits.upper - limits.lower)
    if limits.dimension == 1:
        return np.array([weights.one_joint(0, np.zeros(1), (0.0, 1.0), (-1.0, 1.0)).weight])
    return np.asarray(np.abs(weights.torques(q)).max(axis=0))


def _strength(joint: JointWish, largest: float) -> tuple[float, float]:
    if joint.strength_Nm is not None:
        return joint.strength_Nm
    share = joint.strength_share
    low, high = share if isinstance(share, tuple) else (-float(share or 0.0), float(share or 0.0))
    return low * largest, high * largest
