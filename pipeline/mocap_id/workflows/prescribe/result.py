"""The result of a prescription: the springs, and the ranges that the person can reach and hold with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mocap_id.arrays import FloatArray
from mocap_id.config.prescription import PrescriptionConfig
from mocap_id.prescription.level_set import JointDynamics, ReachableSet
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.one_spring import Prescription
from mocap_id.prescription.postures import Postures, SpringPlace
from mocap_id.prescription.several_springs import Springs
from mocap_id.prescription.sub_workspaces import Graph
from mocap_id.workflows.prescribe.assisted_body import AssistedBody
from mocap_id.workflows.prescribe.controlled_tasks import ControlledTasks
from mocap_id.workflows.prescribe.device_springs import DeviceSprings
from mocap_id.workflows.prescribe.spring_map import SpringMap
from mocap_id.workflows.workspace import Reach

if TYPE_CHECKING:
    from mocap_id.workflows.prescribe.controlled_chain import ControlledChain


@dataclass(frozen=True)
class Timed:
    """The angles that can be held with a spring, and that are reached within each of several times."""

    dynamics: JointDynamics
    reached: ReachableSet
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
    workspace: Reach | None = None  # the workspace within the joint limits of a trial
    timed: Timed | None = None
    map: SpringMap | None = None
    graph: Graph | None = None
    graph_postures: FloatArray | None = None  # (N, n) the postures of the graph, rad
    devices: DeviceSprings | None = None
    controlled: ControlledTasks | ControlledChain | None = None

    @property
    def refused(self) -> str | None:
        """Why no springs could be prescribed; None if springs could be prescribed."""
        return self.body.why or None if self.body.weights is None else None
