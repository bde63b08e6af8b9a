"""Extrapolation of the instant at which the chair force reaches zero.

A chair is released smoothly, and its force disappears in the noise long before it is zero: a threshold of four standard
deviations places simulated releases 35 to 120 ms too early. The last visible part of the force is therefore modelled as

    F(t) = A (t_release - t)^p   before the release, and zero after it.

A, p and t_release are fitted by least squares. A smooth end hardly determines p, so it has the prior 3 ± 0.3; 3 is the
lowest power whose slope ends without a bend. The prior was chosen on simulated releases and does not suit chairs that
are released in two stages.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray

_POWERS = np.concatenate([[0.25, 0.5], np.arange(1.0, 5.01, 0.25)])
_USUAL, _UNUSUAL = 3.0, 0.3
_SHARE, _SHORTEST = 0.03, 0.05  # share of the full load, and s: the longer one is the fitted interval
_LATE = 0.15  # s after the last visible sample; the force is zero from there on
_LONGEST = 1.0  # s, longest fitted interval
_LEAST = 3  # samples of force in the fitted interval
_STEP = 0.004  # s, coarse search; the fine search has a quarter of it


def release(time: FloatArray, force: FloatArray, last_visible: float, full: float) -> float:
    """Return the instant of zero force, s; ``last_visible`` if too few samples show the force.

    Parameters
    ----------
    time : (T,) array
        s, ascending; negated and reversed to find the instant of touching instead.
    force : (T,) array
        N; NaN where unknown.
    last_visible : float
        Time of the last sample with the force above the noise, s.
    full : float
        Force of the loaded chair, N.
    """
    left = time - last_visible
    with np.errstate(invalid="ignore"):
        high = left[(left <= 0) & (force > _SHARE * full)]
    start = max(min(float(high[-1]) if len(high) else -np.inf, -_SHORTEST), -_LONGEST)
    own = (left >= start) & (left <= _LATE) & np.isfinite(force)
    if np.count_nonzero(own & (left <= 0)) < _LEAST:
        return last_visible
    after = force[(left > _LATE) & (left <= 2 * _LATE) & np.isfinite(force)]
    spread = float(np.std(after)) if len(after) > 1 else 0.0
    coarse = _best(left[own], force[own], spread, np.arange(0.0, _LATE, _STEP))
    fine = coarse + _STEP * np.arange(-1.0, 1.01, 0.25)
    return last_visible + _best(left[own], force[own], spread, fine[fine >= 0.0])


def _best(left: FloatArray, force: FloatArray, spread: float, instants: FloatArray) -> float:
    """Return the instant with the least squared error, each with its best power and factor."""
    shapes = np.maximum(instants[:, None] - left, 0.0)[:, None] ** _POWERS[:, None]  # (I, P, T)
    size = np.maximum(np.sum(shapes**2, axis=2), np.finfo(float).tiny)
    explained = np.maximum(shapes @ force, 0.0) ** 2 / size - (spread * (_POWERS - _USUAL) / _UNUSUAL) ** 2
    return float(instants[np.argmax(explained) // len(_POWERS)])
