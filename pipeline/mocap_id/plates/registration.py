"""Where a force plate is said to be, against what the cameras see of the person on it.

Laws that hold for any body, with no model of it: the ground only pushes, so its force acts under the feet; feet stand
on the surface; who stands still is carried by a vertical force. That the force also goes the way in which the body is
accelerated is :mod:`mocap_id.plates.direction`'s business.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.plates.direction import mean_over_markers
from mocap_id.plates.feet import length, outside, standing_feet
from mocap_id.recording.decimation import PlateSamples
from mocap_id.recording.model import Plate
from mocap_id.recording.plate_types import plate_axes
from mocap_id.recording.posture import shows_standing, upright

_LEAST_N, _LOADED = 50.0, 0.25
"""A sample counts above this force and this share of what a plate carries: below, its centre of pressure is noise."""

_FAR = 90.0
"""Percentile of the distances of the centre of pressure from the outline that speaks for all of them."""

_FOOT_M = 0.20
"""From the markers at the heel to those at the toes; an outline that is shorter lacks one end of the foot."""

_STEP_S = 0.1
"""Speeds are differences over this time to either side."""

_SWAY_M_S = 0.03
"""Horizontal and vertical speed that a body keeps to when it stands still."""

_PAUSE_S = 0.5
"""Between two stops the mean acceleration vanishes; within shorter pauses it may not."""

_ENOUGH_S = 1.0


@dataclass(frozen=True)
class Registration:
    """What one plate's wrench and pose say of where it is.

    Parameters
    ----------
    index : int
        The plate's number, from 1.
    off_feet : float or None
        How far outside the feet's outline nine tenths of the centres of pressure keep within, m; negative inside. None
        where no feet are seen to stand still.
    allowance : float
        What the outline of the markers may lack of the foot's length, m.
    over_surface : float or None
        Height of the lowest marker of the feet above the plate's surface, m.
    normal : (3,) array or None
        Of the surface by the corners, upwards, lab.
    load : float
        Mean vertical force over the loaded samples, N.
    """

    index: int
    off_feet: float | None
    allowance: float
    over_surface: float | None
    normal: FloatArray | None
    load: float

    @property
    def inclined(self) -> float | None:
        """Angle of the surface from the level, rad."""
        return None if self.normal is None else float(np.arccos(min(1.0, self.normal[2])))


def register(plates: Sequence[Plate], samples: Sequence[PlateSamples], positions: FloatArray) -> list[Registration]:
    """Hold every plate of the feet against the feet's markers.

    With as many feet as plates, each plate has to act under one of its own; otherwise under all of them together.

    Parameters
    ----------
    plates, samples : sequences
        Those under the feet, and their wrench at the marker times.
    positions : (F, M, 3) array
        Markers in the lab, m.
    """
    surfaces = [plate.centre[2] for plate in plates if plate.centre is not None]
    loaded = [_loaded(each) for each in samples]
    surface = float(np.mean(surfaces)) if surfaces else None
    feet = (
        standing_feet(positions, np.logical_or.reduce(loaded), surface, len(plates)) if any(map(np.any, loaded)) else []
    )
    feet = [foot for foot in feet if length(foot[:, :2]) > _FOOT_M / 2]
    outlines = feet if len(feet) == len(plates) else [np.concatenate(feet)] * len(plates) if feet else []
    away = np.array(
        [[_off(*each, outline) for outline in outlines] for each in zip(plates, samples, loaded, strict=True)]
    )
    own: IntArray = linear_sum_assignment(np.nan_to_num(away, nan=0.0))[1] if outlines else np.zeros(0, np.int64)
    return [
        _registration(plate, each, where, away[k, own[k]] if outlines else np.nan, feet)
        for k, (plate, each, where) in enumerate(zip(plates, samples, loaded, strict=True))
    ]


def standing_lean(force: FloatArray, positions: FloatArray, rate: float) -> FloatArray | None:
    """Lean of the ground's whole force from the vertical while the person stands still, (2,) rad along the lab's X, Y.

    Parameters
    ----------
    force : (F, 3) array
        Sum over the feet's plates, N, lab axes.
    positions : (F, M, 3) array
        m.
    rate : float
        Hz.

    Returns
    -------
    (2,) array or None
        None where nobody is shown to stand still for a second in all.
    """
    half = max(1, round(_STEP_S * rate))
    if len(positions) <= 2 * half:
        return None
    speed = np.full(len(positions), np.inf)
    moved = mean_over_markers(positions[2 * half :] - positions[: -2 * half]) * rate / (2 * half)
    speed[half:-half] = np.linalg.norm(moved, axis=1)
    slow = np.nan_to_num(speed, nan=np.inf) < _SWAY_M_S
    still = _lasting(upright(positions)[0] & np.isfinite(force).all(axis=1) & slow, round(_PAUSE_S * rate))
    if still.sum() < _ENOUGH_S * rate or not shows_standing(positions, still):
        return None
    mean = force[still].mean(axis=0)
    return np.asarray(np.arctan2(mean[:2], mean[2])) if mean[2] > _LEAST_N else None


def _lasting(flags: BoolArray, least: int) -> BoolArray:
    """Stretches of True that last for at least so many samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    kept = np.zeros(len(flags), bool)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        kept[start:stop] = stop - start >= least
    return kept


def _loaded(samples: PlateSamples) -> BoolArray:
    vertical = np.where(samples.ok, samples.force[:, 2], 0.0)
    return np.asarray(vertical > max(_LEAST_N, _LOADED * float(np.percentile(vertical, 95))))


def _off(plate: Plate, samples: PlateSamples, loaded: BoolArray, outline: FloatArray) -> float:
    """How far outside an outline (K, 3) most of the centres of pressure keep within, m; NaN for an unloaded plate."""
    if not loaded.any():
        return float("nan")
    return float(np.percentile(outside(_pressure(plate, samples)[loaded], outline[:, :2]), _FAR))


def _registration(
    plate: Plate, samples: PlateSamples, loaded: BoolArray, off: float, feet: Sequence[FloatArray]
) -> Registration:
    known, over = bool(np.isfinite(off)), None
    if known and plate.centre is not None:
        over = float(min(foot[:, 2].min() for foot in feet) - plate.centre[2])
    return Registration(
        index=plate.index,
        off_feet=off if known else None,
        allowance=max(0.0, _FOOT_M - max(length(foot[:, :2]) for foot in feet)) if known else 0.0,
        over_surface=over,
        normal=None if plate.corners is None else -plate_axes(plate.corners)[:, 2],  # the plate's z points down
        load=float(samples.force[loaded, 2].mean()) if loaded.any() else 0.0,
    )


def _pressure(plate: Plate, samples: PlateSamples) -> FloatArray:
    """Centre of pressure (F, 2) at the height of the plate's surface, lab, m."""
    centre = np.zeros(3) if plate.centre is None else plate.centre
    about = samples.moment - np.cross(centre, samples.force)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(centre[:2] + np.column_stack([-about[:, 1], about[:, 0]]) / samples.force[:, 2:])
