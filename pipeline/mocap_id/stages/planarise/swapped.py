"""What planarise does about markers that exchange their labels: tells, and repairs where it is asked to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics import Swap, find_swaps, repair
from mocap_id.verdict import Reason

_TOLD = 5  # swaps that the message spells out; all of them are facts


@dataclass(frozen=True)
class Checked:
    """Trajectories after the check.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab, m; exchanged back where that was asked for.
    facts : list of dict
        Every swap: labels, first and last frame (the file's numbers), their times, whether it was repaired.
    reasons : tuple of Reason
    """

    positions: FloatArray
    facts: list[dict[str, Any]]
    reasons: tuple[Reason, ...]


def check(
    positions: FloatArray, labels: Sequence[str], frames: IntArray, time: FloatArray, *, rate: float, repairing: bool
) -> Checked:
    """Find the swaps and, if ``repairing``, undo them.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab, m; NaN where unseen.
    labels : sequence of str, length M
    frames : (F,) int array
        The file's frame numbers.
    time : (F,) array
        s.
    rate : float
        Frames per second.
    repairing : bool
    """
    swaps = find_swaps(positions, rate)
    facts = [_fact(swap, labels, frames, time, repairing) for swap in swaps]
    if not swaps:
        return Checked(positions, facts, ())
    return Checked(repair(positions, swaps) if repairing else positions, facts, (_reason(facts, repairing),))


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
    told = "; ".join(
        f"{fact['labels'][0]} and {fact['labels'][1]} in frames {fact['first_frame']} to {fact['last_frame']} "
        f"({fact['first_s']:.2f} to {fact['last_s']:.2f} s)"
        for fact in facts[:_TOLD]
    )
    rest = f"; and {len(facts) - _TOLD} more" if len(facts) > _TOLD else ""
    times = "once" if len(facts) == 1 else f"{len(facts)} times"
    outcome = (
        "These frames were exchanged back; the file is as it was."
        if repaired
        else "Nothing was changed: give `planarise: {repair_swaps: true}`, or relabel them and export the trial again."
    )
    return Reason(
        "marker-swap",
        f"two markers carry each other's label {times}: {told}{rest}. {outcome}",
        float(len(facts)),
        level="ok" if repaired else "caution",
    )
