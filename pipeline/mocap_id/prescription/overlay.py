"""Two workspaces over each other: what was gained and what was lost between two sessions (7.2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.prescription.alpha_shape import AlphaShape
from mocap_id.prescription.sampling import sobol

_POINTS = 1 << 16


@dataclass(frozen=True)
class Overlay:
    """What two workspaces share, and what only one of them holds.

    Parameters
    ----------
    gained, lost, kept : float
        Measure, m² or m³, of what only the later one holds, only the earlier one, and both.
    sd : float
        Of each of them, from the points that they were counted with.
    points : (M, d) array
        In either workspace, m, in the earlier one's frame.
    before, after : (M,) bool arrays
        Whether a point is in the earlier, in the later workspace.
    """

    gained: float
    lost: float
    kept: float
    sd: float
    points: FloatArray
    before: BoolArray
    after: BoolArray


def overlay(before: AlphaShape, after: AlphaShape, shift: FloatArray, seed: int = 0) -> Overlay:
    """Compare two workspaces of the same dimension.

    Parameters
    ----------
    before, after : AlphaShape
    shift : (d,) array
        Added to the later one's coordinates to bring them into the earlier one's frame, m.
    seed : int
        Of the points, evenly spread over a box about both, that are counted.
    """
    both = np.concatenate([before.points, after.points + shift])
    low, high = both.min(axis=0), both.max(axis=0)
    points = low + sobol(_POINTS, both.shape[1], seed) * (high - low)
    inside, later = before.contains(points), after.contains(points - shift)
    box = float(np.prod(high - low))
    shares = [float(np.mean(part)) for part in (later & ~inside, inside & ~later, inside & later)]
    either = inside | later
    return Overlay(
        gained=shares[0] * box,
        lost=shares[1] * box,
        kept=shares[2] * box,
        sd=box * float(np.sqrt(max(share * (1 - share) for share in shares) / _POINTS)),
        points=points[either],
        before=inside[either],
        after=later[either],
    )
