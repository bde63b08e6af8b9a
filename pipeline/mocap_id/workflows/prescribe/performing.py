"""A prescription from its configuration: springs, reachable sets over time, the map of springs, sub-workspaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config.prescription import LevelSet, PrescriptionConfig, SpringWish
from mocap_id.errors import ConfigError
from mocap_id.prescription.level_set import Dynamics, Reached, Scheme, reach, reached_and_held
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.one_spring import REST, Prescription, Wishes, prescribe
from mocap_id.prescription.several_springs import Springs, prescribe_several
from mocap_id.prescription.springs import Place, Postures, postures
from mocap_id.prescription.sub_workspaces import Graph
from mocap_id.workflows.prescribe.bodies import Body, body
from mocap_id.workflows.prescribe.searching import SpringMap, search
from mocap_id.workflows.prescribe.tasks import task_graph
from mocap_id.workflows.workspace import Reach, measure

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Timed:
    """What is reached over time with a spring, and what of it can be held.

    Parameters
    ----------
    dynamics : Dynamics
    reached : Reached
    bounds : tuple of ((low, high) or None)
        Of each horizon, rad (table 7.2).
    static : (low, high) or None
        All that can be held, rad.
    """

    dynamics: Dynamics
    reached: Reached
    bounds: tuple[tuple[float, float] | None, ...]
    static: tuple[float, float] | None


@dataclass(frozen=True)
class Prescribed:
    """What came of a configuration; None for what was not asked, or not possible.

    Parameters
    ----------
    config : PrescriptionConfig
    body : Body
    places : tuple of Place
        Where springs may be.
    joint, one : OneJoint, Prescription
        Of one joint.
    postures, several : Postures, Springs
        Of several.
    workspace : Reach
        What the joint limits allow, of a trial.
    timed : Timed
    map : SpringMap
    graph : Graph
    graph_postures : (N, n) array
        Those that the graph is about, rad.
    """

    config: PrescriptionConfig
    body: Body
    places: tuple[Place, ...]
    joint: OneJoint | None = None
    one: Prescription | None = None
    postures: Postures | None = None
    several: Springs | None = None
    workspace: Reach | None = None
    timed: Timed | None = None
    map: SpringMap | None = None
    graph: Graph | None = None
    graph_postures: FloatArray | None = None

    @property
    def refused(self) -> str | None:
        """Why nothing could be prescribed; None where it could."""
        return self.body.why or None if self.body.weights is None else None


def prescribe_from(
    config: PrescriptionConfig,
    folder: Path | None = None,
    progress: runner.Progress = lambda step: None,
    tell: Tell = lambda line: None,
) -> Prescribed:
    """Everything that a configuration asks for.

    Parameters
    ----------
    config : PrescriptionConfig
    folder : Path, optional
        Where the map of springs is kept as it grows, so that it resumes.
    progress : callable, optional
        Told of every stage of a trial's YAML file.
    tell : callable, optional
        Told how far the map is.

    Raises
    ------
    ConfigError
        What is asked for is not possible: the message says which line, and why.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`, where a trial is named.
    """
    found = body(config, progress)
    workspace = measure(found.subject) if found.subject is not None else None
    result = Prescribed(config, found, (), workspace=workspace)
    if found.weights is None:
        return result
    try:
        result = replace(result, places=places(config, found))
        asked = _one(result, folder, tell) if len(found.joints) == 1 else _several(result)
        nodes, at = task_graph(asked.config.wishes.tasks, asked)
        return replace(asked, graph=nodes, graph_postures=at)
    except ValueError as error:
        raise ConfigError(f"{config.where()}: {error}") from error


def places(config: PrescriptionConfig, found: Body) -> tuple[Place, ...]:
    """Where springs may be; by default one on every joint, up to four times as stiff as gravity asks for a radian."""
    wishes = config.wishes
    springs = wishes.springs
    if springs is None:
        springs = tuple(SpringWish(joints=(j,)) for j in range(1, len(found.joints) + 1))
    assert found.weights is not None
    result = []
    middle = found.limits.lower + 0.5 * (found.limits.upper - found.limits.lower)
    grid = np.linspace(found.limits.lower, found.limits.upper, 65)
    largest = np.abs(found.weights.torques(np.concatenate([grid, middle[None]]))).max()
    for spring in springs:
        low, high = np.radians(spring.rest_deg).tolist()
        stiffest = 4.0 * float(largest) if spring.stiffest is None else spring.stiffest
        result.append(Place(tuple(joint - 1 for joint in spring.joints), stiffest, (low, high)))
    return tuple(result)


def _one(result: Prescribed, folder: Path | None, tell: Tell) -> Prescribed:
    wishes = result.config.wishes
    joint = result.body.one_joint()
    spring = wishes.springs[0] if wishes.springs else None
    if wishes.springs is not None and len(wishes.springs) > 1:
        raise ValueError(f"one joint takes one spring, and {len(wishes.springs)} are described under `springs:`")
    asked = Wishes(
        required=tuple(np.radians(wishes.required_deg).tolist()),
        rest=result.places[0].rest if result.places else REST,
        stiffest=0.0 if wishes.springs == () else None if spring is None else spring.stiffest,
        penalty=wishes.penalty,
    )
    found = prescribe(joint, asked)
    timed = None if wishes.level_set is None else _timed(joint, result.body, found, wishes.level_set)
    kept = None
    if wishes.search is not None:
        kept = search(joint, _inertia(result.body), wishes.search, folder, tell)
    return replace(result, joint=joint, one=found, timed=timed, map=kept)


def _timed(joint: OneJoint, found: Body, spring: Prescription, wish: LevelSet) -> Timed:
    inertia = _inertia(found)
    if wish.spring is not None:
        given = wish.spring
        dynamics = Dynamics(joint, inertia, given.stiffness, float(np.radians(given.rest_deg)), given.damping)
    else:
        dynamics = Dynamics(joint, inertia, spring.stiffness, 0.0 if spring.stiffness == 0 else spring.rest)
    scheme = Scheme(wish.angles, wish.velocities, wish.order == 2, wish.scheme == "lax-friedrichs")
    reached = reach(dynamics, wish.horizons_s, scheme)
    bounds = tuple(_hull(reached_and_held(dynamics, reached, k)) for k in range(len(wish.horizons_s)))
    return Timed(dynamics, reached, bounds, _hull(joint.held(dynamics.stiffness, dynamics.rest)))


def _hull(parts: list[tuple[float, float]]) -> tuple[float, float] | None:
    return (parts[0][0], parts[-1][1]) if parts else None


def _inertia(found: Body) -> float:
    if found.inertia is None or not np.isfinite(found.inertia) or found.inertia <= 0:
        raise ValueError("the inertia about the joint is not known: level sets need it (`arm: {inertia_kgm2: …}`)")
    return found.inertia


def _several(result: Prescribed) -> Prescribed:
    wishes, found = result.config.wishes, result.body
    assert found.weights is not None
    required = np.array(wishes.required_m, dtype=np.float64).reshape(-1, 2)
    sampled = postures(found.arm, found.weights, found.limits, result.places, required, wishes.postures, wishes.seed)
    springs = prescribe_several(sampled, result.places, found.strength, wishes.penalty, wishes.boxes)
    return replace(result, postures=sampled, several=springs)
