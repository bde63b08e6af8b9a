"""Springs, reachable sets, map of springs, sub-workspaces and devices for the configuration of a prescription."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config.device import DeviceConfig, load_device
from mocap_id.errors import ConfigError
from mocap_id.store.atomic import write_files
from mocap_id_assist.assisted_body import (
    AssistedBody,
    DeviceSpring,
    PrescriptionResult,
    SpringMap,
    Timed,
    build_task_graph,
    read_body,
)
from mocap_id_assist.device_control import control_chain, control_joint
from mocap_id_assist.devices import find_held_range, find_nearest_setting, find_widest_setting
from mocap_id_assist.files import LevelSet, PrescriptionConfig, SearchGrid, SpringWish
from mocap_id_assist.level_set import JointDynamics, Scheme, compute_reachable_states, find_reached_and_held
from mocap_id_assist.springs import (
    REST,
    OneJoint,
    Prescription,
    SpringPlace,
    find_held_postures,
    prescribe_several,
    prescribe_spring,
    sample_postures,
)
from mocap_id_assist.workspaces import measure_workspace

Report = Callable[[str], None]


def prescribe_from(
    config: PrescriptionConfig,
    folder: Path | None = None,
    progress: runner.Progress = lambda step: None,
    report: Report = lambda line: None,
) -> PrescriptionResult:
    """Return all results that a configuration requests.

    In ``folder``, the map of springs is saved row by row, so that an interrupted computation can resume. ``progress``
    is called with each step of the run, if the body comes from a trial's YAML file, and ``report`` with a line about
    the progress of the map.

    Raises
    ------
    ConfigError
        The prescription is not possible; the message contains the line and the reason.
    Refused, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`, for a trial.
    """
    body = read_body(config, progress)
    workspace = measure_workspace(body.subject) if body.subject is not None else None
    result = PrescriptionResult(config, body, (), workspace=workspace)
    if body.weights is None:
        return result
    try:
        result = replace(result, places=_find_places(config, body))
        is_joint = len(body.joints) == 1
        result = _prescribe_joint(result, folder, report) if is_joint else _prescribe_chain(result)
        return _add_devices(replace(result, graph=build_task_graph(result)))
    except ValueError as error:
        raise ConfigError(f"{config.where()}: {error}") from error


def _find_places(config: PrescriptionConfig, body: AssistedBody) -> tuple[SpringPlace, ...]:
    """Return the possible springs.

    By default, every joint can have a spring with up to four times the largest moment of gravity per radian.
    """
    springs = config.wishes.springs
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
    spring = prescribe_spring(
        joint,
        required=tuple(np.radians(wishes.required_deg).tolist()),
        rest=result.places[0].rest if result.places else REST,
        stiffest=0.0 if wishes.springs == () else wishes.springs[0].stiffest if wishes.springs else None,
        penalty=wishes.penalty,
    )
    timed = None if wishes.level_set is None else _compute_ranges(joint, result.body, spring, wishes.level_set)
    springs = None
    if wishes.search is not None:
        springs = map_springs(joint, _require_inertia(result.body), wishes.search, folder, report)
    return replace(result, joint=joint, one=spring, timed=timed, map=springs)


def _compute_ranges(joint: OneJoint, body: AssistedBody, spring: Prescription, wish: LevelSet) -> Timed:
    inertia = _require_inertia(body)
    if wish.spring is not None:
        given = wish.spring
        dynamics = JointDynamics(joint, inertia, given.stiffness, float(np.radians(given.rest_deg)), given.damping)
    else:
        dynamics = JointDynamics(joint, inertia, spring.stiffness, 0.0 if spring.stiffness == 0 else spring.rest)
    scheme = Scheme(wish.angles, wish.velocities, wish.order == 2, wish.scheme == "lax-friedrichs")
    coarse = replace(scheme, angles=wish.angles // 2 + 1, velocities=wish.velocities // 2 + 1)
    fine_and_coarse = [compute_reachable_states(dynamics, wish.horizons_s, each) for each in (scheme, coarse)]
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


def _add_devices(result: PrescriptionResult) -> PrescriptionResult:
    """Return the result with the pressures of the devices that replace springs, and with their controller.

    ConfigError is raised as for :func:`mocap_id.config.device.load_device`.
    """
    wishes = result.config.wishes
    devices = [None if spring.device is None else load_device(spring.device) for spring in wishes.springs or ()]
    if not any(devices):
        return result
    if result.several is not None:
        result = _fit_chain_devices(result, devices)
        controlled = None if wishes.controller is None else control_chain(result, devices, wishes.controller)
        return replace(result, controlled=controlled)
    joint, device = result.joint, devices[0]
    assert joint is not None and device is not None
    result = _fit_joint_device(result, device)
    if wishes.controller is None:
        return result
    controlled = control_joint(joint, _require_inertia(result.body), device, wishes.tasks, wishes.controller)
    return replace(result, controlled=controlled)


def _fit_joint_device(result: PrescriptionResult, device: DeviceConfig) -> PrescriptionResult:
    """Add the pressures with which the person holds the widest interval with all required angles of one joint.

    ValueError is raised if the stroke contains no angle of the prescribed range.
    """
    joint, prescribed = result.joint, result.one
    assert joint is not None and prescribed is not None
    if not prescribed.helps:
        return replace(result, devices=())
    required = np.radians(result.config.wishes.required_deg).tolist()
    cylinder, limits = device.keys.cylinder(), device.keys.limits()
    angles = np.linspace(*prescribed.range, 361)
    nearest = find_nearest_setting(cylinder, prescribed.stiffness, prescribed.rest, limits, angles)
    setting = find_widest_setting(joint, cylinder, limits, nearest.setting, required)
    spring = DeviceSpring(0, device, setting, nearest)
    held = find_held_range(joint, cylinder, setting, required)
    return replace(result, devices=(spring,), device_range=held)


def _fit_chain_devices(result: PrescriptionResult, devices: Sequence[DeviceConfig | None]) -> PrescriptionResult:
    """Add the pressures that best approximate the prescribed springs, and the workspace with these pressures.

    The torques are compared in the postures that the prescribed springs hold. ValueError is raised if the stroke of a
    device contains none of these postures.
    """
    postures, places, strength, prescribed = result.postures, result.places, result.body.strength, result.several
    assert postures is not None and prescribed is not None
    held = find_held_postures(postures, places, strength, prescribed)
    needed, linear = postures.gravity.copy(), prescribed.stiffness.copy()
    springs = []
    for s, device in enumerate(devices):
        if device is None or not prescribed.stiffness[s] > 0:
            continue
        cylinder = device.keys.cylinder()
        stretch = postures.stretch[:, s]
        nearest = find_nearest_setting(
            cylinder, float(prescribed.stiffness[s]), float(prescribed.rest[s]), device.keys.limits(), stretch[held]
        )
        springs.append(DeviceSpring(s, device, nearest.setting, nearest))
        torque = cylinder.torque(stretch, nearest.setting)
        # an infinite torque beyond the stroke, so that these postures are not held
        needed[:, list(places[s].joints)] -= np.where(np.isnan(torque), np.inf, torque)[:, None]
        linear[s] = 0.0
    for s, place in enumerate(places):
        if linear[s] > 0:
            needed[:, list(place.joints)] += (linear[s] * (postures.stretch[:, s] - prescribed.rest[s]))[:, None]
    kept: BoolArray = np.all((needed >= strength[:, 0]) & (needed <= strength[:, 1]), axis=1)
    cells = np.unique(postures.cell[kept & (postures.cell < postures.cells)])
    return replace(result, devices=tuple(springs), device_area=postures.size * len(cells))


ROWS_FILE = "search.json"
"""File in the output folder with the finished rows of the map."""


def map_springs(
    joint: OneJoint, inertia: float, grid: SearchGrid, folder: Path | None, report: Callable[[str], None]
) -> SpringMap:
    """Return the map of springs, computed row by row.

    If ``folder`` is given, each finished row is saved there, and saved rows of the same search are not computed again.
    ``report`` is called with a line after each row. ``inertia`` is in kg·m².

    Raises
    ------
    ValueError
        The grid is empty.
    StoreError
        The folder cannot be written.
    """
    stiffness = np.radians(1.0) ** -1 * 1e-3 * _grid_values(grid.stiffness_mNm_per_deg)
    rest = np.radians(_grid_values(grid.rest_deg))
    inputs = {"joint": asdict(joint), "inertia": inertia, "grid": grid.model_dump(mode="json"), "version": 1}
    key = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
    rows, scheme = _read_rows(folder, key), Scheme(grid.angles, grid.velocities)
    for index, k in enumerate(stiffness.tolist()):
        if index < len(rows):
            continue
        row: list[tuple[float | None, float]] = []
        for angle in rest.tolist():
            dynamics, width = JointDynamics(joint, inertia, k, angle), None
            if dynamics.equilibrium() is not None:
                reached = compute_reachable_states(dynamics, (grid.horizon_s,), scheme)
                width = float(sum(high - low for low, high in find_reached_and_held(dynamics, reached)))
            row.append((width, float(sum(high - low for low, high in joint.held_intervals(k, angle)))))
        rows.append(row)
        if folder is not None:
            write_files(folder, {ROWS_FILE: json.dumps({"key": key, "rows": rows}).encode()})
        report(f"springs: {index + 1} of {len(stiffness)} stiffnesses")
    both = np.array([[[np.nan if x is None else x for x in pair] for pair in row] for row in rows])
    return SpringMap(stiffness, rest, both[..., 0], both[..., 1], grid.horizon_s)


def _grid_values(given: tuple[float, float, float]) -> FloatArray:
    first, last, step = given
    if not step > 0 or last < first:
        raise ValueError(f"the search's grid {list(given)} is empty; expected first <= last, and a step above 0")
    return np.asarray(first, dtype=np.float64) + step * np.arange(int(np.floor((last - first) / step + 1e-9)) + 1)


def _read_rows(folder: Path | None, key: str) -> list[list[tuple[float | None, float]]]:
    if folder is None or not (folder / ROWS_FILE).is_file():
        return []
    try:
        data = json.loads((folder / ROWS_FILE).read_text("utf-8"))
        return [[(pair[0], pair[1]) for pair in row] for row in data["rows"]] if data["key"] == key else []
    except (ValueError, KeyError, TypeError, IndexError):
        return []  # unreadable: compute it again
