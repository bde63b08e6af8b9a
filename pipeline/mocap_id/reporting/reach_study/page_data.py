"""Data of the figures of a reach study."""

from __future__ import annotations

from dataclasses import dataclass

from mocap_id.arrays import FloatArray


@dataclass(frozen=True)
class Shape:
    """Surface of a reachable volume, in the frame of the thorax: forward, up, to the person's right, m.

    Parameters
    ----------
    subject : str
        Id of the person.
    side : {"right", "left"}
    session : str
    wires : (K, 3) array
        Lines on the surface, interrupted by NaN.
    arm : (3, 3) array
        Shoulder, elbow and wrist at the furthest reach.
    """

    subject: str
    side: str
    session: str
    wires: FloatArray
    arm: FloatArray
