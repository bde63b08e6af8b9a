"""Soft tissue of a simulated arm: skin that slides, and skin that does not follow the twist of its segment."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.simulation.arm.markers import ArmMarkers, marker_set
from mocap_id.simulation.arm.turns import Y
from mocap_id.simulation.skin import displacement


def slide(
    rng: np.random.Generator, wander: np.random.Generator, markers: ArmMarkers, driving: FloatArray, time: FloatArray
) -> FloatArray:
    """Return the sliding (F, M, 3) of every marker in its segment's frame, m; it is zero at the first frame.

    Parameters
    ----------
    rng, wander : Generator
        Of the sliding and of the slow drift.
    markers : ArmMarkers
    driving : (F, 4) array
        Elevation, elbow flexion, pronation and wrist flexion, rad: a segment's skin slides with the two next to it.
    time : (F,) array
        s.
    """
    soft = marker_set(markers.labels, markers.segment, markers.local, markers.slide)
    moved = displacement(rng, soft, driving, time, wander=wander, middle=driving[0])
    from_start: FloatArray = moved - moved[0]
    return from_start


def twist_displacement(markers: ArmMarkers, twists: FloatArray) -> FloatArray:
    """Return the displacement (F, M, 3), m, of skin that follows a part of its segment's twist (F, 4), rad."""
    twist = -markers.twist_loss * (twists - twists[0])[:, markers.segment]
    turned: FloatArray = np.einsum("fmij,mj->fmi", so3.exp(twist[..., None] * Y), markers.local)
    return turned - markers.local
