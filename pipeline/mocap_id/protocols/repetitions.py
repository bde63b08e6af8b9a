"""Repetition of a movement in the plane, with its events."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Repetition:
    """Events of one repetition, s on the clock of the recording; NaN if an event was not found."""

    start: float  # start of the rise; for a squat, start of the descent; for a robot, start of the cycle
    seat_off: float  # time at which the person leaves the chair
    stand: float  # time at which the person stands
    seat_on: float  # time at which the person touches the chair again
    end: float  # time at which the person sits at rest; for a squat, stands again; for a robot, end of the cycle
    complete: bool  # whether every event of the protocol was found
    why: str = ""  # missing events and their causes; empty if the repetition is complete
