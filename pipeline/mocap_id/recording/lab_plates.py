"""Plates in the lab: pose from the corners, sense from the load, moment about the lab origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.c3d_plates import StoredPlate
from mocap_id.recording.model import Plate
from mocap_id.recording.plate_types import plate_axes, surface_wrench

LOADED_N = 20.0
"""Below this vertical force neither the sense nor the centre of pressure of a plate means anything."""

_ON_PLATE_M = 0.05
_MOSTLY = 0.8
_SPIKE = 5.0


def place(stored: StoredPlate, turn: FloatArray, start: float, rate: float) -> tuple[Plate, list[str]]:
    """Turn a stored plate into the wrench of the ground on the body.

    Parameters
    ----------
    stored : StoredPlate
        In the file's axes.
    turn : (3, 3) array
        From the file's axes to the lab's (Z up).
    start : float
        Time of the first analog sample, s.
    rate : float
        Analog samples a second.

    Returns
    -------
    plate : Plate
    oddities : list of str
    """
    oddities = [*stored.oddities, *(f"plate {stored.index}: {text}" for text in stored.assumptions)]
    problem = stored.problem
    if stored.signals is not None:
        corners = stored.signals.corners @ turn.T
        axes = plate_axes(corners)
        problem = _pose_problem(axes)
        if not problem:
            force, moment = surface_wrench(stored.signals)
            force, moment, reversed_ = _reaction(force, moment, axes, corners.mean(axis=0), stored.ok)
            if reversed_:
                oddities.append(f"plate {stored.index} holds the force of the body on the plate: reversed")
            plate = Plate(stored.index, f"type {stored.kind}", corners, force, moment, stored.ok, rate, start)
            assumptions = tuple(f"plate {stored.index}: {text}" for text in stored.assumptions)
            plate = replace(plate, assumptions=assumptions, saturated=stored.saturated)
            return plate, oddities + _off_plate(plate)
    nothing = np.full((len(stored.ok), 3), np.nan)
    none = np.zeros(len(stored.ok), bool)
    plate = Plate(stored.index, f"type {stored.kind}", None, nothing, nothing.copy(), none, rate, start, problem)
    return plate, [*oddities, f"plate {stored.index} is not used: {problem}"]


def _pose_problem(axes: FloatArray) -> str:
    if not np.isfinite(axes).all():
        return "CORNERS span no rectangle"
    if axes[2, 2] > -0.5:
        return (
            f"CORNERS turn its z axis {'up' if axes[2, 2] > 0.5 else 'sideways'}; "
            "they should run +x+y, -x+y, -x-y, +x-y with z down"
        )
    return ""


def _reaction(
    force: FloatArray, moment: FloatArray, axes: FloatArray, centre: FloatArray, ok: BoolArray
) -> tuple[FloatArray, FloatArray, bool]:
    """Wrench on the body in lab axes about the lab origin, and whether the channels held the opposite one."""
    force, moment = force @ axes.T, moment @ axes.T
    reversed_ = is_load(force[ok, 2])
    if reversed_:
        force, moment = -force, -moment
    return force, moment + np.cross(centre, force), reversed_


def is_load(vertical: FloatArray) -> bool:
    """Whether upward forces are those of the body on the plate, which mostly point down under load.

    Parameters
    ----------
    vertical : (K,) array
        Good samples, N. What counts is the mean of those over 20 N, each at most five times as large as their median:
        a few spikes do not outvote a person, nor does an offset of the unloaded plate outvote a short contact.
    """
    loaded = vertical[np.abs(vertical) > LOADED_N]
    if not loaded.size:
        return False
    most = _SPIKE * float(np.median(np.abs(loaded)))
    return bool(np.clip(loaded, -most, most).mean() < 0)


def centre_of_pressure(plate: Plate) -> FloatArray:
    """Where the force meets the plane of the working surface, (K, 2) lab m; NaN under a load of 20 N."""
    centre = np.zeros(3) if plate.centre is None else plate.centre
    about = plate.moment - np.cross(centre, plate.force)
    vertical = np.where(plate.force[:, 2] > LOADED_N, plate.force[:, 2], np.nan)
    return centre[:2] + np.column_stack([-about[:, 1], about[:, 0]]) / vertical[:, None]


def _off_plate(plate: Plate) -> list[str]:
    """A load that does not act on its plate gives a wrong unit, origin or corner away."""
    assert plate.corners is not None
    most = plate.force[plate.ok, 2].max(initial=0.0)
    good = plate.ok & (plate.force[:, 2] > max(LOADED_N, 0.1 * most))
    if not good.any():
        return []
    point = centre_of_pressure(plate)[good]
    x, y = plate.corners[0] - plate.corners[1], plate.corners[0] - plate.corners[3]
    away = point - plate.corners.mean(axis=0)[:2]
    inside = np.ones(len(point), bool)
    for side in (x, y):
        half = np.linalg.norm(side) / 2
        inside &= np.abs(away @ side[:2]) / (2 * half) < half + _ON_PLATE_M
    if inside.mean() >= _MOSTLY:
        return []
    return [
        f"plate {plate.index}: the centre of pressure lies off the plate in {100 * (1 - inside.mean()):.0f} % of its "
        "loaded samples; its corners, ORIGIN or moment units are doubtful"
    ]
