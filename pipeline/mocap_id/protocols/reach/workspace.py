"""Geometry of a recorded arm, ranges of its angles, and its reachable volume with a 95 % interval (7.2).

The first kind is the box of the ranges of the four angles. The second is the visited region, in which the limits of an
angle depend on the other angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.protocols.reach.reachable_set import CellGrid, PlaneRange, ReachArm, VisitedRegion, compute_reachable_set
from mocap_id.store.views import MEANINGLESS_AT_POLE, MeasuredPoses, SpatialAngles, SpatialSkeleton

SEGMENTS = ("thorax", "upper_arm", "forearm")
ANGLES = ("shoulder_plane", "shoulder_elevation", "shoulder_axial", "elbow_flexion")
"""Angles that move the wrist, in the order of the limits of :func:`~.reachable_set.compute_reachable_set`."""

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

    @property
    def width_sd(self) -> float:
        """Standard deviation of the width of the range, rad.

        The errors of both ends are added, because a tilt of the thorax or sliding skin often moves the ends in
        opposite directions.
        """
        return self.low_sd + self.high_sd


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
_BOX, _REGION = CellGrid(12, 24, 16), CellGrid(8, 16, 32)
# CellGrid for the changes of the volume by one standard deviation; their error is a few per cent
_CHANGES = CellGrid(9, 18, 12)
_ENOUGH = 0.01, 0.02  # grids for the box and for a region are refined until the volume changes by less than this share
_MOST = 4  # largest number of grids


@dataclass(frozen=True)
class Volume:
    """A reachable volume, m³."""

    volume: float  # volume with the finest grid, m³
    discretisation: float  # change of the volume by the last refinement of the grid, m³
    interval: tuple[float, float]  # 95 % interval, m³
    convergence: tuple[float, ...]  # volumes with finer and finer grids, m³


@dataclass(frozen=True)
class Workspace:
    """Reachable volume within the box of the ranges, and within the visited region."""

    box: Volume  # volume within the box
    visited: Volume | None  # volume within the visited region; None without a region
    limits: FloatArray  # (4, 2) ends of the box: plane, elevation, axial rotation, flexion, rad
    sd: float  # standard deviation of the volume within the box, m³
    sources: dict[str, float]  # share of each range and dimension in the variance of this volume, by name

    def relative(self, arm: ReachArm) -> float:
        """Return the volume within the box as a share of a sphere with the arm's length as radius."""
        return self.box.volume / (4 / 3 * np.pi * arm.length**3)


def compute_workspace(arm: RecordedArm, ranges: Mapping[str, AngleRange], region: VisitedRegion | None) -> Workspace:
    """Return the reachable volume of an arm, its 95 % interval and the sources of its variance.

    The interval contains the errors of the ends of the ranges, of the lengths and of the shoulder's rise, the constant
    errors of the angles from the landmarks, and the error of the grid. A constant error of the plane is left out
    because it only rotates the set.

    ``ranges`` are those of the four angles of :data:`ANGLES`, by name; ``region`` is None if the motion has no visited
    region. Raises UnknownReach if the ranges are too small for a volume.
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
        visited_volumes = _refine(arm.arm, region.limits, region.planes)
        visited = _add_interval(visited_volumes, visited_volumes[-1] * sd / volumes[-1])
    return Workspace(
        box=_add_interval(volumes, sd),
        visited=visited,
        limits=limits,
        sd=sd,
        sources={name: (effect / sd) ** 2 if sd else 0.0 for name, effect in effects.items()},
    )


def _add_interval(volumes: tuple[float, ...], sd: float) -> Volume:
    volume, change = volumes[-1], abs(volumes[-1] - volumes[-2])
    half = NORMAL_95 * sd + change
    return Volume(volume, change, (max(volume - half, 0.0), volume + half), volumes)


def _refine(arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None) -> tuple[float, ...]:
    """Return the volumes with finer and finer grids, at least two, m³."""
    grid, enough = (_BOX, _ENOUGH[0]) if planes is None else (_REGION, _ENOUGH[1])
    volumes = [compute_reachable_set(arm, limits, grid, planes).volume]
    while len(volumes) < _MOST:
        grid = grid.refined()
        volumes.append(compute_reachable_set(arm, limits, grid, planes).volume)
        if abs(volumes[-1] - volumes[-2]) <= enough * volumes[-1]:
            break
    return tuple(volumes)
