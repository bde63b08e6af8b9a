"""Geometry of a recorded arm: positions of shoulder, elbow and wrist from the poses of its segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.protocols.reach.reachable_set import ReachArm
from mocap_id.store.spatial_views import SegmentPoses, SpatialAngles, SpatialSkeleton

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
    angles: SpatialAngles, poses: SegmentPoses, skeleton: SpatialSkeleton, stature: float | None = None
) -> RecordedArm:
    """Compute the dimensions of an arm and the path of its hand from a recording.

    The wrist is the projection of its joint centre onto the forearm's y axis, because axial rotation of the forearm
    does not move this point.

    Parameters
    ----------
    poses : SegmentPoses
        Poses of the segments in their anatomical axes.
    stature : float, optional
        Stature, m; by default estimated from the arm's length.

    Raises
    ------
    UnknownReach
        A segment, an angle, the shoulder centre or the wrist is missing, or the chain is not an arm.
    """
    _check_segments(angles, poses, skeleton)
    thorax, upper, lower = (poses.segments.index(name) for name in SEGMENTS)
    centres = _express_in_segment(poses, thorax, poses.origin[:, upper])
    elevation = angles.mean[:, angles.names.index("shoulder_elevation"), 0]
    shoulder, glide, glide_known = _fit_glide(
        np.where(poses.find_measured(*SEGMENTS[:2])[:, None], centres, np.nan), elevation
    )
    elbow = _find_median(_express_in_segment(poses, upper, poses.origin[:, lower]), "upper arm and forearm")
    wrist, forearm_sd = _locate_wrist(poses, skeleton)
    along = np.array([0.0, -wrist, 0.0])
    length = float(np.linalg.norm(elbow)) + wrist
    _check_arm(centres, float(np.linalg.norm(elbow)), wrist)
    stature = stature or _HEIGHT * length
    palm = np.array([0.0, -_PALM * stature, 0.0])
    turn = np.swapaxes(poses.rotation[:, thorax], 1, 2)
    elbows = np.einsum("tij,tjk,k->ti", turn, poses.rotation[:, upper], elbow)
    wrists = elbows + np.einsum("tij,tjk,k->ti", turn, poses.rotation[:, lower], along)
    if not np.isfinite(wrists).all(axis=1).any():
        raise UnknownReach("no frame has markers of the whole arm")
    hand = poses.rotation[:, poses.segments.index("hand") if "hand" in poses.segments else lower]
    seen = np.isfinite(hand) & poses.find_measured("hand")[:, None, None]
    hand = np.where(seen, hand, poses.rotation[:, lower])
    return RecordedArm(
        arm=ReachArm(elbow, wrist, _fit_carrying(poses.rotation[:, upper], poses.rotation[:, lower]), float(glide[1])),
        upper_arm_sd=_length_sd(skeleton, "upper_arm"),
        forearm_sd=forearm_sd,
        rise_sd=_find_rise_sd(skeleton) if glide_known else _RISE_SD,
        shoulder=shoulder,
        glide=glide,
        elbows=elbows,
        wrists=wrists,
        palms=wrists + np.einsum("tij,tjk,k->ti", turn, hand, palm),
        measured=poses.find_measured(*SEGMENTS),
        stature=stature,
    )


def _check_segments(angles: SpatialAngles, poses: SegmentPoses, skeleton: SpatialSkeleton) -> None:
    """Raise UnknownReach if the chain lacks a segment, angle or joint centre of an arm."""
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


def _find_median(points: FloatArray, segments: str) -> FloatArray:
    """Return the median (3,) of the known points (T, 3); ``segments`` names the segments in the error message."""
    known = np.isfinite(points).all(axis=1)
    if not known.any():
        raise UnknownReach(f"no frame has markers of both {segments}")
    return np.asarray(np.median(points[known], axis=0))


def _check_arm(centres: FloatArray, upper: float, lower: float) -> None:
    """Raise UnknownReach if the chain between thorax and wrist cannot be an arm."""
    travel = float(np.nanmax(np.nanquantile(centres, 0.99, axis=0) - np.nanquantile(centres, 0.01, axis=0)))
    hint = "the segments may be wrong: set `segment: {count: …}` or `together`"
    if travel > _TRAVEL:
        raise UnknownReach(
            f"the centre of the shoulder moves by {travel:.2f} m in the thorax, expected at most {_TRAVEL} m; {hint}"
        )
    if not _PROPORTION[0] * lower <= upper <= _PROPORTION[1] * lower:
        raise UnknownReach(
            f"the elbow is {upper:.3f} m from the shoulder and the wrist {lower:.3f} m along the forearm, expected a "
            f"ratio of {_PROPORTION[0]} to {_PROPORTION[1]}; {hint}"
        )


def _express_in_segment(poses: SegmentPoses, segment: int, points: FloatArray) -> FloatArray:
    """Return points (T, 3), given in the trial's axes, in the axes of a segment."""
    return np.asarray(np.einsum("tji,tj->ti", poses.rotation[:, segment], points - poses.origin[:, segment]))


def _locate_wrist(poses: SegmentPoses, skeleton: SpatialSkeleton) -> tuple[float, float]:
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


def _fit_glide(centres: FloatArray, elevation: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return the shoulder centre at the lowest elevation, its glide from 0 to 180°, m, and whether that is known."""
    share = (1 - np.cos(elevation)) / 2
    known = np.isfinite(centres).all(axis=1) & np.isfinite(share)
    if not known.any():
        raise UnknownReach("no frame has markers of both thorax and upper arm")
    share, centres = share[known], centres[known]
    if np.ptp(share) < _RAISED or np.ptp(centres, axis=0).max() < 1e-6:
        return np.asarray(centres.mean(axis=0)), np.zeros(3), False
    design = np.stack([np.ones(len(share)), share], axis=1)
    fit = np.linalg.lstsq(design, centres, rcond=None)[0]
    return np.asarray(fit[0] + share.min() * fit[1]), np.asarray(fit[1]), True


def _find_rise_sd(skeleton: SpatialSkeleton) -> float:
    """Return the standard deviation of the shoulder's rise, m; 8 mm if unknown."""
    joint = skeleton.chain.joints[skeleton.segments.index("upper_arm") - 1]
    variance = float(joint.glide_covariance[1, 1])
    return float(np.sqrt(variance)) if variance > 0 else _RISE_SD


def _fit_carrying(upper: FloatArray, forearm: FloatArray) -> FloatArray:
    """Fit c0, c1, c2 of the carrying angle c0 + c1 cos(flexion) + c2 sin(flexion), rad, to rotations (T, 3, 3)."""
    elbow = np.swapaxes(upper, 1, 2) @ forearm
    known = np.isfinite(elbow).all(axis=(1, 2))
    flexion = np.unwrap(np.arctan2(-elbow[known, 0, 1], elbow[known, 1, 1]))
    carrying = np.arcsin(np.clip(elbow[known, 2, 1], -1, 1))
    if np.ptp(flexion) < 0.5:
        return np.array([float(np.median(carrying)), 0.0, 0.0])
    design = np.stack([np.ones(len(flexion)), np.cos(flexion), np.sin(flexion)], axis=1)
    return np.asarray(np.linalg.lstsq(design, carrying, rcond=None)[0])
