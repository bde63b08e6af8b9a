"""The body that springs assist: geometry, weights, joint limits and the person's strength."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config.prescription import JointWish, PrescriptionConfig
from mocap_id.errors import ConfigError
from mocap_id.prescription.arms import PlanarArm
from mocap_id.prescription.joint_limits import JointLimits
from mocap_id.prescription.one_joint import ChainMasses, OneJoint
from mocap_id.prescription.sampling import sobol
from mocap_id.store import Tree
from mocap_id.workflows.run_folder import check_provenance, open_run_to
from mocap_id.workflows.workspace.arm_source import SubjectArm, read_folder

_LAST = "identify-dim"


@dataclass(frozen=True)
class AssistedBody:
    """A planar chain of n joints with its weights, limits and strength."""

    joints: tuple[str, ...]  # names
    arm: PlanarArm
    weights: ChainMasses | None  # None if the trial's dynamics were not identified
    limits: JointLimits
    strength: FloatArray  # (n, 2) limits of the person's torque, N·m; NaN if they depend on unknown weights
    inertia: float | None  # inertia about the joint, kg·m²; None if it is unknown or there are several joints
    subject: SubjectArm | None  # the arm of the trial that the body comes from; None without a trial
    why: str = ""  # why there are no weights

    def one_joint(self) -> OneJoint:
        """Return the model of the only joint; the body must have one joint, and known weights."""
        assert self.weights is not None
        limits = float(self.limits.lower[0]), float(self.limits.upper[0])
        return self.weights.one_joint(0, np.zeros(1), limits, (float(self.strength[0, 0]), float(self.strength[0, 1])))


def read_body(config: PrescriptionConfig, progress: runner.Progress) -> AssistedBody:
    """Return the body of a configuration; a trial's YAML file is run up to its dynamics.

    Raises
    ------
    ConfigError
        The configuration describes a different number of joints than the trial has, or all masses are zero.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`.
    """
    wishes = config.wishes
    if wishes.arm is not None:
        arm = wishes.arm
        down = np.array([[arm.mass_kg, 0.0, -arm.mass_kg * arm.lever_m]])
        inertia = arm.inertia_kgm2 if arm.inertia_kgm2 is not None else arm.mass_kg * arm.lever_m**2
        chain = PlanarArm.exact(np.zeros((1, 2)), np.array([0.0, -arm.lever_m]))
        return _make_body(config, ("joint",), chain, down, None, inertia, wishes.gravity)
    if wishes.chain is not None:
        chain = PlanarArm.exact(np.array([part.at_m for part in wishes.chain]), np.array(wishes.tip_m))
        masses = np.array([[1.0, *part.centre_m] for part in wishes.chain])
        masses *= np.array([[part.mass_kg] for part in wishes.chain])
        names = tuple(part.name for part in wishes.chain)
        return _make_body(config, names, chain, masses, None, None, wishes.gravity)
    return _read_trial_body(config, progress)


def _read_trial_body(config: PrescriptionConfig, progress: runner.Progress) -> AssistedBody:
    """Return the body of a trial."""
    wishes = config.wishes
    assert wishes.trial is not None
    folder, trial = open_run_to(wishes.trial, _LAST, progress)
    name = wishes.trial.name if trial is None else trial.name
    subject = read_folder(folder, name, wishes.trial, wishes.tip, 0.0)
    check_provenance(folder, ("chain.h5", "states.parquet", "dynamics.h5"))
    dynamics = folder.read("dynamics.h5")
    assert isinstance(dynamics, Tree) and isinstance(subject.arm, PlanarArm)
    n = subject.arm.joints
    if len(wishes.joints) != n:
        raise ConfigError(
            f"{config.where('joints')}: {len(wishes.joints)} joints are described, but trial {name} has {n}: "
            f"{', '.join(subject.joints)}"
        )
    full = dynamics.numbers("full/value", (n + 1, 4))[1:]
    known = np.isfinite(full[:, :3]).all()
    gravity = float(folder.provenance("dynamics.h5").origin.parameters[_LAST]["gravity"])
    why = "" if known else str(dynamics.facts.get("why") or "its inertial parameters are not all known")
    inertia = float(full[0, 3]) if n == 1 and known else None
    return _make_body(
        config, subject.joints, subject.arm, full[:, :3] if known else None, subject, inertia, gravity, why
    )


def _make_body(  # noqa: PLR0917
    config: PrescriptionConfig,
    names: tuple[str, ...],
    arm: PlanarArm,
    masses: FloatArray | None,
    subject: SubjectArm | None,
    inertia: float | None,
    gravity: float,
    why: str = "",
) -> AssistedBody:
    """Return the body; joint limits in the configuration replace the limits observed in the trial."""
    wishes = config.wishes
    observed = subject.limits if subject is not None else None
    lower, upper = np.empty(len(names)), np.empty(len(names))
    for j, joint in enumerate(wishes.joints):
        if joint.limits_deg is not None:
            lower[j], upper[j] = np.radians(joint.limits_deg)
        else:
            assert observed is not None
            lower[j], upper[j] = observed.lower[j], observed.upper[j]
    limits = JointLimits.given(lower, upper)
    try:
        weights = None if masses is None else ChainMasses(arm.centres, masses, gravity)
    except ValueError as error:
        raise ConfigError(f"{config.where()}: {error}") from error
    largest = np.full(len(names), np.nan) if weights is None else _largest_moments(weights, limits)
    strength = np.array([_torque_limits(joint, size) for joint, size in zip(wishes.joints, largest, strict=True)])
    return AssistedBody(names, arm, weights, limits, strength, inertia, subject, why)


def _largest_moments(weights: ChainMasses, limits: JointLimits) -> FloatArray:
    """Return the largest moment of gravity about each joint, (n,) N·m.

    Several joints stay within their limits; a single joint may have any angle.
    """
    q = limits.lower + sobol(2048, limits.dimension, 0) * (limits.upper - limits.lower)
    if limits.dimension == 1:
        return np.array([weights.one_joint(0, np.zeros(1), (0.0, 1.0), (-1.0, 1.0)).weight])
    return np.asarray(np.abs(weights.torques(q)).max(axis=0))


def _torque_limits(joint: JointWish, largest: float) -> tuple[float, float]:
    """Return the lower and upper limit of the person's torque, N·m; ``largest`` is the largest moment of gravity."""
    if joint.strength_Nm is not None:
        return joint.strength_Nm
    share = joint.strength_share
    low, high = share if isinstance(share, tuple) else (-float(share or 0.0), float(share or 0.0))
    return low * largest, high * largest
