"""What a chair's own plate reads of the person: its wrench less what it reads with nobody on the chair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.posture import upright

ZeroRule: TypeAlias = Literal["standing", "none"]

_ENOUGH_S = 0.2


@dataclass(frozen=True)
class EmptyChair:
    """What a chair's plates read with nobody on the chair, the chair's weight among it.

    Parameters
    ----------
    reading : (3,) array or None
        None where that is not known.
    spread : (3,) array or None
        Standard deviation of what it is the median of.
    """

    reading: FloatArray | None
    spread: FloatArray | None


def empty_chair(wrench: FloatArray, ok: BoolArray, positions: FloatArray, rate: float, rule: ZeroRule) -> EmptyChair:
    """What has to be taken off a chair's wrench.

    A chair weighs on its plate, and the plate may have been zeroed with it or without. What it reads while the
    person stands has nothing of the person in it, so the median of that is taken off. It is constant, as the chair
    stays in its place.

    Parameters
    ----------
    wrench : (F, 3) array
        (Fx, Fy, tauz) of the chair's plates together, N and N·m.
    ok : (F,) bool array
        Known samples.
    positions : (F, M, 3) array
        Markers, m, lab axes with Z up; they show who stands.
    rate : float
        Hz.
    rule : {"standing", "none"}
        ``none`` takes the reading as it is: the plate was zeroed with the chair on it.
    """
    if rule == "none":
        return EmptyChair(np.zeros(3), None)
    tall, low = upright(positions)
    empty = tall & ok & low.any()
    if empty.sum() < max(2, _ENOUGH_S * rate):
        return EmptyChair(None, None)
    return EmptyChair(np.median(wrench[empty], axis=0), wrench[empty].std(axis=0))
