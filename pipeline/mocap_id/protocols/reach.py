"""Reaches in a recording: times and targets, ranges of the angles, and the volume that the wrist can reach.

The targets on the body and the heights come from tables of body proportions (Drillis and Contini 1966), relative to the
sternal notch; the shoulders are measured. The targets have errors of a few centimetres, because no marker is on hip,
mouth or head.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray, find_runs
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.store.artefacts import MEANINGLESS_AT_POLE, MeasuredPoses, SpatialAngles, SpatialSkeleton

_MOVING = 0.12  # share of the 98 % quantile of the speed; below it, the hand rests
_SLOWEST = 0.04  # m/s, lowest threshold of the speed
_PAUSE = 0.08  # s, shortest pause between two movements
_LEAST = 0.25  # s, shortest movement
_FAR = 0.12  # share of the arm's length: a movement that ends nearer to its start is ignored
_HOME = 0.25  # share of the arm's length: radius of the region where the hand rests
_ANY = 0.17  # statures: a hand farther from every target did not go to a target
# position of each target relative to the sternal notch, in statures: forward, upward and to the right
_PLACES = {
    "hip": (-0.02, -0.29, 0.115),
    "mouth": (0.05, 0.085, 0.0),
    "head": (-0.02, 0.17, 0.0),
}
_SKIN = np.array([0.04, 0.015, 0.02])  # statures from the shoulder's centre to its surface in front, above and outside
# height above the sternal notch, in statures; an overhead shelf is a hand's length above the head
_LEVELS = {"waist": -0.21, "mouth": 0.085, "overhead": 0.26}
_ENDS = "the recording ends before the hand leaves the target"
# distance from the middle of a hand to a target that it touches, in statures: half a hand's width and a margin
_TOUCH = 0.05


@dataclass(frozen=True)
class Reach:
    """Movement of the hand from its rest position or another target to a target, with the stay at this target."""

    # start, top, end: times at which the hand starts, is in the middle of its stay at the target, and is back at rest
    # or leaves for another target, s
    start: float
    top: float
    end: float
    # target: ``hip``, ``same_shoulder``, ``opposite_shoulder``, ``mouth``, ``head``, ``overhead`` or ``none``
    target: str
    miss: float  # distance by which the hand missed the target, m; 0 if it touched the target, NaN without a target
    complete: bool  # whether the hand came back or moved to another target
    why: str  # reason why it is not complete, or why an event or the target is unknown; otherwise empty


def find_reaches(time: FloatArray, arm: RecordedArm) -> tuple[Reach, ...]:
    """Find the reaches in a recording from the path of the palm; the sample times ``time`` (T,), s, are equidistant."""
    palms = arm.palms
    known = np.isfinite(palms).all(axis=1)
    measured = arm.measured & known
    if known.sum() < 10:
        return ()
    path = np.stack([np.interp(time, time[known], each) for each in palms[known].T], axis=1)
    # first and last sample of every movement of the hand between two pauses
    speed = np.linalg.norm(np.gradient(path, time, axis=0), axis=1)
    threshold = max(_MOVING * float(np.quantile(speed, 0.98)), _SLOWEST)
    rate = 1 / float(np.median(np.diff(time)))
    moving = speed > threshold
    for a, b in _find_spans(~moving):
        if b - a < round(_PAUSE * rate):
            moving[a:b] = True
    least = _FAR * arm.arm.length
    moves = [
        (a, b)
        for a, b in _find_spans(moving)
        if (b - a) / rate >= _LEAST and np.linalg.norm(path[b] - path[a]) >= least
    ]
    if not moves:
        return ()
    home = path[: moves[0][0] + 1].mean(axis=0)
    near = _HOME * arm.arm.length
    reaches = []
    for k, (first, last) in enumerate(moves):
        if np.linalg.norm(path[last] - home) < near:
            continue
        follows = moves[k + 1] if k + 1 < len(moves) else None
        back = follows is not None and np.linalg.norm(path[follows[1]] - home) < near
        top = (last + (follows[0] if follows else len(time) - 1)) // 2
        stop = len(time) - 1 if follows is None else follows[1] if back else follows[0]
        target, miss = _find_target(arm, slice(last, (follows[0] if follows else len(time) - 1) + 1), path)
        events = {name: float(time[at]) for name, at in (("start", first), ("top", top), ("end", stop))}
        why = [] if follows else [_ENDS]
        for name, at in zip(events, (first, top, stop), strict=True):
            hidden = np.flatnonzero(~measured[max(at - 1, 0) : at + 2])
            if len(hidden):
                events[name] = float("nan")
                why.append(f"the arm is not measured at its {name} ({time[at]:.2f} s)")
        reaches.append(Reach(**events, target=target, miss=miss, complete=follows is not None, why="; ".join(why)))
    return tuple(reaches)


def _find_spans(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the first sample of each run of True, and the sample after it, or the last one if the run ends there."""
    return [(run.start, min(run.stop, len(flags) - 1)) for run in find_runs(flags)]


def _find_target(arm: RecordedArm, held: slice, path: FloatArray) -> tuple[str, float]:
    """Return the target nearest to the hand in the samples ``held``, and by how much the hand misses it, m.

    The second value is 0 if the hand touches the target. Without a near target, the result is "none" and NaN.
    """
    seen = arm.measured[held] & np.isfinite(arm.wrists[held]).all(axis=1)
    if not seen.any():
        return "none", float("nan")
    palm, wrist = (np.median(each[held][seen], axis=0) for each in (path, arm.wrists))
    fingers = 2 * palm - wrist
    along, far = fingers - wrist, {}
    for name, place in locate_body_targets(arm).items():  # distance from the line between wrist and fingers
        share = np.clip((place - wrist) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        far[name] = float(np.linalg.norm(wrist + share * along - place))
    overhead = compute_level_heights(arm)["overhead"]
    if fingers[1] >= overhead and min(far.values()) > _TOUCH * arm.stature:
        return "overhead", 0.0
    name = min(far, key=lambda each: far[each])
    if far[name] > _ANY * arm.stature:
        return "none", float("nan")
    return name, max(far[name] - _TOUCH * arm.stature, 0.0)


def locate_body_targets(arm: RecordedArm) -> dict[str, FloatArray]:
    """Return the positions (3,) of the targets from the shoulder's centre, in the axes of the thorax, m, by name."""
    targets = {name: arm.stature * np.array(place) - arm.shoulder for name, place in _PLACES.items()}
    skin = arm.stature * _SKIN
    opposite = arm.shoulder * [1, 1, -1] - arm.shoulder
    return targets | {"same_shoulder": skin, "opposite_shoulder": opposite + skin * [1, 1, -1]}


def compute_level_heights(arm: RecordedArm) -> dict[str, float]:
    """Return the heights of the levels waist, mouth and overhead above the shoulder's centre, m, by name."""
    return {name: float(height * arm.stature - arm.shoulder[1]) for name, height in _LEVELS.items()}


_FEWEST = 40  # smallest number of postures for a region
_MOST = 200  # approximate number of postures for a hull; four times as many change the volume by less than 1 %
_BLOCK = 8192  # postures computed at once, to limit the memory
_FLAT = 1e-9  # slope of a face that does not limit the plane


PlaneRange: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Function from elevation, axial rotation and flexion to the lowest and highest plane, (K,) arrays, rad.

If the lowest plane is above the highest one, the posture is not possible."""


def find_visited_region(postures: FloatArray, limits: FloatArray) -> tuple[FloatArray, PlaneRange] | None:
    """Return the box (4, 2) around the convex hull of the visited postures, rad, and the hull's range of planes.

    The result is None if the postures are too few or if the hull has no volume. ``postures`` (T, 4) are plane,
    elevation, axial rotation and flexion, rad. ``limits`` (4, 2) are the robust ranges of these angles, rad; postures
    outside are moved to the limit.
    """
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  only a reach needs it

    size = limits[:, 1] - limits[:, 0]
    if len(postures) < _FEWEST or np.any(size <= 0):
        return None
    thinned = postures[:: max(len(postures) // _MOST, 1)]
    share = np.clip((thinned - limits[:, 0]) / size, 0.0, 1.0)
    try:
        hull = ConvexHull(share)
    except QhullError:
        return None
    # the postures x with normals (F, 4) @ x <= bounds (F,) are inside; each face then limits the plane from one side
    faces = np.unique(np.round(hull.equations, 9), axis=0)
    normals = faces[:, :4] / size
    bounds = normals @ limits[:, 0] - faces[:, 4]
    slope = normals[:, 0]
    up, down = slope > _FLAT, slope < -_FLAT
    flat = ~up & ~down
    scale = np.where(flat, 1.0, slope)  # faces as plane <= or >= height - others_slope @ others
    others_slope, height = ((each.T / scale).T.astype(np.float32) for each in (normals[:, 1:], bounds))

    def find_planes(elevation: FloatArray, axial: FloatArray, flexion: FloatArray) -> tuple[FloatArray, FloatArray]:
        low, high = np.empty(len(elevation)), np.empty(len(elevation))
        for first in range(0, len(elevation), _BLOCK):
            part = slice(first, first + _BLOCK)
            others = np.stack([elevation[part], axial[part], flexion[part]]).astype(np.float32)
            high[part] = (height[up, None] - others_slope[up] @ others).min(axis=0)
            low[part] = (height[down, None] - others_slope[down] @ others).max(axis=0)
            if flat.any():
                outside = (height[flat, None] < others_slope[flat] @ others).any(axis=0)
                low[part] = np.where(outside, np.inf, low[part])
        return low, high

    around = np.stack([share.min(axis=0), share.max(axis=0)], axis=1)
    return limits[:, :1] + around * size[:, None], find_planes


_FULL = 2 * np.pi
_CURVE = 400  # flexions at which the position of the wrist is computed


@dataclass(frozen=True)
class ReachArm:
    """Dimensions of an arm."""

    elbow: FloatArray  # (3,) elbow centre in the axes of the upper arm, whose origin is the shoulder centre, m
    forearm: float  # distance from the elbow centre to the wrist along the forearm's y axis, m
    # (3,) coefficients c0, c1, c2 of the carrying angle c0 + c1 cos(flexion) + c2 sin(flexion), rad
    carrying: FloatArray
    # rise of the shoulder in the thorax at an elevation of 180°, m; at others, it is rise (1 - cos(elevation)) / 2
    rise: float

    def wrist(self, flexion: FloatArray) -> FloatArray:
        """Return the position (K, 3) of the wrist in the axes of the upper arm, m, for flexions (K,), rad."""
        bent = self.carrying @ np.stack([np.ones_like(flexion), np.cos(flexion), np.sin(flexion)])
        along = np.stack([np.sin(flexion) * np.cos(bent), -np.cos(flexion) * np.cos(bent), -np.sin(bent)], axis=1)
        return np.asarray(self.elbow + self.forearm * along)

    @property
    def length(self) -> float:
        """Length of the straight arm from shoulder to wrist, m."""
        return float(np.linalg.norm(self.elbow) + self.forearm)


CellGrid: TypeAlias = tuple[int, int, int]
"""Numbers of distances, of polar angles, and of turns, which are the elevations and also the axial rotations."""


@dataclass(frozen=True)
class ReachableSet:
    """Reachable set as arcs about the vertical axis of the thorax through the shoulder."""

    distance: FloatArray  # (R + 1,) edges of the cells of the distance from the shoulder, m
    cosine: FloatArray  # (C + 1,) edges of the cells of the cosine of the polar angle
    # Start, end: (R, C, A) azimuths of the ends of the arcs, rad: 0 is lateral, π/2 forward. ``start`` is ascending,
    # in [0, 2π). Arcs of length 0 are ignored.
    start: FloatArray
    end: FloatArray

    @property
    def volume(self) -> float:
        """Volume of the set, m³."""
        over = np.maximum(self.end.max(axis=-1, keepdims=True) - _FULL, 0.0)
        reached = np.maximum.accumulate(np.concatenate([over, np.minimum(self.end, _FULL)], axis=-1), axis=-1)
        covered = over[..., 0] + np.maximum(reached[..., 1:] - np.maximum(self.start, reached[..., :-1]), 0).sum(
            axis=-1
        )
        cell = np.diff(self.distance**3)[:, None] / 3 * np.diff(self.cosine)
        return float(np.sum(np.minimum(covered, _FULL) * cell))


def compute_reachable_set(
    arm: ReachArm, limits: FloatArray, grid: CellGrid, planes: PlaneRange | None = None
) -> ReachableSet:
    """Return the set of positions that the wrist can reach, relative to the shoulder at the middle elevation.

    ``limits`` (4, 2) are the lowest and highest plane, elevation, axial rotation and flexion, rad. ``planes`` gives the
    range of the plane, which depends on the other angles; by default, it is the range in ``limits``.
    """
    # distance of the wrist from the shoulder, ascending, and flexion and wrist in the upper arm at this distance
    flexions = np.linspace(limits[3, 0], limits[3, 1], _CURVE)
    wrist = arm.wrist(flexions)
    reach = np.linalg.norm(wrist, axis=1)
    longest = int(reach.argmax())  # smaller flexions only repeat distances
    reach, flexions, wrist = reach[longest:][::-1], flexions[longest:][::-1], wrist[longest:][::-1]
    distances, polar_angles, turns = grid
    slack = abs(arm.rise) / 2
    near, far = max(reach[0] - slack, 0.0), reach[-1] + slack
    distance = np.cbrt(np.linspace(near**3, far**3, distances + 1))
    cosine = np.linspace(-1.0, 1.0, polar_angles + 1)
    # distance from the vertical axis and height (R, C, 1) of the middle of every cell, m
    r = np.cbrt((distance[1:] ** 3 + distance[:-1] ** 3) / 2)[:, None, None]
    c = ((cosine[1:] + cosine[:-1]) / 2)[:, None]
    across, level = r * np.sqrt(1 - c**2), r * c

    def shoulder_height(elevation: FloatArray) -> FloatArray:
        """Return the height of the shoulder at an elevation, relative to the middle elevation, m."""
        return np.asarray(arm.rise * (np.cos(limits[1]).mean() - np.cos(elevation)) / 2)

    def bend_arm(height: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
        """Return x, y, z of the wrist in the upper arm, m, the flexion, and True where the distance is possible."""
        d = np.hypot(across, height)
        x, y, z, flexion = (np.interp(d, reach, each) for each in (*wrist.T, flexions))
        return x, y, z, flexion, (d >= reach[0]) & (d <= reach[-1])

    # azimuth at plane 0, elevation, axial rotation, flexion, and True where the limits allow them, (R, C, A) arrays
    solutions: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]] = []
    # the two axial rotations at every elevation of the grid
    elevation = np.linspace(limits[1, 0], limits[1, 1], turns)
    sine = np.maximum(np.sin(elevation), 1e-9)
    height = level - shoulder_height(elevation)
    x, y, z, flexion, possible = bend_arm(height)
    forward, wide = (height - np.cos(elevation) * y) / sine, np.hypot(x, z)
    lowest, highest = limits[2]
    for sign in (-1.0, 1.0):
        axial = sign * np.arccos(np.clip(forward / wide, -1, 1)) - np.arctan2(x, z)
        valid = possible & (np.abs(forward) <= wide) & (np.mod(axial - lowest, _FULL) <= highest - lowest)
        azimuth = np.arctan2(x * np.cos(axial) + z * np.sin(axial), np.cos(elevation) * forward - sine * y)
        solutions.append((azimuth, np.broadcast_to(elevation, axial.shape), axial, flexion, valid))
    # the two elevations at every axial rotation of the grid
    axial = np.linspace(limits[2, 0], limits[2, 1], turns)
    for sign in (-1.0, 1.0):
        elevation = np.full((*level.shape[:2], len(axial)), limits[1].mean())
        for _ in range(2 if arm.rise else 1):  # the height of the shoulder changes a little with the elevation
            height = level - shoulder_height(elevation)
            x, y, z, flexion, possible = bend_arm(height)
            sideways, forward = x * np.cos(axial) + z * np.sin(axial), z * np.cos(axial) - x * np.sin(axial)
            wide = np.hypot(y, forward)
            elevation = np.arctan2(forward, y) + sign * np.arccos(np.clip(height / wide, -1, 1))
        elevation = np.mod(elevation, _FULL)
        valid = possible & (np.abs(height) <= wide) & (elevation >= limits[1, 0]) & (elevation <= limits[1, 1])
        azimuth = np.arctan2(sideways, np.cos(elevation) * forward - np.sin(elevation) * y)
        solutions.append((azimuth, elevation, np.broadcast_to(axial, elevation.shape), flexion, valid))

    azimuth, elevation, axial, flexion, valid = (np.concatenate(each, axis=-1) for each in zip(*solutions, strict=True))
    low, high = np.full_like(azimuth, limits[0, 0]), np.full_like(azimuth, limits[0, 1])
    if planes is not None:
        low[valid], high[valid] = planes(elevation[valid], axial[valid], flexion[valid])
    valid &= high > low
    start = np.where(valid, np.mod(np.where(valid, azimuth + low, 0.0), _FULL), _FULL)
    end = np.where(valid, start + np.minimum(high - low, _FULL), _FULL)
    order = np.argsort(start, axis=-1)
    start, end = (np.take_along_axis(each, order, axis=-1) for each in (start, end))
    return ReachableSet(distance, cosine, start, end)


_SURFACE = (48, 24, 16)  # cells of the surface; many distances, because the distance is the radius of the surface
_AZIMUTHS = 48
_QUADRANTS = ("upper_medial", "upper_lateral", "lower_medial", "lower_lateral")


def compute_reach_surface(
    arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, dict[str, float]]:
    """Return the largest distance of the wrist from the shoulder in each direction.

    The results are the angles (C,) from the upward axis of the thorax, ascending, and (K,) about this axis, 0 lateral
    and π/2 forward, rad; the distances (C, K), m, NaN where nothing is reached; and relative areas: ``total`` and the
    quadrants in front of the shoulder, ``behind`` for the other half. The arguments are those of
    :func:`compute_reachable_set`.
    """
    reachable = compute_reachable_set(arm, limits, _SURFACE, planes)
    azimuth = 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    radius = np.full((len(reachable.cosine) - 1, len(azimuth)), np.nan)
    for k, angle in enumerate(azimuth):
        inside = ((reachable.start <= angle) & (angle <= reachable.end)) | (angle + _FULL <= reachable.end)
        reached = (inside & (reachable.end > reachable.start)).any(axis=-1)
        last = len(reached) - 1 - reached[::-1].argmax(axis=0)
        radius[:, k] = np.where(reached.any(axis=0), reachable.distance[1:][last], np.nan)
    radius = radius[::-1]
    polar = np.arccos((reachable.cosine[1:] + reachable.cosine[:-1]) / 2)[::-1]
    # relative areas; all cells have the same solid angle
    each = np.nan_to_num(radius / arm.length) ** 2 * 2 / radius.size
    front, lateral, upper = np.sin(azimuth) > 0, np.cos(azimuth) > 0, np.cos(polar)[:, None] > 0
    areas = {"total": float(each[:, front].sum())}
    for name in _QUADRANTS:
        height, side = name.split("_")
        there = (upper == (height == "upper")) & front & (lateral == (side == "lateral"))
        areas[name] = float(each[there].sum())
    areas["behind"] = float(each[:, ~front].sum())
    return polar, azimuth, radius, areas


SEGMENTS = ("thorax", "upper_arm", "forearm")
ANGLES = ("shoulder_plane", "shoulder_elevation", "shoulder_axial", "elbow_flexion")
"""Angles that move the wrist, in the order of the limits of :func:`compute_reachable_set`."""

_WRIST_SD = 0.003  # m, standard deviation of the wrist's position along the forearm without a joint there
_RISE_SD = 0.008  # m, standard deviation of the shoulder's rise at 180° if the motion does not determine it
_RAISED = 0.1  # smallest range of (1 - cos elevation) / 2 that determines the rise
_TRAVEL = 0.12  # m, largest motion of the shoulder's centre in the thorax by the shoulder girdle
_PROPORTION = (0.75, 2.0)  # ratio of upper arm to forearm; 1.1 to 1.4 in most people
_HEIGHT = 1 / 0.332  # stature divided by the length of upper arm and forearm (Drillis and Contini 1966)
_PALM = 0.054  # distance from wrist to centre of the palm, in statures (Winter 2009)


class UnknownReach(Exception):
    """Exception for a trial whose reachable volume cannot be computed; the message gives the reason."""


@dataclass(frozen=True)
class RecordedArm:
    """A recorded arm and the path of its hand, in the axes of the thorax."""

    arm: ReachArm  # dimensions of the arm
    # upper_arm_sd, forearm_sd, rise_sd: standard deviations of these dimensions, m
    upper_arm_sd: float
    forearm_sd: float
    rise_sd: float
    shoulder: FloatArray  # (3,) shoulder centre from the origin of the thorax at the lowest elevation, m
    glide: FloatArray  # (3,) displacement of the shoulder centre from an elevation of 0 to 180°, m
    # elbows, wrists, palms: (T, 3) elbow, wrist and centre of the palm from the shoulder, m; NaN where unknown
    elbows: FloatArray
    wrists: FloatArray
    palms: FloatArray
    # (T,) False where markers of a segment are visible but not used; the path is bridged there
    measured: BoolArray
    stature: float  # stature, given or estimated from the arm's length, m


def measure_arm(
    angles: SpatialAngles, poses: MeasuredPoses, skeleton: SpatialSkeleton, stature: float | None = None
) -> RecordedArm:
    """Compute the dimensions of an arm and the path of its hand from a recording.

    The wrist is the projection of its joint centre onto the forearm's y axis, because axial rotation of the forearm
    does not move this point.

    ``poses`` are those of the segments in their anatomical axes. ``stature``, m, is by default estimated from the arm's
    length. Raises UnknownReach if a segment, an angle, the shoulder centre or the wrist is missing, or if the chain is
    not an arm.
    """
    missing = [name.replace("_", " ") for name in SEGMENTS if name not in poses.segments]
    if missing:
        raise UnknownReach(
            f"the chain has no {' and no '.join(missing)}: give `landmarks:`, or the names in `segment: {{names: …}}`"
        )
    missing = [name.replace("_", " ") for name in ANGLES if name not in angles.names]
    if missing:
        raise UnknownReach(
            f"{', '.join(missing)} cannot be computed without landmarks; name the landmarks under `landmarks:`"
        )
    for name in SEGMENTS[1:]:
        joint = skeleton.chain.joints[skeleton.segments.index(name) - 1]
        if not joint.known:
            raise UnknownReach(
                f"the motion does not determine the centre of the joint above the {name.replace('_', ' ')}: use "
                "`calibration:`, or record a larger motion"
            )
    thorax, upper, lower = (poses.segments.index(name) for name in SEGMENTS)
    centres = _express_in_segment(poses, thorax, poses.origin[:, upper])
    # shoulder centre at the lowest elevation, and its glide from 0 to 180°
    share = (1 - np.cos(angles.mean[:, angles.names.index("shoulder_elevation"), 0])) / 2
    seen = np.where(poses.find_measured(*SEGMENTS[:2])[:, None], centres, np.nan)
    known = np.isfinite(seen).all(axis=1) & np.isfinite(share)
    if not known.any():
        raise UnknownReach("no frame has markers of both thorax and upper arm")
    share, seen = share[known], seen[known]
    shoulder, glide, rise_sd = np.asarray(seen.mean(axis=0)), np.zeros(3), _RISE_SD
    if np.ptp(share) >= _RAISED and np.ptp(seen, axis=0).max() >= 1e-6:
        fit = np.linalg.lstsq(np.stack([np.ones(len(share)), share], axis=1), seen, rcond=None)[0]
        shoulder, glide = np.asarray(fit[0] + share.min() * fit[1]), np.asarray(fit[1])
        variance = float(skeleton.chain.joints[skeleton.segments.index("upper_arm") - 1].glide_covariance[1, 1])
        rise_sd = float(np.sqrt(variance)) if variance > 0 else _RISE_SD
    elbow = _find_median(_express_in_segment(poses, upper, poses.origin[:, lower]), "upper arm and forearm")
    wrist, forearm_sd = _locate_wrist(poses, skeleton)
    upper_arm = float(np.linalg.norm(elbow))
    # a chain between thorax and wrist that cannot be an arm
    travel = float(np.nanmax(np.nanquantile(centres, 0.99, axis=0) - np.nanquantile(centres, 0.01, axis=0)))
    hint = "the segments may be wrong: set `segment: {count: …}` or `together`"
    if travel > _TRAVEL:
        raise UnknownReach(
            f"the centre of the shoulder moves by {travel:.2f} m in the thorax, expected at most {_TRAVEL} m; {hint}"
        )
    if not _PROPORTION[0] * wrist <= upper_arm <= _PROPORTION[1] * wrist:
        raise UnknownReach(
            f"the elbow is {upper_arm:.3f} m from the shoulder and the wrist {wrist:.3f} m along the forearm, expected "
            f"a ratio of {_PROPORTION[0]} to {_PROPORTION[1]}; {hint}"
        )
    stature = stature or _HEIGHT * (upper_arm + wrist)
    turn = np.swapaxes(poses.rotation[:, thorax], 1, 2)
    elbows = np.einsum("tij,tjk,k->ti", turn, poses.rotation[:, upper], elbow)
    wrists = elbows + np.einsum("tij,tjk,k->ti", turn, poses.rotation[:, lower], np.array([0.0, -wrist, 0.0]))
    if not np.isfinite(wrists).all(axis=1).any():
        raise UnknownReach("no frame has markers of the whole arm")
    hand = poses.rotation[:, poses.segments.index("hand") if "hand" in poses.segments else lower]
    usable = np.isfinite(hand) & poses.find_measured("hand")[:, None, None]
    hand = np.where(usable, hand, poses.rotation[:, lower])
    palm = np.array([0.0, -_PALM * stature, 0.0])
    # carrying angle c0 + c1 cos(flexion) + c2 sin(flexion), rad
    at_elbow = np.swapaxes(poses.rotation[:, upper], 1, 2) @ poses.rotation[:, lower]
    at_elbow = at_elbow[np.isfinite(at_elbow).all(axis=(1, 2))]
    flexion = np.unwrap(np.arctan2(-at_elbow[:, 0, 1], at_elbow[:, 1, 1]))
    bent = np.arcsin(np.clip(at_elbow[:, 2, 1], -1, 1))
    if np.ptp(flexion) < 0.5:
        carrying = np.array([float(np.median(bent)), 0.0, 0.0])
    else:
        design = np.stack([np.ones(len(flexion)), np.cos(flexion), np.sin(flexion)], axis=1)
        carrying = np.asarray(np.linalg.lstsq(design, bent, rcond=None)[0])
    return RecordedArm(
        arm=ReachArm(elbow, wrist, carrying, float(glide[1])),
        upper_arm_sd=_length_sd(skeleton, "upper_arm"),
        forearm_sd=forearm_sd,
        rise_sd=rise_sd,
        shoulder=shoulder,
        glide=glide,
        elbows=elbows,
        wrists=wrists,
        palms=wrists + np.einsum("tij,tjk,k->ti", turn, hand, palm),
        measured=poses.find_measured(*SEGMENTS),
        stature=stature,
    )


def _find_median(points: FloatArray, segments: str) -> FloatArray:
    """Return the median (3,) of the known points (T, 3); ``segments`` names the segments in the error message."""
    known = np.isfinite(points).all(axis=1)
    if not known.any():
        raise UnknownReach(f"no frame has markers of both {segments}")
    return np.asarray(np.median(points[known], axis=0))


def _express_in_segment(poses: MeasuredPoses, segment: int, points: FloatArray) -> FloatArray:
    """Return points (T, 3), given in the trial's axes, in the axes of a segment."""
    return np.asarray(np.einsum("tji,tj->ti", poses.rotation[:, segment], points - poses.origin[:, segment]))


def _locate_wrist(poses: MeasuredPoses, skeleton: SpatialSkeleton) -> tuple[float, float]:
    """Return the distance from elbow to wrist along the forearm, m, and its standard deviation."""
    lower, sd = skeleton.segments.index("forearm"), _length_sd(skeleton, "forearm")
    marks = [skeleton.landmarks.index(name) for name in ("RS", "US") if name in skeleton.landmarks]
    if len(marks) == 2:
        return -float(skeleton.landmark_local[marks, 1].mean()), max(sd, _WRIST_SD)
    if "hand" in poses.segments and skeleton.chain.joints[skeleton.segments.index("hand") - 1].known:
        centres = _express_in_segment(poses, lower, poses.origin[:, poses.segments.index("hand")])
        return -float(_find_median(centres, "forearm and hand")[1]), max(sd, _WRIST_SD)
    if np.count_nonzero(skeleton.marker_segment == lower) == 1:  # the wrist of a skeleton without hands
        return -float(skeleton.locate_tip(lower)[1]), max(sd, _WRIST_SD)
    raise UnknownReach("the position of the wrist is unknown: name RS and US under `landmarks:`")


def _length_sd(skeleton: SpatialSkeleton, segment: str) -> float:
    """Return the standard deviation of the length of a segment, m; 3 mm if unknown."""
    sd = skeleton.lengths.get(segment, (np.nan, np.nan))[1]
    return sd if np.isfinite(sd) else _WRIST_SD


HELD = 0.05
"""Total time for which the angle is beyond each end of its range, s, so that one wrong sample does not move an end."""
# expected value of the larger of two independent errors, in standard deviations: noise moves each end outwards
_EXCESS = 0.56
# Standard deviation of each end of the elevation from the skeleton of a camera, rad. This error depends on the posture:
# the ranges of five recorded arms were up to 20° too large (docs/recordings.md).
_RAISED_SD = float(np.radians(7.0))

BETWEEN = {"shoulder": ("thorax", "upper_arm"), "elbow": ("upper_arm", "forearm"), "wrist": ("forearm", "hand")}
"""Segments before and after each joint of the arm."""


@dataclass(frozen=True)
class AngleRange:
    """Range of one angle in a recording."""

    # low, high: ends of the range, rad
    low: float
    high: float
    # low_sd, high_sd: standard deviation of each end without the constant error, rad
    low_sd: float
    high_sd: float
    # standard deviation of the constant error, which is the same at both ends and comes from the landmarks, rad
    constant_sd: float
    # share of the samples that are used: observed and, for plane and axial rotation, more than 15° from the poles
    used_share: float


def find_usable_samples(angles: SpatialAngles, poses: MeasuredPoses, name: str) -> BoolArray:
    """Return True (T,) for the samples in which the angle ``name`` is defined, known, and measured by markers."""
    usable = angles.find_usable(name)
    pair = BETWEEN.get(name.split("_", maxsplit=1)[0], ())
    for segment in pair:
        if segment in poses.segments and len(poses.time) == len(angles.time):
            usable = usable & poses.observed[:, poses.segments.index(segment)]
    return usable


def get_angle(angles: SpatialAngles, name: str, usable: BoolArray) -> FloatArray:
    """Return the angle ``name`` (K,) in the K usable samples, rad, without jumps by full rotations."""
    values = angles.mean[usable, angles.names.index(name), 0]
    return shift_to_shortest_arc(values) if name in MEANINGLESS_AT_POLE and len(values) else values


def measure_ranges(angles: SpatialAngles, poses: MeasuredPoses, *, skeleton: bool = False) -> dict[str, AngleRange]:
    """Return the range of every angle that is usable for long enough, by name.

    ``skeleton`` is True if the angles come from the skeleton of a camera. Its noise is slow and makes every range too
    large, so each end is then moved inwards by the expected excess.
    """
    rate = float(1 / np.median(np.diff(angles.time))) if len(angles.time) > 1 else 1.0
    ranges = {}
    for k, name in enumerate(angles.names):
        usable = find_usable_samples(angles, poses, name) & np.isfinite(angles.sd[:, k, 0])
        rank = max(round(HELD * rate), 1)
        if usable.sum() < 2 * rank:
            continue
        values, sd = get_angle(angles, name, usable), angles.sd[usable, k, 0]
        excess = _EXCESS * sd if skeleton else np.zeros(len(sd))
        low, low_sd = _find_low_end(values + excess, sd, rank)
        high, high_sd = _find_low_end(excess - values, sd, rank)
        high = -high
        if low > high:  # the noise is larger than the range
            low = high = 0.5 * (low + high)
        if skeleton and name == "shoulder_elevation":
            low_sd, high_sd = (float(np.hypot(one, _RAISED_SD)) for one in (low_sd, high_sd))
        constant = float(np.sqrt(np.mean(np.square(np.nan_to_num(angles.constant_sd[usable, k])))))
        ranges[name] = AngleRange(low, high, low_sd, high_sd, constant, float(usable.mean()))
    return ranges


def _find_low_end(values: FloatArray, sd: FloatArray, rank: int) -> tuple[float, float]:
    """Return the ``rank``-th lowest of ``values`` (K,), and the median of ``sd`` over the values up to this one."""
    lowest = np.argsort(values)[:rank]
    return float(values[lowest[-1]]), float(np.median(sd[lowest]))


# first grids for the box and for a region, which needs more axial rotations
_BOX, _REGION = (12, 24, 16), (8, 16, 32)
# grid for the changes of the volume by one standard deviation; their error is a few per cent
_CHANGES = (9, 18, 12)
_ENOUGH = 0.01, 0.02  # grids for the box and for a region are refined until the volume changes by less than this share
_MOST_GRIDS = 4  # largest number of grids


def compute_workspace(
    arm: RecordedArm, ranges: Mapping[str, AngleRange], region: tuple[FloatArray, PlaneRange] | None
) -> tuple[dict[str, Any], dict[str, Any] | None, float, dict[str, float]]:
    """Return the reachable volume of an arm, as facts of events.parquet, and the sources of its variance.

    The results are the facts of the volume within the box of the ranges, and within the visited region, None without a
    region; the standard deviation of the volume within the box, m³; and the share of each range and dimension in its
    variance, by name.

    The interval contains the errors of the ends of the ranges, of the lengths and of the shoulder's rise, the constant
    errors of the angles from the landmarks, and the error of the grid. A constant error of the plane is left out
    because it only rotates the set.

    ``ranges`` are those of the four angles of :data:`ANGLES`, by name; ``region`` is the result of
    :func:`find_visited_region`. Raises UnknownReach if the ranges are too small for a volume.
    """
    limits = np.array([(ranges[name].low, ranges[name].high) for name in ANGLES])
    volumes = _refine(arm.arm, limits)
    if not volumes[-1]:
        raise UnknownReach("the ranges of the angles are too small for a volume: record larger reaches")
    # change of the volume by one standard deviation of each input, m³, by name
    own = arm.arm

    def change(up: ReachArm, down: ReachArm, step: FloatArray) -> float:
        larger = compute_reachable_set(up, limits + step, _CHANGES)
        return 0.5 * (larger.volume - compute_reachable_set(down, limits - step, _CHANGES).volume)

    effects = {}
    for k, name in enumerate(ANGLES):
        sds = ranges[name].low_sd, ranges[name].high_sd, ranges[name].constant_sd
        for side, columns, sd in zip(("low", "high", "both"), ([0], [1], [0, 1]), sds, strict=True):
            if (name, side) == ("shoulder_plane", "both"):
                continue
            step = np.zeros((4, 2))
            step[k, columns] = sd
            # elevations and ranges stay valid
            step[1] = np.minimum(step[1], [max(limits[1, 0], 0.0), max(np.pi - limits[1, 1], 0.0)])
            step = np.minimum(step, 0.5 * (limits[:, 1:] - limits[:, :1]))
            effects[f"{name}_{side}"] = change(own, own, step)
    longer = own.elbow * (1 + arm.upper_arm_sd / float(np.linalg.norm(own.elbow)))
    pairs = {
        "upper_arm": (replace(own, elbow=longer), replace(own, elbow=2 * own.elbow - longer)),
        "forearm": tuple(replace(own, forearm=own.forearm + s * arm.forearm_sd) for s in (1, -1)),
        "rise": tuple(replace(own, rise=own.rise + s * arm.rise_sd) for s in (1, -1)),
    }
    effects |= {name: change(up, down, np.zeros((4, 2))) for name, (up, down) in pairs.items()}
    sd = float(np.sqrt(sum(effect**2 for effect in effects.values())))
    visited = None
    if region is not None:
        visited_volumes = _refine(arm.arm, *region)
        visited = _describe_volume(visited_volumes, visited_volumes[-1] * sd / volumes[-1])
    sources = {name: (effect / sd) ** 2 if sd else 0.0 for name, effect in effects.items()}
    return _describe_volume(volumes, sd), visited, sd, sources


def _describe_volume(volumes: list[float], sd: float) -> dict[str, Any]:
    """Return the facts of the last one of ``volumes`` with finer and finer grids, m³."""
    volume, change = volumes[-1], abs(volumes[-1] - volumes[-2])
    half = NORMAL_95 * sd + change
    return {
        "volume_m3": volume,
        "interval_m3": [max(volume - half, 0.0), volume + half],
        "discretisation_m3": change,
        "convergence_m3": volumes,
    }


def _refine(arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None) -> list[float]:
    """Return the volumes with finer and finer grids, at least two, m³."""
    grid, enough = (_BOX, _ENOUGH[0]) if planes is None else (_REGION, _ENOUGH[1])
    volumes = [compute_reachable_set(arm, limits, grid, planes).volume]
    while len(volumes) < _MOST_GRIDS:
        distances, polar, turns = (int(np.ceil(1.5 * each)) for each in grid)
        grid = distances, polar, turns
        volumes.append(compute_reachable_set(arm, limits, grid, planes).volume)
        if abs(volumes[-1] - volumes[-2]) <= enough * volumes[-1]:
            break
    return volumes
