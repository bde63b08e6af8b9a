"""Repetition of a movement, with its events."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Repetition:
    """Events of one repetition, s on the clock of the recording; NaN if there is no such event.

    Parameters
    ----------
    start : float
        Start of the rise; for a squat, of the descent; for a robot, of the cycle.
    seat_off : float
        Release of the chair.
    stand : float
        Upright standing is reached.
    seat_on : float
        The chair is touched again.
    end : float
        Seated rest is reached; for a squat, standing; for a robot, the end of the cycle.
    complete : bool
        Whether every event of the protocol was found.
    why : str
        What is missing; empty if nothing is.
    """

    start: float
    seat_off: float
    stand: float
    seat_on: float
    end: float
    complete: bool
    why: str = ""
