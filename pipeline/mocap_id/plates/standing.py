"""What the force plates measure while the person stands: body mass, empty chair and drop-outs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.recording.marker_posture import find_upright, measure_body_height, shows_standing

ZeroRule: TypeAlias = Literal["standing", "none"]

GRAVITY = 9.81  # m/s^2

_STILL_M_S = 0.02
"""Largest vertical speed of a person who stands nearly still."""

_SPEED_OVER_S = 0.1
"""A speed is the difference between heights this time before and after a sample. A shorter time gives more noise."""

_MIN_TOTAL_S = 0.2

_MIN_MASS_KG = 2.0

_UNLOADED = 0.2
"""Fraction of the standing weight. An upright person always loads the plates more, except in a jump."""

_MIN_DROPOUT_S = 0.6
"""Minimum duration of a drop-out. The flight of a jump is always shorter."""


@dataclass(frozen=True)
class EmptyChairReading:
    """Reading of the plates under an empty chair, including the weight of the chair."""

    reading: FloatArray | None  # (3,) median (Fx, Fy, tauz), N and N·m; None if too few samples have an empty chair
    spread: FloatArray | None  # (3,) standard deviation of the samples of this median, N and N·m; None if not measured


def weigh_person(positions: FloatArray, rate: float, vertical: FloatArray) -> tuple[float | None, str | None]:
    """Return the mass of the person, kg, and None; or None and the reason why the mass cannot be estimated.

    ``vertical`` (F,) is the upward force under the feet, N. While the person stands still, this force is the weight. It
    does not distinguish standing from sitting, so the positions of the markers are also checked.
    """
    tall, _ = find_upright(positions)
    half = min(max(1, round(_SPEED_OVER_S * rate)), (len(positions) - 1) // 2)
    height = measure_body_height(positions)
    speed, stop = np.full(len(positions), np.nan), len(positions) - half
    speed[half:stop] = (height[2 * half :] - height[: stop - half]) * rate / max(2 * half, 1)
    with np.errstate(invalid="ignore"):
        still = tall & (np.abs(speed) < _STILL_M_S) & np.isfinite(vertical)
    if still.sum() < max(2, _MIN_TOTAL_S * rate):
        return None, "the person never stands still on the plates"
    if not shows_standing(positions, still):
        return None, (
            "it is not certain that the person stands: while the body is highest and still, the markers are spread as "
            "widely as on a seated person, or lie in a line; a chair may carry part of the weight"
        )
    mass = float(np.median(vertical[still])) / GRAVITY
    return (mass, None) if mass > _MIN_MASS_KG else (None, "the plates carry no weight while the person stands")


def find_dropouts(vertical: FloatArray, tall: BoolArray, rate: float, weight: float) -> BoolArray:
    """Return a mask (F,) of drop-outs: intervals in which the plates are unloaded although the person stands.

    ``vertical`` (F,) is the total upward force of the plates under the feet, and ``weight`` this force while the person
    stands, N. ``tall`` (F,) marks the samples in which the person is upright. A loose cable, for example, causes
    drop-outs.
    """
    with np.errstate(invalid="ignore"):
        unloaded = vertical < _UNLOADED * weight
    dropout = np.zeros(len(vertical), bool)
    for run in find_runs(unloaded):
        dropout[run] = tall[run].sum() >= _MIN_DROPOUT_S * rate
    return dropout


def measure_empty_chair(
    wrench: FloatArray, ok: BoolArray, positions: FloatArray, rate: float, rule: ZeroRule
) -> EmptyChairReading:
    """Measure the reading of the plates under the empty chair, to be subtracted from the wrench of the chair.

    The reading is not zero if the plate was zeroed without the chair. It is the median over the samples in which the
    person stands, because the chair is then empty.

    Parameters
    ----------
    wrench : (F, 3) array
        Total (Fx, Fy, tauz) of the plates under the chair, N and N·m.
    ok : (F,) bool array
        Whether each sample has a value.
    rule : {"standing", "none"}
        ``none`` takes the reading as zero, because the plate was zeroed with the chair on it; ``standing`` measures it.
    """
    if rule == "none":
        return EmptyChairReading(np.zeros(3), None)
    tall, low = find_upright(positions)
    empty = tall & ok & low.any()
    if empty.sum() < max(2, _MIN_TOTAL_S * rate):
        return EmptyChairReading(None, None)
    return EmptyChairReading(np.median(wrench[empty], axis=0), wrench[empty].std(axis=0))
