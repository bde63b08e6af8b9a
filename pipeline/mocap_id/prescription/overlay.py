"""Overlay of two workspaces: the gain and the loss between two sessions (7.2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.prescription.alpha_shape import AlphaShape
from mocap_id.prescription.sampling import sobol

_POINTS = 1 << 16


@dataclass(frozen=True)
class Overlay:
    """Intersection and differences of two workspaces.

    Parameters
    ----------
    gained, lost, kept : float
        Area or volume that is only in the later workspace, only in the earlier one, and in both, m² or m³.
    sd : float
        Standard deviation of each of these from the number of points counted.
    points : (M, d) array
        Points in any of the workspaces, in the frame of the earlier one, m.
    before, after : (M,) bool arrays
        Whether a point is in the earlier or in the later workspace.
    """

    gained: float
    lost: float
    kept: float
    sd: float
    points: FloatArray
    before: BoolArray
    after: BoolArray


def overlay_workspaces(before: AlphaShape, after: AlphaShape, shift: FloatArray, seed: int = 0) -> Overlay:
    """Compare two workspaces of the same dimension.

    Parameters
    ----------
    before, after : AlphaShape
    shift : (d,) array
        Translation from the frame of the later workspace to that of the earlier one, m.
    seed : int
        Seed of the points counted, which are evenly spread over a box around both.
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
