"""Times of the five-times-sit-to-stand test, by both common stop rules, for whatever number of repetitions there is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.protocols.posture import STANDING
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.rise import Rise

ASKED = 5


@dataclass(frozen=True)
class FiveTimes:
    """The test's times, s; None where one cannot be told, and ``why``.

    Parameters
    ----------
    repetitions : int
        Rises that come to standing.
    to_fifth_stand, to_fifth_seat_contact, to_fifth_seated : float or None
        From the start of the first rise until the fifth stand; until the chair is touched after it; until the person
        sits at rest after it. A stopwatch runs from the command, and so adds the reaction time.
    mean_cycle, cycle_sd : float or None
        From one stand to the next, over all repetitions.
    attempts : int
        Failed ones within the time to the fifth stand.
    why : str or None
    """

    repetitions: int
    to_fifth_stand: float | None = None
    to_fifth_seat_contact: float | None = None
    to_fifth_seated: float | None = None
    mean_cycle: float | None = None
    cycle_sd: float | None = None
    attempts: int = 0
    why: str | None = None


def five_times(repetitions: tuple[Repetition, ...], rises: tuple[Rise, ...], *, chair: bool | None) -> FiveTimes:
    """Time the test.

    Parameters
    ----------
    repetitions : tuple of Repetition
    rises : tuple of Rise
        Their details; a rise that does not come to standing is not counted.
    chair : bool or None
        A chair is used; squats (False) are no such test.
    """
    if chair is False:
        return FiveTimes(0, why="no chair is used: squats are no sit-to-stands")
    counted = [
        k
        for k, (each, rise) in enumerate(zip(repetitions, rises, strict=True))
        if not np.isnan(each.stand) and not rise.reached < STANDING
    ]
    stands = np.array([repetitions[k].stand for k in counted])
    cycles = np.diff(stands)
    cycle = float(cycles.mean()) if len(cycles) else None
    spread = float(cycles.std(ddof=1)) if len(cycles) > 1 else None
    if len(counted) < ASKED:
        why = f"{len(counted)} of {ASKED} rises come to standing in the recording"
        return FiveTimes(len(counted), mean_cycle=cycle, cycle_sd=spread, why=why)
    first, fifth = counted[0], counted[ASKED - 1]
    start, last = repetitions[first].start, repetitions[fifth]
    events = (last.stand, last.seat_on, last.end)
    stand, contact, seated = (None if np.isnan(event - start) else float(event - start) for event in events)
    return FiveTimes(
        len(counted),
        stand,
        contact,
        seated,
        mean_cycle=cycle,
        cycle_sd=spread,
        attempts=sum(rises[k].attempts for k in range(first + 1, fifth + 1)),
        why=_why(repetitions[first], last),
    )


def _why(first: Repetition, fifth: Repetition) -> str | None:
    """What is missing for the times; None where nothing is."""
    if np.isnan(first.start):
        return f"the start of the first rise is not known: {first.why or 'its angles are not'}"
    if np.isnan([fifth.seat_on, fifth.end]).any():
        return f"the end of the fifth repetition is not known: {fifth.why or 'its angles are not'}"
    return None
