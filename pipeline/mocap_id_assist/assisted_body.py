"""The body that springs assist, what is prescribed for it, and the graph of sub-workspaces of its tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id import runner
from mocap_id.arrays import BoolArray, FloatArray, sobol
from mocap_id.config.device import DeviceConfig
from mocap_id.dynamics.cylinder import Setting
from mocap_id.errors import ConfigError
from mocap_id.store import Tree
from mocap_id.workflows.run_folder import check_provenance, open_run_to
from mocap_id_assist.controllers import Controlled
from mocap_id_assist.devices import NearestSpring
from mocap_id_assist.files import PrescriptionConfig, Task
from mocap_id_assist.level_set import JointDynamics, ReachableStates
from mocap_id_assist.springs import (
    REST,
    ChainMasses,
    Graph,
    OneJoint,
    Postures,
    Prescription,
    SpringPlace,
    Springs,
    SubWorkspace,
    build_graph,
    find_held_postures,
    find_least_spring,
    prescribe_several,
    sample_postures,
)
from mocap_id_assist.workspace import JointLimits, PlanarArm, ReachableWorkspace
from mocap_id_assist.workspaces import SubjectArm, read_folder

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
    subject: SubjectArm | None = None
    masses: FloatArray | None
    inertia: float | None = None
    gravity, why = wishes.gravity, ""
    names: tuple[str, ...]
    if wishes.arm is not None:
        lever, names = wishes.arm, ("joint",)
        inertia = lever.inertia_kgm2 if lever.inertia_kgm2 is not None else lever.mass_kg * lever.lever_m**2
        arm = PlanarArm.exact(np.zeros((1, 2)), np.array([0.0, -lever.lever_m]))
        masses = np.array([[lever.mass_kg, 0.0, -lever.mass_kg * lever.lever_m]])
    elif wishes.chain is not None:
        names = tuple(part.name for part in wishes.chain)
        arm = PlanarArm.exact(np.array([part.at_m for part in wishes.chain]), np.array(wishes.tip_m))
        masses = np.array([[1.0, *part.centre_m] for part in wishes.chain])
        masses *= np.array([[part.mass_kg] for part in wishes.chain])
    else:
        assert wishes.trial is not None
        folder, trial = open_run_to(wishes.trial, _LAST, progress)
        name = wishes.trial.name if trial is None else trial.name
        subject = read_folder(folder, name, wishes.trial, wishes.tip, 0.0)
        check_provenance(folder, ("chain.h5", "states.parquet", "dynamics.h5"))
        dynamics = folder.read("dynamics.h5")
        assert isinstance(dynamics, Tree) and isinstance(subject.arm, PlanarArm)
        arm, names = subject.arm, subject.joints
        if len(wishes.joints) != arm.joints:
            raise ConfigError(
                f"{config.where('joints')}: {len(wishes.joints)} joints are described, but trial {name} has "
                f"{arm.joints}: {', '.join(names)}"
            )
        full = dynamics.numbers("full/value", (arm.joints + 1, 4))[1:]
        known = np.isfinite(full[:, :3]).all()
        gravity = float(folder.provenance("dynamics.h5").origin.parameters[_LAST]["gravity"])
        why = "" if known else str(dynamics.facts.get("why") or "its inertial parameters are not all known")
        inertia = float(full[0, 3]) if arm.joints == 1 and known else None
        masses = full[:, :3] if known else None

    # joint limits in the configuration replace the limits observed in the trial
    lower, upper = np.empty(len(names)), np.empty(len(names))
    for j, joint in enumerate(wishes.joints):
        if joint.limits_deg is not None:
            lower[j], upper[j] = np.radians(joint.limits_deg)
        else:
            assert subject is not None
            lower[j], upper[j] = subject.limits.lower[j], subject.limits.upper[j]
    limits = JointLimits.given(lower, upper)
    try:
        weights = None if masses is None else ChainMasses(arm.centres, masses, gravity)
    except ValueError as error:
        raise ConfigError(f"{config.where()}: {error}") from error

    # a share of strength refers to the largest moment of gravity about each joint: a single joint may have any angle,
    # several joints stay within their limits
    if weights is None:
        largest = np.full(len(names), np.nan)
    elif len(names) == 1:
        largest = np.array([weights.one_joint(0, np.zeros(1), (0.0, 1.0), (-1.0, 1.0)).weight])
    else:
        q = lower + sobol(2048, len(names), 0) * (upper - lower)
        largest = np.abs(weights.torques(q)).max(axis=0)
    strength = []
    for joint, size in zip(wishes.joints, largest, strict=True):
        if joint.strength_Nm is not None:
            strength.append(joint.strength_Nm)
        else:
            share = joint.strength_share
            low, high = share if isinstance(share, tuple) else (-float(share or 0.0), float(share or 0.0))
            strength.append((low * size, high * size))
    return AssistedBody(names, arm, weights, limits, np.array(strength), inertia, subject, why)


@dataclass(frozen=True)
class SpringMap:
    """The range that a person can reach and hold with each spring of a grid."""

    stiffness: FloatArray  # (K,) N·m/rad
    rest: FloatArray  # (R,) rad
    # (K, R) total width of the held intervals that are reached within the horizon, rad; NaN without an equilibrium
    # within the joint's limits
    width: FloatArray
    static: FloatArray  # (K, R) total width of the held intervals without a time limit, rad
    horizon: float  # s

    @property
    def best(self) -> tuple[int, int] | None:
        """Indices (stiffness, rest) of the spring with the largest ``width``; None if all of ``width`` is NaN."""
        if np.isnan(self.width).all():
            return None
        k, r = np.unravel_index(int(np.nanargmax(self.width)), self.width.shape)
        return int(k), int(r)


@dataclass(frozen=True)
class DeviceSpring:
    """A device that replaces a prescribed spring."""

    place: int  # index of the spring among the possible springs
    device: DeviceConfig
    setting: Setting  # the pressures in use
    nearest: NearestSpring  # the pressures that best approximate the prescribed spring


@dataclass(frozen=True)
class Timed:
    """The angles that can be held with a spring, and that are reached within each of several times."""

    dynamics: JointDynamics
    reached: ReachableStates
    bounds: tuple[tuple[float, float] | None, ...]  # range for each time, rad (table 7.2)
    # error of each range from the step of the grid, rad: the change of its ends with half as many nodes; None without
    # a range
    grid_errors: tuple[float | None, ...]
    static: tuple[float, float] | None  # range that can be held without a time limit, rad; None if it is empty
    unheld: tuple[tuple[float, float], ...]  # angles within `static` that can be passed, but not held, rad


@dataclass(frozen=True)
class PrescriptionResult:
    """The result of a prescription; a part is None if it was not configured or is not possible."""

    config: PrescriptionConfig
    body: AssistedBody
    places: tuple[SpringPlace, ...]  # the possible springs
    joint: OneJoint | None = None  # only for one joint
    one: Prescription | None = None  # only for one joint
    postures: Postures | None = None  # only for several joints
    several: Springs | None = None  # only for several joints
    workspace: ReachableWorkspace | None = None  # the workspace within the joint limits of a trial
    timed: Timed | None = None
    map: SpringMap | None = None
    graph: Graph | None = None
    devices: tuple[DeviceSpring, ...] | None = None  # empty if no spring was prescribed for the joints of a device
    device_range: tuple[float, float] | None = None  # for one joint: the widest interval held with the device, rad
    device_area: float = np.nan  # for several joints: the functional workspace with the devices, m²
    controlled: Controlled | None = None

    @property
    def refused(self) -> str | None:
        """Why no springs could be prescribed; None if springs could be prescribed."""
        return self.body.why or None if self.body.weights is None else None


_ANGLES = 1441
_LEAST_FIRST = 1e3  # penalty that favours the softest springs
_SIDE = 3  # number of points along a side of a task's box


def build_task_graph(result: PrescriptionResult) -> Graph | None:
    """Return the graph of sub-workspaces of the tasks; None without tasks.

    Tasks of one group belong to one node. The springs of a node are the softest springs that hold all its tasks. The
    node contains every posture that the person can hold with these springs.

    ValueError is raised if a task is outside the joint's limits, or cannot be reached.
    """
    groups: dict[str, list[Task]] = {}
    for task in result.config.wishes.tasks:
        groups.setdefault(task.group or task.name, []).append(task)
    if not groups:
        return None
    if result.joint is not None:
        angles = np.linspace(result.joint.lower, result.joint.upper, _ANGLES)
        nodes = [_make_angle_node(name, members, result, angles) for name, members in groups.items()]
        return build_graph(nodes, angles[:, None])
    assert result.postures is not None
    free = result.postures.cell < result.postures.cells
    nodes = [_make_tip_node(name, members, result, free) for name, members in groups.items()]
    return build_graph(nodes, result.postures.q[free])


def _make_angle_node(name: str, tasks: Sequence[Task], result: PrescriptionResult, angles: FloatArray) -> SubWorkspace:
    joint = result.joint
    assert joint is not None
    ends = np.radians([task.angles_deg for task in tasks if task.angles_deg is not None])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    if low < joint.lower or high > joint.upper:
        raise ValueError(
            f"the tasks of `{name}`, {np.degrees(low):.1f}° to {np.degrees(high):.1f}°, exceed the joint's limits"
        )
    allowed, stiffest = (result.places[0].rest, result.places[0].stiffest) if result.places else (REST, 0.0)
    spring = find_least_spring(joint, (low, high), allowed, stiffest)
    members = tuple(task.name for task in tasks)
    if spring is None:
        return SubWorkspace(name, members, None, None, np.zeros(len(angles), dtype=bool))
    stiffness, rest = spring
    torque = joint.torque(angles, stiffness, 0.0 if stiffness == 0 else rest)
    slack = 1e-6 * joint.weight
    held: BoolArray = (torque >= joint.torque_low - slack) & (torque <= joint.torque_high + slack)
    return SubWorkspace(name, members, np.array([stiffness]), np.array([rest]), held)


def _make_tip_node(name: str, tasks: Sequence[Task], result: PrescriptionResult, free: BoolArray) -> SubWorkspace:
    body, members = result.body, tuple(task.name for task in tasks)
    assert body.weights is not None and result.postures is not None
    points = np.concatenate([find_task_points(task) for task in tasks])
    wishes = result.config.wishes
    sampled = sample_postures(body.arm, body.weights, body.limits, result.places, points, wishes.postures, wishes.seed)
    try:
        springs = prescribe_several(sampled, result.places, body.strength, _LEAST_FIRST, wishes.boxes)
    except ValueError:
        return SubWorkspace(name, members, None, None, np.zeros(int(free.sum()), dtype=bool))
    held = find_held_postures(result.postures, result.places, body.strength, springs)[free]
    return SubWorkspace(name, members, springs.stiffness, springs.rest, held)


def find_task_points(task: Task) -> FloatArray:
    """Return the points (P, 2) of a task, m: the task's point, or a grid in its box."""
    if task.point_m is not None:
        return np.array([task.point_m])
    assert task.box_m is not None
    low, high = np.array(task.box_m).min(axis=0), np.array(task.box_m).max(axis=0)
    across, up = (np.linspace(a, b, _SIDE) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
