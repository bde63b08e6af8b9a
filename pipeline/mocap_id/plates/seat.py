"""Reading of the plate under an empty chair, to be subtracted from the wrench of the chair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.marker_posture import upright

ZeroRule: TypeAlias = Literal["standing", "none"]

_MIN_TOTAL_S = 0.2


@dataclass(frozen=True)
class EmptyChairReading:
    """Reading of the plates under an empty chair, including the weight of the chair.

    Parameters
    ----------
    reading : (3,) array or None
        (Fx, Fy, tauz); None if it cannot be determined.
    spread : (3,) array or None
        Standard deviation of the samples of which ``reading`` is the median.
    """

    reading: FloatArray | None
    spread: FloatArray | None


def measure_empty_chair(
    wrench: FloatArray, ok: BoolArray, positions: FloatArray, rate: float, rule: ZeroRule
) -> EmptyChairReading:
    """Determine the reading of the plates under the empty chair.

    The plate may have been zeroed with or without the chair on it. While the person stands, the chair is empty, so the
    reading is the median over these samples. It is constant, since the chair does not move.

    Parameters
    ----------
    wrench : (F, 3) array
        Total (Fx, Fy, tauz) of the plates under the chair, N and N·m.
    ok : (F,) bool array
        Whether each sample is known.
    positions : (F, M, 3) array
        Markers, lab axes with Z up, m; they show when the person stands.
    rate : float
        Frames per second.
    rule : {"standing", "none"}
        With ``none`` the reading is zero: the plate was zeroed with the chair on it.
    """
    if rule == "none":
        return EmptyChairReading(np.zeros(3), None)
    tall, low = upright(positions)
    empty = tall & ok & low.any()
    if empty.sum() < max(2, _MIN_TOTAL_S * rate):
        return EmptyChairReading(None, None)
    return EmptyChairReading(np.median(wrench[empty], axis=0), wrench[empty].std(axis=0))
