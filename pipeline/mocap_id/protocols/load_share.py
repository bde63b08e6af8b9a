"""Share of the left foot in the load of both feet, if each foot is on its own force plate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import Repetition
from mocap_id.results import Result

LOAD_PHASES = ("seated", "rising", "standing")
_APART_M = 0.05  # if the centres of pressure are closer, the plates are not side by side


class Spread(Result):
    """Mean and standard deviation of a quantity over the repetitions."""

    mean: float | None = None
    sd: float | None = None


class LoadShare(Result):
    """Share of the left foot in the load of both feet, by phase; unknown unless each foot has its own plate."""

    left_plate: int | None = None  # numbers of the plates, from 1
    right_plate: int | None = None
    left: dict[str, Spread] = Field({phase: Spread() for phase in LOAD_PHASES})
    why: str | None = None  # why the shares are unknown; None if they are known


def find_foot_plates(across: Sequence[tuple[int, float]], forwards: int) -> tuple[int, int] | str:
    """Return the numbers of the plates under left and right foot, or a text that says why they are unknown.

    Parameters
    ----------
    across : sequence of (int, float)
        Number of every plate under the feet, and the z coordinate of its load in the plane's axes, m.
    forwards : {-1, 1}
        1 if the person faces x in the plane's axes, -1 if the person faces -x and z points to the left of the person.
    """
    if len(across) != 2:
        return f"left and right need one plate under each foot, but the feet are on {len(across)} plates"
    (one, z_one), (other, z_other) = across
    if not abs(z_one - z_other) > _APART_M:  # also where one is unknown
        return f"plates {one} and {other} are not loaded side by side, so they do not carry one foot each"
    return (one, other) if (z_one > z_other) == (forwards < 0) else (other, one)


def compute_load_share(
    time: FloatArray, posture: Posture, left: FloatArray, right: FloatArray, repetitions: tuple[Repetition, ...]
) -> dict[str, FloatArray]:
    """Return the mean share of the left foot in the load, by phase in :data:`LOAD_PHASES`, (R,) for the R repetitions.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    left, right : (T,) arrays
        Vertical force under each foot, N; NaN where unknown.
    """
    out = {phase: np.full(len(repetitions), np.nan) for phase in LOAD_PHASES}
    before = -np.inf
    for k, each in enumerate(repetitions):
        after = repetitions[k + 1].start if k + 1 < len(repetitions) else np.inf
        seated_until = each.start if np.isnan(each.seat_off) else each.seat_off
        standing_until = each.end if each.end > each.stand else np.inf if np.isnan(after) else after
        with np.errstate(invalid="ignore"):
            parts: dict[str, BoolArray] = {
                "seated": (time > before) & (time < seated_until) & (posture.height < 1.0 - STANDING),
                "rising": (time >= each.start) & (time <= each.stand),
                "standing": (time > each.stand) & (time < standing_until) & (posture.height > STANDING),
            }
        for phase, part in parts.items():
            known = part & np.isfinite(left) & np.isfinite(right)
            total = float(left[known].sum() + right[known].sum())
            out[phase][k] = left[known].sum() / total if known.any() and total > 0 else np.nan
        before = each.seat_on if not np.isnan(each.seat_on) else each.end
    return out
