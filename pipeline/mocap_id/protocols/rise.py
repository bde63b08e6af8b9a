"""What is told of a repetition beyond its events."""

from __future__ import annotations

from dataclasses import dataclass

NAN = float("nan")


@dataclass(frozen=True)
class Rise:
    """Details of a sit-to-stand or squat; NaN where something does not apply or is not known.

    Parameters
    ----------
    seat_off_72, seat_off_model : float
        Seat-off by the thesis's two rules (:mod:`mocap_id.protocols.seat_off`), s.
    reached : float
        Greatest height, of the trial's rise from seat to standing.
    held : float
        Time in pauses between seat and standing, s.
    attempts : int
        Failed ones before this rise.
    support : float
        Unexplained vertical support (:mod:`mocap_id.protocols.support`), of the standing weight.
    left_seated, left_rising, left_standing : float
        Share of the left foot in the feet's load: seated before the rise, from start to stand, standing after it.
    """

    seat_off_72: float = NAN
    seat_off_model: float = NAN
    reached: float = NAN
    held: float = NAN
    attempts: int = 0
    support: float = NAN
    left_seated: float = NAN
    left_rising: float = NAN
    left_standing: float = NAN
