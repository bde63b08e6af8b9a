"""Share of the load on the left and right foot, if each stands on its own force plate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import Repetition

PHASES = ("seated", "rising", "standing")
_APART_M = 0.05  # with centres of pressure closer than this, the plates are not side by side


@dataclass(frozen=True)
class LoadShare:
    """Share of the feet's load on the left foot.

    Parameters
    ----------
    left_plate, right_plate : int or None
        Plate numbers, from 1.
    phases : dict of str to (R,) array
        Mean share in each repetition while seated (before the rise), rising (start to stand) and standing; NaN where
        unknown.
    why : str or None
        Why the shares are unknown.
    """

    left_plate: int | None
    right_plate: int | None
    phases: dict[str, FloatArray]
    why: str | None = None


def sides(across: Sequence[tuple[int, float]], forwards: int) -> tuple[int, int] | str:
    """Return the plates under the left and the right foot, or why they are unknown.

    Parameters
    ----------
    across : sequence of (int, float)
        Number of every plate under the feet, and the z coordinate of its load in the plane frame, m.
    forwards : {-1, 1}
        Sign of the plane frame's x axis in front of the subject. With y up, z is to the left if the subject faces -x.
    """
    if len(across) != 2:
        return f"left and right need one plate under each foot, but the feet are on {len(across)}"
    (one, z_one), (other, z_other) = across
    if not abs(z_one - z_other) > _APART_M:  # also where one is unknown
        return f"plates {one} and {other} are not loaded side by side, so they do not carry one foot each"
    return (one, other) if (z_one > z_other) == (forwards < 0) else (other, one)


def load_share(
    time: FloatArray,
    posture: Posture,
    left: FloatArray,
    right: FloatArray,
    repetitions: tuple[Repetition, ...],
) -> dict[str, FloatArray]:
    """Return the mean share of the left foot in each phase, one (R,) array per phase.

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
    """Return the end of the seated phase, s: seat-off, or the start of the rise if seat-off is unknown."""
    return repetition.start if np.isnan(repetition.seat_off) else repetition.seat_off


def _until(repetition: Repetition, after: float) -> float:
    """Return the latest possible end of standing, s; for a squat, the start of the next repetition."""
    if repetition.end > repetition.stand:
        return repetition.end
    return after if not np.isnan(after) else np.inf
