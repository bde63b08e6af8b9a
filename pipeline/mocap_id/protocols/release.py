"""The instant at which a chair's force vanishes, from the way in which it does.

A chair is let go smoothly: the last hundredth of its force takes as long as the tenth before, and drowns in noise long
before it is zero (a threshold of four standard deviations calls simulated releases 35 to 120 ms early). Visible is
the last stretch above the noise. There the force is taken to fall as

    F(t) = A (t_release - t)^p,   and zero afterwards,

whatever the whole course is. A, p and the instant are fitted by least squares; of p, which a gentle end hardly shows,
3 ± 0.3 is known beforehand, the lowest power whose slope ends without a bend. That was chosen with simulated releases
in view; chairs that are let go in two stages end otherwise.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray

_POWERS = np.concatenate([[0.25, 0.5], np.arange(1.0, 5.01, 0.25)])
_USUAL, _UNUSUAL = 3.0, 0.3
_SHARE, _SHORTEST = 0.03, 0.05  # of the full load, and s: the stretch that is fitted is the longer one of the two
_LATE = 0.15  # s: the force is zero that long after the last sample that shows it
_LONGEST = 1.0  # s, of the stretch
_LEAST = 3  # samples of force in the stretch
_STEP = 0.004  # s, of a first search; a second one is four times as fine


def release(time: FloatArray, force: FloatArray, shown: float, full: float) -> float:
    """When the force vanishes; ``shown`` where too little of its course can be seen.

    Parameters
    ----------
    time : (T,) array
        s, ascending; for a touch instead of a release negated and in reverse.
    force : (T,) array
        N; NaN where unknown.
    shown : float
        Time of the last sample that shows the force above the noise, s.
    full : float
        Force of the loaded chair, N.
    """
    left = time - shown
    with np.errstate(invalid="ignore"):
        high = left[(left <= 0) & (force > _SHARE * full)]
    start = max(min(float(high[-1]) if len(high) else -np.inf, -_SHORTEST), -_LONGEST)
    own = (left >= start) & (left <= _LATE) & np.isfinite(force)
    if np.count_nonzero(own & (left <= 0)) < _LEAST:
        return shown
    after = force[(left > _LATE) & (left <= 2 * _LATE) & np.isfinite(force)]
    spread = float(np.std(after)) if len(after) > 1 else 0.0
    coarse = _best(left[own], force[own], spread, np.arange(0.0, _LATE, _STEP))
    fine = coarse + _STEP * np.arange(-1.0, 1.01, 0.25)
    return shown + _best(left[own], force[own], spread, fine[fine >= 0.0])


def _best(left: FloatArray, force: FloatArray, spread: float, instants: FloatArray) -> float:
    """The instant of least squares, each with its best power and factor."""
    shapes = np.maximum(instants[:, None] - left, 0.0)[:, None] ** _POWERS[:, None]  # (I, P, T)
    size = np.maximum(np.sum(shapes**2, axis=2), np.finfo(float).tiny)
    explained = np.maximum(shapes @ force, 0.0) ** 2 / size - (spread * (_POWERS - _USUAL) / _UNUSUAL) ** 2
    return float(instants[np.argmax(explained) // len(_POWERS)])
