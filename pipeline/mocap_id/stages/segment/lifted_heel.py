"""Feet that rotate about the toes: the foot becomes a moving segment, or a caution says that the base moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mocap_id.errors import Refused
from mocap_id.kinematics import Segmentation
from mocap_id.stages.segment.bad_markers import SegmentedMarkers
from mocap_id.verdict import Reason

_SURE = 0.5  # smallest confidence of a chain with the foot
_FEWEST = 5  # smallest number of segments: ground, foot, shank, thigh and torso


def check_lift(lift: Mapping[str, Any] | None, bad: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the fact ``lift`` unchanged, or None if one of its markers has one of the stretches ``bad``."""
    if lift is None or {each["marker"] for each in bad} & {lift["marker"], lift["about"]}:
        return None
    return lift


def is_foot_a_segment(lift: Mapping[str, Any] | None, labels: Sequence[str], found: Segmentation) -> bool:
    """Return whether the first moving segment is the foot, decided by the two markers of the fact ``heel_lift``.

    At least one of these markers must be on the first segment; the other one may be on the next, near the ankle.
    """
    if lift is None or found.count < _FEWEST:
        return False
    segments = {int(found.segment[labels.index(lift[which])]) for which in ("marker", "about")}
    return segments in ({1}, {1, 2})


def add_foot(
    done: SegmentedMarkers,
    lift: Mapping[str, Any] | None,
    labels: Sequence[str],
    segment: Callable[[int], SegmentedMarkers],
) -> SegmentedMarkers:
    """Return the segments with the foot as an additional segment; unchanged if it is not certain that the foot rotates.

    Parameters
    ----------
    lift : mapping or None
        Fact ``heel_lift`` of planar.parquet.
    labels : sequence of str
        Labels of the markers.
    segment : callable
        Function that segments the markers into a given number of segments.
    """
    if lift is None or is_foot_a_segment(lift, labels, done.found):
        return done
    try:
        other = segment(done.found.count + 1)
    except Refused:
        return done
    sure = other.found.confidence.value >= _SURE
    return other if sure and is_foot_a_segment(lift, labels, other.found) else done


def explain_lift(lift: Mapping[str, Any] | None, *, moves: bool) -> tuple[Reason, ...]:
    """Return a note about a lift of the heels if the foot is a segment (``moves``), or else a caution."""
    if lift is None:
        return ()
    observation = (
        f"a foot rotates by {lift['turn_deg']:.0f}° and {lift['marker']} rises by {100 * lift['height_m']:.1f} cm, "
        f"first at {lift['time_s']:.1f} s"
    )
    if moves:
        text = f"{observation}: the foot is a segment of the chain, which rotates about the toes on the ground"
        return (Reason("heel-lifts", text, float(lift["turn_deg"]), level="ok"),)
    text = (
        f"{observation}: the base of the chain and the ankle move, but there are too few markers to make the foot a "
        "segment. The ankle's torque is wrong by the weight on the feet times this displacement; angles of knee and "
        "hip may be wrong by some degrees. Record again with the heels on the ground, for example from a higher chair"
    )
    return (Reason("heel-lifts", text, float(lift["turn_deg"])),)
