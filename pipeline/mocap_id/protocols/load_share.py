"""How left and right foot share the load, where each stands on a plate of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import Repetition

PHASES = ("seated", "rising", "standing")
_APART_M = 0.05  # feet whose centres of pressure are closer stand behind each other, or on the same side


@dataclass(frozen=True)
class LoadShare:
    """The left foot's share of the feet's load.

    Parameters
    ----------
    left_plate, right_plate : int or None
        Counted from 1.
    phases : dict of str to (R,) array
        For each of seated (touching the chair before the rise), rising (start to stand) and standing, the mean share in
        each repetition; NaN where unknown.
    why : str or None
        Why nothing is told.
    """

    left_plate: int | None
    right_plate: int | None
    phases: dict[str, FloatArray]
    why: str | None = None


def sides(across: Sequence[tuple[int, float]], forwards: int) -> tuple[int, int] | str:
    """Plates under the left and the right foot, or why that is not known.

    Parameters
    ----------
    across : sequence of (int, float)
        Of every plate under the feet its number and where it is loaded along the plane frame's z, m.
    forwards : {-1, 1}
        Sign of the plane frame's x in front of the subject: with y up, z is to the left of who faces -x.
    """
    if len(across) != 2:
        return f"left and right are told where each foot has a plate of its own; here the feet are on {len(across)}"
    (one, z_one), (other, z_other) = across
    if not abs(z_one - z_other) > _APART_M:  # also where one is unknown
        return f"plates {one} and {other} are not loaded side by side, so they are not one for each foot"
    return (one, other) if (z_one > z_other) == (forwards < 0) else (other, one)


def load_share(
    time: FloatArray,
    posture: Posture,
    left: FloatArray,
    right: FloatArray,
    repetitions: tuple[Repetition, ...],
) -> dict[str, FloatArray]:
    """Mean share of the left foot in each phase of each repetition, (R,) each.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    left, right : (T,) arrays
        Vertical force under each foot, N; NaN where unknown.
    repetitions : tuple of Repetition
    """
    out = {phase: np.full(len(repetitions), np.nan) for phase in PHASES}
    before = -np.inf
    for k, each in enumerate(repetitions):
        after = repetitions[k + 1].start if k + 1 < len(repetitions) else np.inf
        with np.errstate(invalid="ignore"):
            parts: dict[str, BoolArray] = {
                "seated": (time > before) & (time < _released(each)) & (posture.height < 1.0 - STANDING),
                "rising": (time >= each.start) & (time <= each.stand),
                "standing": (time > each.stand) & (time < _until(each, after)) & (posture.height > STANDING),
            }
        for phase, part in parts.items():
            known = part & np.isfinite(left) & np.isfinite(right)
            total = float(left[known].sum() + right[known].sum())
            out[phase][k] = left[known].sum() / total if known.any() and total > 0 else np.nan
        before = each.seat_on if not np.isnan(each.seat_on) else each.end
    return out


def _released(repetition: Repetition) -> float:
    """When a repetition's seated phase is over, s; where no plate tells, when the rise begins."""
    return repetition.start if np.isnan(repetition.seat_off) else repetition.seat_off


def _until(repetition: Repetition, after: float) -> float:
    """When a repetition's standing is over at the latest, s; of a squat, when the next one begins."""
    if repetition.end > repetition.stand:
        return repetition.end
    return after if not np.isnan(after) else np.inf
