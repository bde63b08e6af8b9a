"""Comparison of the position of a force plate in the file with the markers of the person on it.

The checks need no model of the body: the ground only pushes, so its force acts under the feet; feet stand on the
surface; the force under a person who stands still is vertical. The direction of horizontal forces is checked in
:mod:`mocap_id.plates.direction`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs
from mocap_id.plates.direction import mean_over_markers
from mocap_id.plates.feet import distance_outside, find_standing_feet, largest_distance, least_width
from mocap_id.recording.lab_plates import centre_of_pressure
from mocap_id.recording.marker_posture import shows_standing, upright
from mocap_id.recording.model import Plate
from mocap_id.recording.plate_types import plate_axes
from mocap_id.recording.resampling import PlateSamples

_MIN_FORCE_N, _MIN_SHARE = 50.0, 0.25
"""Minimum force of a sample, in N and as a share of the peak; below, the centre of pressure is too noisy."""

_PERCENTILE = 90.0
"""Percentile of the distances of the centre of pressure from the outline that is compared."""

_FOOT_M = 0.20
"""Length from the heel markers to the toe markers; a shorter outline lacks one end of the foot."""

_BOTH_ENDS_M = 0.13
"""Least length of each foot's markers, and least width of those of all feet. From the ankle to the toes it is at least
0.135 m; markers of the toes alone, or of one foot alone, are at most 0.12 m long or wide."""

_FOOT_WIDTH_M = 0.05
"""Least width of markers of one foot alone; a narrower outline may run along one edge of the foot."""

_TWO_FEET_M = 0.25
"""Least length of markers of two feet that stand so close that their markers form one group."""

_WHOLE_WEIGHT = 0.75
"""If the plates carry this share of the standing weight while the body is low, a chair may stand on them."""

_STEP_S = 0.1
"""Speeds are differences over this time to either side."""

_SWAY_M_S = 0.03
"""Largest speed of a body that stands still."""

_PAUSE_S = 0.5
"""Shortest pause; within shorter ones the mean acceleration may not vanish."""

_MIN_TOTAL_S = 1.0


@dataclass(frozen=True)
class PlatePlacement:
    """Position of one plate relative to the feet on it.

    Parameters
    ----------
    index : int
        The plate's number, from 1.
    off_feet : float or None
        90th percentile of the distance of the centre of pressure from the outline of the feet, m; negative inside. None
        if it is unknown.
    unknown : str or None
        Why it is unknown.
    allowance : float
        Length by which the outline of the markers may be shorter than the foot, m.
    over_surface : float or None
        Height of the lowest foot marker above the surface of the plate, m.
    normal : (3,) array or None
        Upward normal of the surface from the corners, lab.
    load : float
        Mean vertical force over the loaded samples, N.
    """

    index: int
    off_feet: float | None
    unknown: str | None
    allowance: float
    over_surface: float | None
    normal: FloatArray | None
    load: float

    @property
    def inclined(self) -> float | None:
        """Inclination of the surface from horizontal, rad."""
        return None if self.normal is None else float(np.arccos(min(1.0, self.normal[2])))


def compare_with_feet(
    plates: Sequence[Plate], samples: Sequence[PlateSamples], positions: FloatArray
) -> list[PlatePlacement]:
    """Compare every plate under the feet with the markers of the feet.

    If there are as many feet as plates, each plate is compared with a different foot, otherwise with all feet together.

    Parameters
    ----------
    plates, samples : sequences
        Plates under the feet, and their wrench at the marker times.
    positions : (F, M, 3) array
        Markers, lab axes, m.
    """
    surfaces = [plate.centre[2] for plate in plates if plate.centre is not None]
    loaded = _on_feet_alone(positions, samples)
    surface = float(np.mean(surfaces)) if surfaces else None
    feet = (
        find_standing_feet(positions, np.logical_or.reduce(loaded), surface, len(plates))
        if any(map(np.any, loaded))
        else []
    )
    feet = [foot for foot in feet if largest_distance(foot[:, :2]) > _FOOT_M / 2]
    unknown = _why_no_outline(feet)
    shared = len(feet) != len(plates)
    outlines = [] if unknown else [np.concatenate(feet)] * len(plates) if shared else feet
    distances = np.array(
        [[_off(*each, outline) for outline in outlines] for each in zip(plates, samples, loaded, strict=True)]
    )
    own: IntArray = linear_sum_assignment(np.nan_to_num(distances, nan=0.0))[1] if outlines else np.zeros(0, np.int64)
    return [
        _placement(
            plate,
            each,
            where,
            off=distances[k, own[k]] if outlines else np.nan,
            allowance=0.0 if unknown else _allowance(feet) if shared else _allowance([feet[own[k]]], _FOOT_WIDTH_M),
            lowest=min((foot[:, 2].min() for foot in feet), default=None),
            unknown=unknown,
        )
        for k, (plate, each, where) in enumerate(zip(plates, samples, loaded, strict=True))
    ]


def _on_feet_alone(positions: FloatArray, samples: Sequence[PlateSamples]) -> list[BoolArray]:
    """Return the samples (F,) in which the feet load each plate: all loaded ones, or only those of a standing person.

    If the plates carry the whole weight while the body is low, a chair may stand on them; its force acts behind the
    feet.
    """
    loaded = [_loaded(each) for each in samples]
    tall, low = upright(positions)
    total = np.sum([np.where(each.ok, each.force[:, 2], 0.0) for each in samples], axis=0) if samples else np.zeros(0)
    if low.any() and tall.any() and np.percentile(total[low], 10) > _WHOLE_WEIGHT * np.median(total[tall]):
        return [each & tall for each in loaded]
    return loaded


def _why_no_outline(feet: Sequence[FloatArray]) -> str | None:
    """Return why markers of feet (K, 3) do not show where the soles are; None if they do."""
    if not feet:
        return "no foot with two markers stands still"
    if min(largest_distance(foot[:, :2]) for foot in feet) < (_BOTH_ENDS_M if len(feet) > 1 else _TWO_FEET_M):
        return "the markers show one foot alone, or not both ends of each foot"
    if least_width(np.concatenate(feet)[:, :2]) < _BOTH_ENDS_M:
        return "the markers show one foot alone, or one end of the feet"
    return None


def standing_lean(force: FloatArray, positions: FloatArray, rate: float) -> FloatArray | None:
    """Return the lean of the total ground force from the vertical while the person stands still.

    Parameters
    ----------
    force : (F, 3) array
        Total force of the plates under the feet, lab axes, N.
    positions : (F, M, 3) array
        Markers, m.
    rate : float
        Frames per second.

    Returns
    -------
    (2,) array or None
        Lean along the lab's X and Y, rad; None if nobody stands still for at least a second in total.
    """
    half = max(1, round(_STEP_S * rate))
    if len(positions) <= 2 * half:
        return None
    speed = np.full(len(positions), np.inf)
    moved = mean_over_markers(positions[2 * half :] - positions[: -2 * half]) * rate / (2 * half)
    speed[half:-half] = np.linalg.norm(moved, axis=1)
    slow = np.nan_to_num(speed, nan=np.inf) < _SWAY_M_S
    still = _long_runs(upright(positions)[0] & np.isfinite(force).all(axis=1) & slow, round(_PAUSE_S * rate))
    if still.sum() < _MIN_TOTAL_S * rate or not shows_standing(positions, still):
        return None
    mean = force[still].mean(axis=0)
    return np.asarray(np.arctan2(mean[:2], mean[2])) if mean[2] > _MIN_FORCE_N else None


def _long_runs(flags: BoolArray, least: int) -> BoolArray:
    """Keep the runs of at least ``least`` samples."""
    kept = np.zeros(len(flags), bool)
    for run in find_runs(flags):
        kept[run] = run.stop - run.start >= least
    return kept


def _loaded(samples: PlateSamples) -> BoolArray:
    vertical = np.where(samples.ok, samples.force[:, 2], 0.0)
    return np.asarray(vertical > max(_MIN_FORCE_N, _MIN_SHARE * float(np.percentile(vertical, 95))))


def _off(plate: Plate, samples: PlateSamples, loaded: BoolArray, outline: FloatArray) -> float:
    """Return how far the centres of pressure are outside an outline (K, 3), m; NaN for an unloaded plate."""
    if not loaded.any():
        return float("nan")
    return float(
        np.percentile(distance_outside(centre_of_pressure(plate, samples)[loaded], outline[:, :2]), _PERCENTILE)
    )


def _allowance(feet: Sequence[FloatArray], width: float = 0.0) -> float:
    """Return the length by which markers of feet (K, 3) may be shorter or narrower than the soles, m."""
    length = max(largest_distance(foot[:, :2]) for foot in feet)
    return max(0.0, _FOOT_M - length, width - least_width(np.concatenate(feet)[:, :2]))


def _placement(
    plate: Plate,
    samples: PlateSamples,
    loaded: BoolArray,
    *,
    off: float,
    allowance: float,
    lowest: float | None,
    unknown: str | None,
) -> PlatePlacement:
    known = bool(np.isfinite(off))
    over = None
    if lowest is not None and plate.centre is not None and loaded.any():
        over = float(lowest - plate.centre[2])
    return PlatePlacement(
        index=plate.index,
        off_feet=off if known else None,
        unknown=None if known else unknown or "the plate is hardly loaded",
        allowance=allowance if known else 0.0,
        over_surface=over,
        normal=None if plate.corners is None else -plate_axes(plate.corners)[:, 2],  # the z axis of a plate points down
        load=float(samples.force[loaded, 2].mean()) if loaded.any() else 0.0,
    )
