"""A repetition of a movement and its events."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Repetition:
    """One repetition; times in s on the recording's clock, NaN where there is no such event.

    Parameters
    ----------
    start : float
        The rise begins; of a squat, the descent.
    seat_off : float
        The chair is released.
    stand : float
        Upright.
    seat_on : float
        The chair is touched again.
    end : float
        Seated; of a squat, upright again; of a robot's cycle, its end.
    complete : bool
        Every event of the protocol was found.
    why : str
        What is missing, or empty.
    """

    start: float
    seat_off: float
    stand: float
    seat_on: float
    end: float
    complete: bool
    why: str = ""
