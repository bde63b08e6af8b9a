"""Standing feet, and comparison of the position of a force plate in the file with the markers of the person on it.

The checks need no model of the body. The ground only pushes, so its force acts under the feet, and between them if the
plates carry both. Feet stand on the surface of the plate. The force under a person who stands still is vertical. The
direction of horizontal forces is checked in :mod:`mocap_id.plates.choice`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs
from mocap_id.plates.choice import average_markers
from mocap_id.recording.lab_plates import PlateSamples, compute_centre_of_pressure, compute_plate_axes
from mocap_id.recording.model import Plate
from mocap_id.recording.sample_checks import find_upright, shows_standing

# largest rms distance of a marker on a standing foot from its mean position; for heels and toes it is 3 to 9 mm
_STILL_M = 0.015
# Markers within this height of the plate's surface are on the plate. Markers on a foot are at least 10 mm higher.
_ON_SURFACE_M = 0.008
_LOW_M = 0.15  # markers on toes, heels and ankles are at most this much higher than the lowest marker
# a marker of the leg is above the foot: it is at most the first length higher, and horizontally within the second
_LEG_M, _BESIDE_M = 0.6, 0.25
# largest distances between neighbouring markers of a foot, tried in turn: small ones separate feet close together
_NEIGHBOUR_M = (0.2, 0.175, 0.15, 0.125)
_MIN_MARKERS = 2  # minimum number of markers of a foot: one marker gives neither its length nor its direction
_FRAMES = 20_000  # largest number of frames over which positions are averaged; more frames would only need more memory
_DIRECTIONS = np.stack([np.cos(np.radians(np.arange(0, 360, 2))), np.sin(np.radians(np.arange(0, 360, 2)))])


def find_standing_feet(
    positions: FloatArray, samples: BoolArray, surface: float | None, count: int
) -> list[FloatArray]:
    """Return the mean marker positions (K, 3), m, of each foot that stands still under a leg.

    ``samples`` (F,) marks the frames to average over. ``surface`` is the height of the plates' surface, m, to exclude
    the markers on it; None if it is not known. Markers are separated into smaller groups until at least ``count`` feet
    are found; the result can contain fewer or more.
    """
    chosen = np.flatnonzero(samples)
    considered = positions[chosen[:: -(-len(chosen) // _FRAMES) or 1]]
    often = np.isfinite(considered).all(axis=2).sum(axis=0) > len(considered) / 2
    if not often.any():
        return []
    middle, scatter = np.full((len(often), 3), np.nan), np.full(len(often), np.inf)
    middle[often] = np.nanmean(considered[:, often], axis=0)
    scatter[often] = np.sqrt(np.nansum(np.nanvar(considered[:, often], axis=0), axis=1))
    still = scatter < _STILL_M
    if surface is not None:
        still &= np.abs(middle[:, 2] - surface) > _ON_SURFACE_M
    if not still.any():
        return []
    lowest = float(middle[still, 2].min())
    height = np.where(often, middle[:, 2] - lowest, np.inf)
    legs, low = middle[(height >= _LOW_M) & (height < _LEG_M)], middle[still & (height < _LOW_M)]
    groups: list[FloatArray] = []
    apart = np.linalg.norm(low[:, None, :2] - low[None, :, :2], axis=-1)
    for reach in _NEIGHBOUR_M:
        near = apart <= reach
        for _ in range(len(low)):  # neighbours of neighbours belong to the group
            near = near @ near
        groups = [low[row] for row in np.unique(near, axis=0)]
        groups = [group for group in groups if len(group) >= _MIN_MARKERS and len(legs)]
        under_leg = (np.linalg.norm(legs[:, None, :2] - group[None, :, :2], axis=-1).min() for group in groups)
        groups = [group for group, away in zip(groups, under_leg, strict=True) if away < _BESIDE_M]
        if len(groups) >= count:
            break
    return groups


def measure_outside(points: FloatArray, outline: FloatArray) -> FloatArray:
    """Return the distance (P,) of points (P, 2) from the convex hull of an outline (K, 2), m; negative inside.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    >>> measure_outside(np.array([[0.5, 0.5], [1.2, 0.5]]), square).round(3)
    array([-0.5,  0.2])
    """
    support = (outline @ _DIRECTIONS).max(axis=0)
    return np.asarray((points @ _DIRECTIONS - support).max(axis=1))


def measure_width(outline: FloatArray) -> float:
    """Return the least distance between two parallel lines that enclose an outline (K, 2), m.

    Examples
    --------
    >>> round(measure_width(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]])), 3)
    1.0
    """
    return float(np.ptp(outline @ _DIRECTIONS, axis=0).min())


def measure_length(outline: FloatArray) -> float:
    """Return the largest distance between any two points of an outline (K, 2), m."""
    return float(np.max(np.linalg.norm(outline[:, None] - outline[None], axis=-1)))


# Minimum force of a sample, in N and as a fraction of the peak force. If the force is smaller, the centre of pressure
# is too noisy.
_MIN_FORCE_N, _MIN_SHARE = 50.0, 0.25
# percentile of the distances of the centre of pressure from the outline that is compared with the limits
_PERCENTILE = 90.0
_FOOT_M = 0.20  # length from the heel markers to the toe markers. A shorter outline lacks one end of the foot.
# Least length of each foot's markers, and least width of the markers of all feet. From the ankle to the toes it is at
# least 0.135 m. Markers of the toes alone, or of one foot alone, are at most 0.12 m long or wide.
_BOTH_ENDS_M = 0.13
_FOOT_WIDTH_M = 0.05  # least width of the markers of one foot; a narrower outline may follow only one edge of the foot
# least length of the markers of two feet that are so close together that their markers form one group
_TWO_FEET_M = 0.25
# Fraction of the standing weight. If the plates carry more while the body is low, a chair may stand on them.
_WHOLE_WEIGHT = 0.75
# a speed is the difference between the positions this time before and after a sample, divided by twice this time
_STEP_S = 0.1
_SWAY_M_S = 0.03  # largest speed of the markers' mean while a person stands still
_PAUSE_S = 0.5  # shortest time of standing still. In a shorter time, the mean acceleration may differ from zero.
_MIN_TOTAL_S = 1.0
# a foot is beside a plate if the mean of its markers is farther than this outside the outline of the plate
_OFF_PLATE_M = 0.02
# If the centre of pressure is not farther than this from one foot, towards the other foot, the force acts under that
# foot alone: a length, and a fraction of the distance of the feet. People who load both feet have 0.4 to 0.6.
_UNDER_M, _UNDER_SHARE = 0.035, 0.2
_BEHIND = 0.8  # largest cosine of the angle between a foot and the line from this foot to the other one
_UNDER_NEARER = 0.3  # the same fraction, if the other foot is also beside all plates
# About the middle of the body, the markers above the first value (a fraction of the height of the highest marker) are
# mirrored: most images are within the second value of a marker. The middle is known if these are at least the third
# value, a fraction of the markers: it is at least 0.93 in good recordings, and at most 0.67 if one side has no markers.
_UPPER_BODY, _MIRRORED_M, _MIRRORED = 0.4, 0.06, 0.8
_MIDDLE_STEP_M = 0.005
# Largest distance of the centre of pressure from the centre of the plate if the moments are missing: if the body rises
# or lowers, and if it does not. Good recordings of a rise have at least 0.025 m. The horizontal force adds up to 0.005
# m.
_PINNED_M, _PINNED_STILL_M = 0.008, 0.001


@dataclass(frozen=True)
class PlatePlacement:
    """Position of one plate relative to the feet on it."""

    index: int  # the plate's number, from 1
    # 90th percentile of the distance of the centre of pressure from the outline of the feet, m, negative inside; None
    # if it cannot be determined
    off_feet: float | None
    unknown: str | None  # the reason why `off_feet` is None; None if `off_feet` has a value
    allowance: float  # length by which the outline of the markers may be shorter than the foot, m
    # height of the lowest foot marker above the surface of the plate, m; None without foot markers or corners
    over_surface: float | None
    normal: FloatArray | None  # (3,) upward normal of the surface in lab axes; None if the file has no corners
    load: float  # mean vertical force over the samples in which only feet load the plate, N; 0 without such samples

    @property
    def inclined(self) -> float | None:
        """Inclination of the surface from horizontal, rad; None if the file has no corners."""
        return None if self.normal is None else float(np.arccos(np.clip(self.normal[2], -1.0, 1.0)))


def compare_with_feet(
    plates: Sequence[Plate], samples: Sequence[PlateSamples], positions: FloatArray
) -> list[PlatePlacement]:
    """Compare every plate under the feet with the markers of the feet.

    If there are as many feet as plates, each plate is compared with a different foot, otherwise with all feet together.
    The result has one entry for each plate.
    """
    # samples in which only feet load each plate: all loaded ones, but if the plates carry the whole weight while the
    # body is low, a chair may stand on them; then only the loaded ones in which the person stands
    loaded = [_find_loaded(each) for each in samples]
    tall, low = find_upright(positions)
    total = np.sum([np.where(each.ok, each.force[:, 2], 0.0) for each in samples], axis=0) if samples else np.zeros(0)
    if low.any() and tall.any() and np.percentile(total[low], 10) > _WHOLE_WEIGHT * np.median(total[tall]):
        loaded = [each & tall for each in loaded]

    # feet, and why their markers do not give an outline of the soles
    surfaces = [plate.centre[2] for plate in plates if plate.centre is not None]
    surface = float(np.mean(surfaces)) if surfaces else None
    feet = []
    if any(map(np.any, loaded)):
        feet = find_standing_feet(positions, np.logical_or.reduce(loaded), surface, len(plates))
    feet = [foot for foot in feet if measure_length(foot[:, :2]) > _FOOT_M / 2]
    unknown = None
    if not feet:
        unknown = "no foot with two markers stands still"
    elif min(measure_length(foot[:, :2]) for foot in feet) < (_BOTH_ENDS_M if len(feet) > 1 else _TWO_FEET_M):
        unknown = "the markers are on one foot alone, or not on both ends of each foot"
    elif measure_width(np.concatenate(feet)[:, :2]) < _BOTH_ENDS_M:
        unknown = "the markers are on one foot alone, or on only one end of the feet"

    # distance of every plate's centre of pressure from every outline, and the outline that belongs to the plate
    shared = len(feet) != len(plates)
    outlines = [] if unknown else [np.concatenate(feet)] * len(plates) if shared else feet
    distances = np.full((len(plates), len(outlines)), np.nan)
    for k, (plate, each, where) in enumerate(zip(plates, samples, loaded, strict=True)):
        if where.any():
            centres = compute_centre_of_pressure(plate, each)[where]
            distances[k] = [
                float(np.percentile(measure_outside(centres, outline[:, :2]), _PERCENTILE)) for outline in outlines
            ]
    own: IntArray = linear_sum_assignment(np.nan_to_num(distances, nan=0.0))[1] if outlines else np.zeros(0, np.int64)
    lowest = min((foot[:, 2].min() for foot in feet), default=None)
    placements = []
    for k, (plate, each, where) in enumerate(zip(plates, samples, loaded, strict=True)):
        off, allowance, over = np.nan, 0.0, None
        if outlines:  # by how much the outline of the markers may be shorter than a foot, or narrower
            off, chosen = distances[k, own[k]], feet if shared else [feet[own[k]]]
            length = max(measure_length(foot[:, :2]) for foot in chosen)
            width = measure_width(np.concatenate(chosen)[:, :2])
            allowance = max(0.0, _FOOT_M - length, (0.0 if shared else _FOOT_WIDTH_M) - width)
        if lowest is not None and plate.centre is not None and where.any():
            over = float(lowest - plate.centre[2])
        known = bool(np.isfinite(off))
        placements.append(
            PlatePlacement(
                index=plate.index,
                off_feet=off if known else None,
                unknown=None if known else unknown or "the plate is hardly loaded",
                allowance=allowance if known else 0.0,
                over_surface=over,
                # the z axis of a plate points down
                normal=None if plate.corners is None else -compute_plate_axes(plate.corners)[:, 2],
                load=float(each.force[where, 2].mean()) if where.any() else 0.0,
            )
        )
    return placements


def measure_lean(force: FloatArray, positions: FloatArray, rate: float) -> FloatArray | None:
    """Return the angles (2,), rad, between the vertical and the mean ground force while the person stands still.

    They are positive if the force is inclined towards +X and +Y of the lab. ``force`` (F, 3) is the total force of the
    plates under the feet, lab axes, N. The result is None if the person stands still for less than a second in total,
    or if the plates carry no weight then.
    """
    half = max(1, round(_STEP_S * rate))
    if len(positions) <= 2 * half:
        return None
    speed = np.full(len(positions), np.inf)
    moved = average_markers(positions[2 * half :] - positions[: -2 * half]) * rate / (2 * half)
    speed[half:-half] = np.linalg.norm(moved, axis=1)
    slow = np.nan_to_num(speed, nan=np.inf) < _SWAY_M_S
    still = np.zeros(len(positions), bool)
    for run in find_runs(find_upright(positions)[0] & np.isfinite(force).all(axis=1) & slow):
        still[run] = run.stop - run.start >= round(_PAUSE_S * rate)
    if still.sum() < _MIN_TOTAL_S * rate or not shows_standing(positions, still):
        return None
    mean = force[still].mean(axis=0)
    return np.asarray(np.arctan2(mean[:2], mean[2])) if mean[2] > _MIN_FORCE_N else None


def find_foot_beside(
    plates: Sequence[Plate], samples: Sequence[PlateSamples], positions: FloatArray
) -> tuple[FloatArray, float, float] | None:
    """Find a standing foot whose load no plate measures: the force acts under the other foot alone.

    ``plates`` and ``samples`` are those of the plates under the feet. A foot is found if it is beside every plate and
    the centre of pressure of all plates together is nearer to the other foot, or if the centre of pressure is under the
    other foot and the feet are not both on one plate. The result is None if there is no such foot, or if the markers do
    not show two standing feet.

    The first value is the mean position of each marker on the foot, (K, 3), m. The second is the distance of the foot
    from the outline of the nearest plate, m; NaN if a plate has no corners. The third is the distance of the centre of
    pressure from the other foot, divided by the distance of the feet: 0.5 if both feet carry the same load, 0 if only
    the other foot carries load.
    """
    surfaces = [plate.centre[2] for plate in plates if plate.centre is not None]
    load = _measure_load(surfaces, samples, positions)
    if load is None:
        return None
    _, feet, centres, share = load
    width = float(np.linalg.norm(centres[1] - centres[0]))
    loaded, share = 0 if share < 0.5 else 1, min(share, 1.0 - share)
    beside = float("nan")
    if len(surfaces) == len(plates):
        beside = min(_measure_beside(centres[1 - loaded], plate) for plate in plates)
        own = min(_measure_beside(centres[loaded], plate) for plate in plates)
        if own <= _OFF_PLATE_M < beside and share < _UNDER_NEARER:
            return feet[1 - loaded], beside, share
        if len(plates) == 1 and beside <= _OFF_PLATE_M:
            return None  # both feet are on the plate, so it measures both, even if one carries nearly all the load
    under = min(_UNDER_M, _UNDER_SHARE * width)
    return (feet[1 - loaded], beside, share) if abs(share) * width < under else None


def _measure_load(
    surfaces: Sequence[float], samples: Sequence[PlateSamples], positions: FloatArray
) -> tuple[BoolArray, list[FloatArray], list[FloatArray], float] | None:
    """Return where the load of two feet acts that stand side by side; None if the markers do not show such feet.

    The results are the samples (F,) in which the person stands on the plates; the mean marker positions (K, 3) of each
    foot, m, and their mean (2,); and the distance of the centre of pressure from the first foot as a share of that of
    the feet.
    """
    force = np.sum([each.force for each in samples], axis=0)
    moment = np.sum([each.moment for each in samples], axis=0)
    surface = float(np.mean(surfaces)) if surfaces else 0.0  # without corners, the floor of the lab
    vertical = np.where(np.isfinite(force).all(axis=1), force[:, 2], 0.0)
    stands = find_upright(positions)[0] & (vertical > max(_MIN_FORCE_N, _MIN_SHARE * np.percentile(vertical, 95)))
    if not stands.any():
        return None
    feet = find_standing_feet(positions, stands, surface, 2)
    if len(feet) != 2:
        return None
    about = (moment - np.cross([0.0, 0.0, surface], force))[stands]
    pressure = np.median(np.column_stack([-about[:, 1], about[:, 0]]) / force[stands, 2:], axis=0)
    centres = [foot[:, :2].mean(axis=0) for foot in feet]
    apart = centres[1] - centres[0]
    width = float(np.linalg.norm(apart))
    for foot in feet:
        if measure_length(foot[:, :2]) >= _BOTH_ENDS_M:
            along = np.linalg.svd(foot[:, :2] - foot[:, :2].mean(axis=0), full_matrices=False)[2][0]
            if abs(along @ apart) > _BEHIND * width:
                return None  # not side by side: a foot and an object behind it, such as a chair, or a long step
    return stands, feet, centres, float((pressure - centres[0]) @ apart) / width**2


@dataclass(frozen=True)
class FootLoad:
    """Share of the load on the foot that carries less, while a person stands on two feet."""

    foot: FloatArray  # mean positions of the markers on this foot, (K, 3), m
    measured: float  # share of the load that the plates measure on this foot: 0.5 if both feet carry the same
    # share for which the body is above the centre of pressure, as it is on a person who stands still without a support;
    # None if the markers do not show the middle of the body
    expected: float | None
    width: float  # distance of the feet, m
    loads: tuple[float, ...]  # median vertical force of each plate, N


def measure_load_share(
    plates: Sequence[Plate], samples: Sequence[PlateSamples], positions: FloatArray
) -> FootLoad | None:
    """Compare the load of two feet on several plates with the position of the body between the feet.

    A person who unloads one leg moves the body towards the other foot. A wrong gain or unit of one plate changes the
    centre of pressure of all plates, but not the body. ``plates`` and ``samples`` are those of the plates under the
    feet. The result is None for fewer than two plates, or if the markers do not show a person who stands on two feet.
    """
    load = _measure_load([each.centre[2] for each in plates if each.centre is not None], samples, positions)
    if load is None or len(plates) < 2:
        return None
    stands, feet, centres, share = load
    if not shows_standing(positions, stands):
        return None
    known = np.isfinite(positions[stands]).all(axis=2).any(axis=0)
    middle = np.nanmedian(positions[stands][:, known], axis=0)
    height = middle[:, 2] - min(foot[:, 2].min() for foot in feet)
    width = float(np.linalg.norm(centres[1] - centres[0]))
    x, y = (centres[1] - centres[0]) / width
    upper = middle[height > _UPPER_BODY * height.max()] - [*centres[0], 0.0]
    upper = upper @ np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])  # from foot to foot, forwards, up
    best: tuple[float, float] = (0.0, 0.0)
    body: float | None = None
    for centre in np.arange(upper[:, 0].min(), upper[:, 0].max(), _MIDDLE_STEP_M):
        image = upper * [-1.0, 1.0, 1.0] + [2.0 * centre, 0.0, 0.0]
        away = np.linalg.norm(image[:, None] - upper[None], axis=-1).min(axis=1)
        found = float(np.mean(away < _MIRRORED_M)), -float(np.mean(np.minimum(away, _MIRRORED_M)))
        if found > best or body is None:
            best, body = found, float(centre) / width
    body = body if best[0] >= _MIRRORED else None
    loads = tuple(float(np.median(each.force[stands, 2])) for each in samples)
    if share < 0.5:  # the centre of pressure is nearer to the first foot
        return FootLoad(feet[1], share, body, width, loads)
    return FootLoad(feet[0], 1.0 - share, None if body is None else 1.0 - body, width, loads)


def _measure_beside(point: FloatArray, plate: Plate) -> float:
    """Return the horizontal distance of a point (2,) from the outline of a plate with corners, m; negative inside."""
    assert plate.corners is not None
    return float(measure_outside(point[None], plate.corners[:, :2])[0])


def find_pinned_pressure(plate: Plate, samples: PlateSamples, positions: FloatArray) -> float | None:
    """Return the largest distance of the centre of pressure from the plate's centre, m, if it never leaves the centre.

    The moments are then missing or far too small. The distance is the 95th percentile over the loaded samples. The
    result is None if the centre of pressure moves. Without corners, the distance is that from its own median.
    """
    loaded = _find_loaded(samples)
    if not loaded.any():
        return None
    points = compute_centre_of_pressure(plate, samples)[loaded]
    centre = np.median(points, axis=0) if plate.centre is None else plate.centre[:2]
    away = float(np.percentile(np.linalg.norm(points - centre, axis=1), 95.0))
    moves = find_upright(positions)[1].any()
    limit = _PINNED_STILL_M
    if moves and plate.centre is not None:
        limit = _PINNED_M
    elif not moves and plate.centre is None:
        limit = 0.0  # a person who stands still moves the centre of pressure by less than a millimetre
    return away if away <= limit else None


def _find_loaded(samples: PlateSamples) -> BoolArray:
    """Return a mask (F,) of the samples whose vertical force is large enough for a centre of pressure."""
    vertical = np.where(samples.ok, samples.force[:, 2], 0.0)
    return np.asarray(vertical > max(_MIN_FORCE_N, _MIN_SHARE * float(np.percentile(vertical, 95))))
