"""Translation of the shoulder girdle: the base markers that move with it.

The centre of the shoulder moves in the thorax by g (1 - cos elevation) / 2. Soft tissue moves the markers of the arm in
the same way, so only a marker on the girdle, such as AC, distinguishes the two motions.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_LEAST = 0.004  # m; least modelled motion at an elevation of 180°
_EXPLAINED = 0.5  # least fraction of the marker's motion in the base that follows the elevation
_STANDS_OUT = 3.0  # least ratio of the motion of a girdle marker to the typical motion of the base markers
_RANGE = 0.15  # least range of u; otherwise the arm is hardly raised
_FEWEST = 4  # fewest base markers that are not on the girdle


def find_girdle_markers(
    off: FloatArray, seen: BoolArray, base: BoolArray, share: FloatArray, named: BoolArray
) -> BoolArray:
    """Return the base markers (M,) that move with the elevation of the next segment.

    ``off`` (F, M, 3) are residuals in the frame of the base, m, 0 unless ``seen`` (F, M); ``base`` (M,) marks the
    markers of the base, and ``share`` (F,) is the factor u = (1 - cos elevation) / 2. Base markers that are on the
    girdle by their names, ``named`` (M,), are included whatever their motion. Sliding skin may hide it, and without the
    glide, the elevation of every raised arm would be overestimated. No marker is returned if the arm is hardly raised,
    or if too few base markers would remain.
    """
    on_girdle = np.zeros(off.shape[1], dtype=bool)
    low, high = np.quantile(share, [0.05, 0.95])
    if high - low < _RANGE or base.sum() <= _FEWEST:
        return on_girdle
    motion, explained = np.zeros(off.shape[1]), np.zeros(off.shape[1])
    for m in np.flatnonzero(base):
        here = seen[:, m]
        if here.sum() < 10:
            continue
        u = share[here] - share[here].mean()
        y = off[here, m] - off[here, m].mean(axis=0)
        slope = u @ y / (u @ u)
        motion[m] = np.linalg.norm(slope)
        explained[m] = motion[m] ** 2 * (u @ u) / np.sum(y**2)
    usual = np.median(motion[base])
    on_girdle = base & (named | (motion > np.maximum(_LEAST, _STANDS_OUT * usual)) & (explained > _EXPLAINED))
    if base.sum() - on_girdle.sum() < _FEWEST:
        return np.zeros_like(on_girdle)
    return np.asarray(on_girdle)
