"""Markers that swap their labels: report, and repair on request."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics import Swap, find_swaps, undo_swaps
from mocap_id.verdict import Reason

_LISTED = 5  # swaps listed in the message; the facts list all


@dataclass(frozen=True)
class SwapCheck:
    """Trajectories after the check for swaps.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab, m; repaired if requested.
    facts : list of dict
        Each swap: labels, first and last frame (numbers of the file), their times, whether it was repaired.
    reasons : tuple of Reason
    """

    positions: FloatArray
    facts: list[dict[str, Any]]
    reasons: tuple[Reason, ...]


def check(
    positions: FloatArray, labels: Sequence[str], frames: IntArray, time: FloatArray, *, rate: float, repairing: bool
) -> SwapCheck:
    """Find swapped labels and, if ``repairing``, correct them.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab, m; NaN where not visible.
    labels : sequence of str, length M
    frames : (F,) int array
        Frame numbers of the file.
    time : (F,) array
        s.
    rate : float
        Frames per second.
    repairing : bool
    """
    swaps = find_swaps(positions, rate)
    facts = [_fact(swap, labels, frames, time, repairing) for swap in swaps]
    if not swaps:
        return SwapCheck(positions, facts, ())
    return SwapCheck(undo_swaps(positions, swaps) if repairing else positions, facts, (_reason(facts, repairing),))


def _fact(swap: Swap, labels: Sequence[str], frames: IntArray, time: FloatArray, repaired: bool) -> dict[str, Any]:
    last = swap.stop - 1
    return {
        "labels": [labels[swap.first], labels[swap.second]],
        "first_frame": int(frames[swap.start]),
        "last_frame": int(frames[last]),
        "first_s": float(time[swap.start]),
        "last_s": float(time[last]),
        "repaired": repaired,
    }


def _reason(facts: Sequence[dict[str, Any]], repaired: bool) -> Reason:
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
        else "Both are left out of the skeleton in these frames. To use them there, set "
        "`planarise: {repair_swaps: true}`, or relabel them and export the trial again."
    )
    return Reason(
        "marker-swap",
        f"two markers have each other's label {times}: {listed}{rest}. {outcome}",
        float(len(facts)),
        level="ok" if repaired else "caution",
    )
