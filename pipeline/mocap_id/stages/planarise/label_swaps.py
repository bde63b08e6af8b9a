"""Markers that swap their labels: facts and reasons, and repair on request."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mocap_id.arrays import FloatArray
from mocap_id.kinematics import find_swaps, undo_swaps
from mocap_id.stages.planarise.used_part import UsedPart
from mocap_id.verdict import Reason

_LISTED = 5  # swaps listed in the message; the facts list all


def check_swaps(part: UsedPart, *, repair: bool) -> tuple[FloatArray, list[dict[str, Any]], tuple[Reason, ...]]:
    """Find swapped labels and, if ``repair``, correct them.

    Returns
    -------
    positions : (F, M, 3) array
        Positions in the lab, corrected if requested, m.
    facts : list of dict
        Each swap: labels, first and last frame (numbers of the file), their times, whether it was corrected.
    reasons : tuple of Reason
    """
    swaps = find_swaps(part.positions, part.source.rate)
    if not swaps:
        return part.positions, [], ()
    facts = [
        {
            "labels": [part.labels[swap.first], part.labels[swap.second]],
            "first_frame": int(part.frames[swap.start]),
            "last_frame": int(part.frames[swap.stop - 1]),
            "first_s": float(part.time[swap.start]),
            "last_s": float(part.time[swap.stop - 1]),
            "repaired": repair,
        }
        for swap in swaps
    ]
    positions = undo_swaps(part.positions, swaps) if repair else part.positions
    return positions, facts, (_describe_swaps(facts, repair),)


def _describe_swaps(facts: Sequence[dict[str, Any]], repaired: bool) -> Reason:
    listed = "; ".join(
        f"{fact['labels'][0]} and {fact['labels'][1]} in frames {fact['first_frame']} to {fact['last_frame']} "
        f"({fact['first_s']:.2f} to {fact['last_s']:.2f} s)"
        for fact in facts[:_LISTED]
    )
    rest = f"; and {len(facts) - _LISTED} more" if len(facts) > _LISTED else ""
    times = "once" if len(facts) == 1 else f"{len(facts)} times"
    outcome = (
        "These frames were corrected in the results; the file was not changed."
        if repaired
        else "Both markers are left out of the skeleton in these frames. To use them there, set "
        "`planarise: {repair_swaps: true}`, or relabel them and export the trial again."
    )
    return Reason(
        "marker-swap",
        f"two markers have each other's label {times}: {listed}{rest}. {outcome}",
        float(len(facts)),
        level="ok" if repaired else "caution",
    )
