"""Force plates in lab coordinates.

Sign convention: the wrench is that of the ground on the body, about the lab origin. The vertical force under a standing
person is positive. A file with the opposite sign (force of the body on the plate) is recognised and reversed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.c3d_plates import StoredPlate
from mocap_id.recording.model import Plate
from mocap_id.recording.plate_types import compute_plate_axes, compute_surface_wrench
from mocap_id.recording.resampling import PlateSamples

LOADED_N = 20.0
"""Below this vertical force, neither the sign nor the centre of pressure of a plate is meaningful."""

_ON_PLATE_M = 0.05
_SHARE_ON_PLATE = 0.8
_SPIKE = 5.0


def place_plate(stored: StoredPlate, rotation: FloatArray, start: float, rate: float, oddities: list[str]) -> Plate:
    """Return a stored plate as a plate in the lab with the wrench of the ground on the body; add notes to ``oddities``.

    ``rotation`` (3, 3) rotates vectors from the file's axes to the axes of the lab (Z up). ``start`` is the time of the
    first analog sample, s; ``rate`` is in samples per second.
    """
    assumptions = tuple(f"plate {stored.index}: {text}" for text in stored.assumptions)
    oddities += [*stored.oddities, *assumptions]
    kind, signals, problem = f"type {stored.kind}", stored.signals, stored.problem
    if signals is not None:
        corners = signals.corners @ rotation.T
        axes = compute_plate_axes(corners)
        problem = _find_pose_problem(axes)
    if signals is None or problem:
        oddities.append(f"plate {stored.index} is not used: {problem}")
        missing = np.full((len(stored.ok), 3), np.nan)
        ok = np.zeros(len(stored.ok), bool)
        return Plate(stored.index, kind, None, missing, missing.copy(), ok, rate, start, problem)
    force, moment = (part @ axes.T for part in compute_surface_wrench(signals))
    force, moment = reverse_force_on_plate(stored.index, force, moment, stored.ok, oddities)
    moment = moment + np.cross(corners.mean(axis=0), force)
    plate = Plate(stored.index, kind, corners, force, moment, stored.ok, rate, start)
    oddities += _note_load_off_plate(plate)
    dead = tuple((name, axes[:, axis]) for name, axis in stored.dead)
    return replace(plate, assumptions=assumptions, saturated=stored.saturated, dead=dead)


def _find_pose_problem(axes: FloatArray) -> str:
    if not np.isfinite(axes).all():
        return "CORNERS do not form a rectangle"
    if axes[2, 2] > -0.5:
        return (
            f"CORNERS make its z axis point {'up' if axes[2, 2] > 0.5 else 'sideways'}; "
            "the expected order is +x+y, -x+y, -x-y, +x-y with z down"
        )
    return ""


def rotate_plate(plate: Plate, rotation: FloatArray) -> Plate:
    """Return a plate in other axes; ``rotation`` (3, 3) converts vectors from the old to the new axes."""
    corners = None if plate.corners is None else plate.corners @ rotation.T
    dead = tuple((name, rotation @ direction) for name, direction in plate.dead)
    force, moment = plate.force @ rotation.T, plate.moment @ rotation.T
    return replace(plate, corners=corners, force=force, moment=moment, dead=dead)


def reverse_force_on_plate(
    index: int, force: FloatArray, moment: FloatArray, ok: BoolArray, oddities: list[str]
) -> tuple[FloatArray, FloatArray]:
    """Return force and moment (K, 3) of the ground on the body; those of the body on the plate are reversed.

    The vertical force of the valid samples, ``ok`` (K,), decides. If the signs are reversed, a note is added to
    ``oddities``.
    """
    if not is_force_on_plate(force[ok, 2]):
        return force, moment
    oddities.append(f"plate {index} measures the force of the body on the plate: the signs were reversed")
    return -force, -moment


def is_force_on_plate(vertical: FloatArray) -> bool:
    """Return whether a force is that of the body on the plate, which points mostly down under load.

    ``vertical`` (K,) is the upward force of valid samples, N. The sign of the mean of all samples above 20 N in
    magnitude decides; each sample is limited to five times their median magnitude. A few spikes therefore do not
    outweigh a person, and an offset of the unloaded plate does not outweigh a short contact.
    """
    loaded = vertical[np.abs(vertical) > LOADED_N]
    if not loaded.size:
        return False
    most = _SPIKE * float(np.median(np.abs(loaded)))
    return bool(np.clip(loaded, -most, most).mean() < 0)


def compute_centre_of_pressure(plate: Plate, wrench: Plate | PlateSamples) -> FloatArray:
    """Return the centre of pressure (K, 2) of ``wrench`` on the surface of ``plate``, in lab axes, m.

    It is NaN if the vertical force is at most 20 N.
    """
    centre = np.zeros(3) if plate.centre is None else plate.centre
    about = wrench.moment - np.cross(centre, wrench.force)
    vertical = np.where(wrench.force[:, 2] > LOADED_N, wrench.force[:, 2], np.nan)
    return centre[:2] + np.column_stack([-about[:, 1], about[:, 0]]) / vertical[:, None]


def _note_load_off_plate(plate: Plate) -> list[str]:
    """Return a note if the load acts beside the plate, which means that a unit, the origin or a corner is wrong."""
    assert plate.corners is not None
    most = plate.force[plate.ok, 2].max(initial=0.0)
    good = plate.ok & (plate.force[:, 2] > max(LOADED_N, 0.1 * most))
    if not good.any():
        return []
    point = compute_centre_of_pressure(plate, plate)[good]
    x, y = plate.corners[0] - plate.corners[1], plate.corners[0] - plate.corners[3]
    away = point - plate.corners.mean(axis=0)[:2]
    inside = np.ones(len(point), bool)
    for side in (x, y):
        half = np.linalg.norm(side) / 2
        inside &= np.abs(away @ side[:2]) / (2 * half) < half + _ON_PLATE_M
    if inside.mean() >= _SHARE_ON_PLATE:
        return []
    return [
        f"plate {plate.index}: the centre of pressure lies off the plate in {100 * (1 - inside.mean()):.0f} % of its "
        "loaded samples: check its corners, ORIGIN and moment units"
    ]
