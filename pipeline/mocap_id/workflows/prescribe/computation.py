"""Computation of a prescription from its configuration: springs, reachable sets, map of springs, sub-workspaces."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.config.prescription import LevelSet, PrescriptionConfig, SpringWish
from mocap_id.errors import ConfigError
from mocap_id.prescription.level_set import (
    JointDynamics,
    Scheme,
    compute_reachable_set,
    find_reached_and_held,
)
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.one_spring import REST, Prescription, SpringRequirements, prescribe_spring
from mocap_id.prescription.postures import SpringPlace, sample_postures
from mocap_id.prescription.several_springs import prescribe_several
from mocap_id.workflows.prescribe.assisted_body import AssistedBody, read_body
from mocap_id.workflows.prescribe.controlled_chain import control_chain
from mocap_id.workflows.prescribe.controlled_tasks import control_tasks
from mocap_id.workflows.prescribe.device_springs import fit_chain_devices, fit_joint_device, read_devices
from mocap_id.workflows.prescribe.result import PrescriptionResult, Timed
from mocap_id.workflows.prescribe.spring_map import map_springs
from mocap_id.workflows.prescribe.task_graph import build_task_graph
from mocap_id.workflows.workspace import measure

Report = Callable[[str], None]


def prescribe_from(
    config: PrescriptionConfig,
    folder: Path | None = None,
    progress: runner.Progress = lambda step: None,
    report: Report = lambda line: None,
) -> PrescriptionResult:
    """Return all results that a configuration requests.

    Parameters
    ----------
    config : PrescriptionConfig
    folder : Path, optional
        Folder in which the map of springs is saved row by row, so that an interrupted computation can resume.
    progress : callable, optional
        Called with each step of the run, if the body comes from a trial's YAML file.
    report : callable, optional
        Called with a line about the progress of the map.

    Raises
    ------
    ConfigError
        The prescription is not possible; the message contains the line and the reason.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`, for a trial.
    """
    body = read_body(config, progress)
    workspace = measure(body.subject) if body.subject is not None else None
    result = PrescriptionResult(config, body, (), workspace=workspace)
    if body.weights is None:
        return result
    try:
        result = replace(result, places=spring_places(config, body))
        is_joint = len(body.joints) == 1
        result = _prescribe_joint(result, folder, report) if is_joint else _prescribe_chain(result)
        graph, postures = build_task_graph(config.wishes.tasks, result)
        return _add_devices(replace(result, graph=graph, graph_postures=postures))
    except ValueError as error:
        raise ConfigError(f"{config.where()}: {error}") from error


def spring_places(config: PrescriptionConfig, body: AssistedBody) -> tuple[SpringPlace, ...]:
    """Return the possible springs.

    By default, every joint can have a spring with up to four times the largest moment of gravity per radian.
    """
    wishes = config.wishes
    springs = wishes.springs
    if springs is None:
        springs = tuple(SpringWish(joints=(j,)) for j in range(1, len(body.joints) + 1))
    assert body.weights is not None
    places = []
    middle = body.limits.lower + 0.5 * (body.limits.upper - body.limits.lower)
    grid = np.linspace(body.limits.lower, body.limits.upper, 65)
    largest = np.abs(body.weights.torques(np.concatenate([grid, middle[None]]))).max()
    for spring in springs:
        low, high = np.radians(spring.rest_deg).tolist()
        stiffest = 4.0 * float(largest) if spring.stiffest is None else spring.stiffest
        places.append(SpringPlace(tuple(joint - 1 for joint in spring.joints), stiffest, (low, high)))
    return tuple(places)


def _prescribe_joint(result: PrescriptionResult, folder: Path | None, report: Report) -> PrescriptionResult:
    wishes = result.config.wishes
    joint = result.body.one_joint()
    if wishes.springs is not None and len(wishes.springs) > 1:
        raise ValueError(f"one joint takes one spring, but `springs:` has {len(wishes.springs)}")
    requirements = SpringRequirements(
        required=tuple(np.radians(wishes.required_deg).tolist()),
        rest=result.places[0].rest if result.places else REST,
        stiffest=0.0 if wishes.springs == () else wishes.springs[0].stiffest if wishes.springs else None,
        penalty=wishes.penalty,
    )
    spring = prescribe_spring(joint, requirements)
    timed = None if wishes.level_set is None else _compute_ranges(joint, result.body, spring, wishes.level_set)
    springs = None
    if wishes.search is not None:
        springs = map_springs(joint, _require_inertia(result.body), wishes.search, folder, report)
    return replace(result, joint=joint, one=spring, timed=timed, map=springs)


def _add_devices(result: PrescriptionResult) -> PrescriptionResult:
    wishes, devices = result.config.wishes, read_devices(result.config)
    if not any(devices):
        return result
    if result.postures is not None and result.several is not None:
        strength = result.body.strength
        held = fit_chain_devices(result.postures, result.places, strength, result.several, devices)
        controlled = None if wishes.controller is None else control_chain(result, devices, wishes.controller)
        return replace(result, devices=held, controlled=controlled)
    joint, one, device = result.joint, result.one, devices[0]
    assert joint is not None and one is not None and device is not None
    required = np.radians(wishes.required_deg).tolist()
    result = replace(result, devices=fit_joint_device(joint, one, device, required))
    if wishes.controller is None:
        return result
    tasks = control_tasks(joint, _require_inertia(result.body), device, wishes.tasks, wishes.controller)
    return replace(result, controlled=tasks)


def _compute_ranges(joint: OneJoint, body: AssistedBody, spring: Prescription, wish: LevelSet) -> Timed:
    inertia = _require_inertia(body)
    if wish.spring is not None:
        given = wish.spring
        dynamics = JointDynamics(joint, inertia, given.stiffness, float(np.radians(given.rest_deg)), given.damping)
    else:
        dynamics = JointDynamics(joint, inertia, spring.stiffness, 0.0 if spring.stiffness == 0 else spring.rest)
    scheme = Scheme(wish.angles, wish.velocities, wish.order == 2, wish.scheme == "lax-friedrichs")
    coarse = replace(scheme, angles=wish.angles // 2 + 1, velocities=wish.velocities // 2 + 1)
    fine_and_coarse = [compute_reachable_set(dynamics, wish.horizons_s, each) for each in (scheme, coarse)]
    bounds, rough = (
        tuple(_hull(find_reached_and_held(dynamics, each, k)) for k in range(len(wish.horizons_s)))
        for each in fine_and_coarse
    )
    errors = tuple(
        None if a is None else float(np.abs(np.subtract(a, b or (np.nan, np.nan))).max())
        for a, b in zip(bounds, rough, strict=True)
    )
    held = joint.held_intervals(dynamics.stiffness, dynamics.rest)
    unheld = tuple((before[1], after[0]) for before, after in itertools.pairwise(held))
    return Timed(dynamics, fine_and_coarse[0], bounds, errors, _hull(held), unheld)


def _hull(parts: list[tuple[float, float]]) -> tuple[float, float] | None:
    return (parts[0][0], parts[-1][1]) if parts else None


def _require_inertia(body: AssistedBody) -> float:
    """Return the inertia about the joint; raise ValueError if it is unknown."""
    if body.inertia is None or not np.isfinite(body.inertia) or body.inertia <= 0:
        raise ValueError(
            "the inertia about the joint is unknown: level sets and controllers need the body as "
            "`arm: {mass_kg: …, lever_m: …, inertia_kgm2: …}`"
        )
    return body.inertia


def _prescribe_chain(result: PrescriptionResult) -> PrescriptionResult:
    wishes, body = result.config.wishes, result.body
    assert body.weights is not None
    required = np.array(wishes.required_m, dtype=np.float64).reshape(-1, 2)
    sampled = sample_postures(
        body.arm, body.weights, body.limits, result.places, required, wishes.postures, wishes.seed
    )
    springs = prescribe_several(sampled, result.places, body.strength, wishes.penalty, wishes.boxes)
    return replace(result, postures=sampled, several=springs)
