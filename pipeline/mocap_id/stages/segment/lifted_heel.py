"""Feet that turn about the toes: the foot as a moving segment, or a caution that the base of the chain moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mocap_id.errors import Refused
from mocap_id.kinematics import Segmentation
from mocap_id.stages.segment.bad_markers import SegmentedMarkers
from mocap_id.verdict import Reason


def lift_of_good_markers(lift: Mapping[str, Any] | None, bad: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the fact ``heel_lift`` of planar.parquet, or None if one of its markers is ``bad`` for some time."""
    if lift is None or {each["marker"] for each in bad} & {lift["marker"], lift["about"]}:
        return None
    return lift


_SURE = 0.5  # least confidence of a chain with the foot
_FEWEST = 5  # ground, foot, shank, thigh and torso


def foot_moves(lift: Mapping[str, Any] | None, labels: Sequence[str], found: Segmentation) -> bool:
    """Return whether the first moving segment is the foot, given the fact ``heel_lift`` of planar.parquet.

    Of the two markers that show the lift, at most one is on the shank, near the ankle. If the foot is in the base,
    so is the other one.
    """
    if lift is None or found.count < _FEWEST:
        return False
    segments = {int(found.segment[labels.index(lift[which])]) for which in ("marker", "about")}
    return segments in ({1}, {1, 2})


def with_foot(
    done: SegmentedMarkers,
    lift: Mapping[str, Any] | None,
    labels: Sequence[str],
    longer: Callable[[int], SegmentedMarkers],
) -> SegmentedMarkers:
    """Return the segmentation with one more segment if this is clearly a foot that lifts, else the given one.

    Parameters
    ----------
    done : SegmentedMarkers
    lift : mapping or None
        The fact ``heel_lift`` of planar.parquet.
    labels : sequence of str
    longer : callable
        Return the segmentation into a number of segments.
    """
    if lift is None or foot_moves(lift, labels, done.found):
        return done
    try:
        other = longer(done.found.count + 1)
    except Refused:
        return done
    sure = other.found.confidence.value >= _SURE
    return other if sure and foot_moves(lift, labels, other.found) else done


def lift_reasons(lift: Mapping[str, Any] | None, *, moves: bool) -> tuple[Reason, ...]:
    """Return what a lift of the heels means for the chain: a note if the foot ``moves`` in it, else a caution."""
    if lift is None:
        return ()
    seen = (
        f"a foot turns by {lift['turn_deg']:.0f}° and {lift['marker']} rises by {100 * lift['height_m']:.1f} cm, "
        f"first at {lift['time_s']:.1f} s"
    )
    if moves:
        text = f"{seen}: the foot is a segment of the chain, which turns about the toes on the ground"
        return (Reason("heel-lifts", text, float(lift["turn_deg"]), level="ok"),)
    text = (
        f"{seen}: the base of the chain moves, and the ankle with it, but the markers show no segment of the foot's "
        "own. The ankle's torque is wrong by the weight on the feet times this displacement; angles of knee and "
        "hip may be wrong by some degrees. Record again with the heels on the ground, for example from a higher chair"
    )
    return (Reason("heel-lifts", text, float(lift["turn_deg"])),)
