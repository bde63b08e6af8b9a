"""Checks whether landmarks form a possible arm, to find exchanged names, a wrong vertical axis or a wrong unit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from mocap_id.anatomy.frames import THORAX
from mocap_id.anatomy.segment_frames import AnatomicalFrames, SegmentPoses
from mocap_id.anatomy.still_pose import LandmarkPosition
from mocap_id.arrays import FloatArray
from mocap_id.kinematics.space.chain_result import SpatialFit
from mocap_id.verdict import Reason

_ABOVE = (("IJ", "PX"), ("C7", "T8"))
"""Pairs of landmarks of the thorax; the first landmark of a pair is above the second."""
_BELOW = 0.05  # m, limit of the height difference, which is small in a person who lies
_OUT_OF_PLANE = 0.025  # m, largest rms distance of the thorax's landmarks from the plane through them
_BESIDE = 0.05  # m, largest distance of the midpoint of two landmarks from the joint centre found from the motion
_SURE = 0.02  # m; the distance has less weight in directions with a larger standard deviation
_ACROSS = 45.0  # degrees, largest angle between the line through the epicondyles and the axis found from the motion
_LENGTHS = {"upper_arm": (0.15, 0.45), "forearm": (0.12, 0.40)}
"""Shortest and longest segments of children and adults, m."""
_NEXT = {"upper_arm": "forearm", "forearm": "hand"}
PAIRS = {"forearm": ("EL", "EM"), "hand": ("RS", "US")}
"""Landmarks on both sides of the joint before a segment."""


def check_landmarks(
    fit: SpatialFit,
    places: Mapping[str, LandmarkPosition],
    frames: AnatomicalFrames,
    where: Mapping[str, int],
    standing: SegmentPoses,
) -> tuple[Reason, ...]:
    """Return a caution that lists all contradictions with the anatomy of an arm; an empty tuple if there are none.

    ``standing`` are the poses of the segments in the still pose; their y axis points up.

    Parameters
    ----------
    fit : SpatialFit
        Fitted chain before its joint centres are moved to landmarks.
    places : mapping
        Landmarks in the axes of their segments, by name.
    where : mapping
        Number of each segment, by name.
    """
    at = {name: place.local for name, place in places.items()}
    doubts = [
        *_check_thorax(at, frames, where, standing, fit),
        *_check_joints(fit, at, where),
        *_check_segment_lengths(fit, where),
    ]
    return explain_implausible_arm(doubts)


def _check_thorax(
    at: Mapping[str, FloatArray],
    frames: AnatomicalFrames,
    where: Mapping[str, int],
    standing: SegmentPoses,
    fit: SpatialFit,
) -> Iterator[str]:
    """Yield a text for each contradiction of the landmarks of the thorax with its anatomy."""
    frame = frames.frames.get("thorax")
    if frame is None:
        return
    own = where["thorax"]
    for upper, lower in _ABOVE:
        below = float(standing.place(at[lower], own)[1] - standing.place(at[upper], own)[1])
        if below > _BELOW:
            yield f"at rest, {upper} is {1e3 * below:.0f} mm below {lower}"
    landmarks = np.array([at[name] for name in THORAX.up])
    off = float(np.linalg.svd(landmarks - landmarks.mean(axis=0), compute_uv=False)[-1]) / np.sqrt(len(landmarks))
    if off > _OUT_OF_PLANE:
        yield f"{', '.join(THORAX.up)} are {1e3 * off:.0f} mm out of one plane (rms)"
    joint = fit.chain.joints[where["upper_arm"] - 1] if "upper_arm" in where else None
    if joint is not None and joint.known and joint.parent == own:
        side = float((joint.centre - frame.origin) @ frame.rotation[:, 2])
        if side < 0:
            yield "the shoulder is on the other side of the thorax, as if IJ and C7 were exchanged"


def _check_joints(fit: SpatialFit, at: Mapping[str, FloatArray], where: Mapping[str, int]) -> Iterator[str]:
    """Yield a text for each contradiction of the landmarks with the joint centres and axes found from the motion."""
    for child, pair in PAIRS.items():
        if child not in where or where[child] == 0 or not all(name in at for name in pair):
            continue
        joint = fit.chain.joints[where[child] - 1]
        if not joint.known or not np.isfinite(joint.covariance).all():
            continue
        across = at[pair[0]] - at[pair[1]]
        off = joint.centre - (at[pair[0]] + at[pair[1]]) / 2
        away = float(np.sqrt(off @ np.linalg.solve(joint.covariance / _SURE**2 + np.eye(3), off)))
        if away > _BESIDE:
            yield f"the midpoint of {pair[0]} and {pair[1]} is {1e3 * away:.0f} mm from the centre of their joint"
        if child == "forearm" and joint.kind == "two-axis" and np.isfinite(joint.axes_covariance[0]).all():
            cosine = abs(float(across @ joint.first_axis)) / max(float(np.linalg.norm(across)), 1e-9)
            angle = float(np.degrees(np.arccos(min(cosine, 1.0))))
            if angle > _ACROSS:
                yield f"the line through EL and EM is {angle:.0f}° from the axis about which the elbow bends"


def _check_segment_lengths(fit: SpatialFit, where: Mapping[str, int]) -> list[str]:
    """Return a text for each segment of the fit with an impossible length."""
    lengths = {}
    for name, tip in _NEXT.items():
        joint = fit.chain.joints[where[tip] - 1] if where.get(tip, 0) else None
        if joint is not None and joint.known and joint.parent == where.get(name):
            lengths[name] = float(np.linalg.norm(joint.centre))
    return check_lengths(lengths)


def check_lengths(lengths: Mapping[str, float]) -> list[str]:
    """Return a text for each impossible length of upper arm or forearm; ``lengths`` are in m, by segment."""
    return [
        f"the {name.replace('_', ' ')} is {length:.3g} m long, expected {shortest:g} to {longest:g} m"
        for name, length in lengths.items()
        for shortest, longest in [_LENGTHS[name]]
        if not shortest <= length <= longest
    ]


def explain_implausible_arm(doubts: Sequence[str]) -> tuple[Reason, ...]:
    """Return a caution that lists the contradictions ``doubts`` with the anatomy of an arm; () if there are none."""
    if not doubts:
        return ()
    text = "Check the names of the landmarks, and the unit and the vertical axis of the recording; the angles are wrong"
    return (Reason("landmarks-implausible", f"{'; '.join(doubts)}. {text}", float(len(doubts)), 0.0),)
