"""Angles on the circle."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray

_TURN = 2 * np.pi


def shift_to_shortest_arc(angles: FloatArray) -> FloatArray:
    """Return angles (K,) shifted by whole turns onto the shortest arc that holds them, near zero, rad.

    An angle loses count of its turns where it has no meaning.

    Examples
    --------
    >>> np.degrees(shift_to_shortest_arc(np.radians([350.0, 20.0, 380.0]))).round(6)
    array([-10.,  20.,  20.])
    """
    wrapped = np.mod(angles, _TURN)
    around = np.sort(wrapped)
    gaps = np.diff(around, append=around[0] + _TURN)
    start = around[(int(gaps.argmax()) + 1) % len(around)]
    on_arc = np.mod(wrapped - start, _TURN) + start
    turns = np.round((on_arc.min() + on_arc.max()) / 2 / _TURN)
    return np.asarray(on_arc - _TURN * turns)
