"""Times of the five-times-sit-to-stand test by both common stop rules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.protocols.posture import STANDING
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.rise_details import RiseDetails

REQUIRED_RISES = 5


@dataclass(frozen=True)
class FiveTimes:
    """Times of the test, s; None if unknown.

    Parameters
    ----------
    repetitions : int
        Number of rises that reach standing.
    to_fifth_stand, to_fifth_seat_contact, to_fifth_seated : float or None
        Time from the start of the first rise to the fifth stand, to the next seat contact, and to the next seated
        rest. A stopwatch starts at the command, and so adds the reaction time.
    mean_cycle, cycle_sd : float or None
        Mean and standard deviation of the time from one stand to the next, over all repetitions.
    attempts : int
        Number of failed attempts before the fifth stand.
    why : str or None
        Why a time is unknown.
    """

    repetitions: int
    to_fifth_stand: float | None = None
    to_fifth_seat_contact: float | None = None
    to_fifth_seated: float | None = None
    mean_cycle: float | None = None
    cycle_sd: float | None = None
    attempts: int = 0
    why: str | None = None


def five_times(repetitions: tuple[Repetition, ...], rises: tuple[RiseDetails, ...], *, chair: bool | None) -> FiveTimes:
    """Compute the times of the test.

    Parameters
    ----------
    repetitions : tuple of Repetition
    rises : tuple of RiseDetails
        Their details; a rise that does not reach standing is not counted.
    chair : bool or None
        Whether a chair is used; squats (False) have no test times.
    """
    if chair is False:
        return FiveTimes(0, why="no chair is used, so the rises are squats and not sit-to-stands")
    counted = [
        k
        for k, (each, rise) in enumerate(zip(repetitions, rises, strict=True))
        if not np.isnan(each.stand) and not rise.reached < STANDING
    ]
    stands = np.array([repetitions[k].stand for k in counted])
    cycles = np.diff(stands)
    cycle = float(cycles.mean()) if len(cycles) else None
    spread = float(cycles.std(ddof=1)) if len(cycles) > 1 else None
    if len(counted) < REQUIRED_RISES:
        why = f"only {len(counted)} of {REQUIRED_RISES} rises in the recording reach standing"
        return FiveTimes(len(counted), mean_cycle=cycle, cycle_sd=spread, why=why)
    first, fifth = counted[0], counted[REQUIRED_RISES - 1]
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
    if np.isnan(first.start):
        return f"the start of the first rise is unknown: {first.why or 'its angles are unknown'}"
    if np.isnan([fifth.seat_on, fifth.end]).any():
        return f"the end of the fifth repetition is unknown: {fifth.why or 'its angles are unknown'}"
    return None
