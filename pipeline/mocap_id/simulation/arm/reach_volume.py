"""Volume that the wrist of a simulated arm reaches within a box of joint angles (thesis 7.2).

The box limits plane, elevation, axial rotation and hinge angle. For each of many evenly spread points, the angles that
reach it are computed: the distance from the shoulder gives the hinge angle. At a given elevation, the height gives the
axial rotation, and the direction gives the plane. A point is reached if these angles are within the box for at least
one of many elevations.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, sobol
from mocap_id.geometry import so3
from mocap_id.simulation.arm.body import ArmBody
from mocap_id.simulation.arm.rotations import X

POINTS = 2**14  # number of points, including points beyond the largest reach
ELEVATIONS = 320
_HINGES = 500


def reach_volume(body: ArmBody, box: FloatArray, pronation: float) -> tuple[float, float]:
    """Return the volume that the wrist reaches in the thorax frame, and its standard deviation from sampling, m³.

    Parameters
    ----------
    body : ArmBody
    box : (4, 2) array
        Lowest and highest plane, elevation, axial rotation and hinge angle, rad.
    pronation : float
        Constant pronation, rad.
    """
    hinge = np.linspace(box[3, 0], box[3, 1], _HINGES)
    forearm = so3.exp(X * body.carrying) @ so3.exp(body.pronation_axis * pronation)
    wrist = body.elbow + so3.exp(hinge[:, None] * body.elbow_axis) @ forearm @ np.array([0.0, -body.forearm, 0.0])
    reach = np.linalg.norm(wrist, axis=1)
    side = float(reach.max() + np.linalg.norm(body.glide))
    offsets = side * (2 * sobol(POINTS, 3, 0) - 1)
    points = body.shoulder + offsets[np.linalg.norm(offsets, axis=1) <= side]
    reached = np.zeros(len(points), dtype=np.bool_)
    order = np.argsort(reach)
    for elevation in np.linspace(box[1, 0], box[1, 1], ELEVATIONS):
        away = points[~reached] - body.shoulder - (1 - np.cos(elevation)) / 2 * body.glide
        distance = np.linalg.norm(away, axis=1)
        arm = np.stack([np.interp(distance, reach[order], each) for each in wrist[order].T], axis=1)
        near = (distance >= reach.min()) & (distance <= reach.max())
        reached[~reached] = near & _is_reached(away, arm, elevation, box)
    share = float(reached.sum() / POINTS)
    whole = (2 * side) ** 3
    return whole * share, whole * float(np.sqrt(share * (1 - share) / POINTS))


def _is_reached(away: FloatArray, arm: FloatArray, elevation: float, box: FloatArray) -> BoolArray:
    """Return whether R_y(plane) R_x(-elevation) R_y(axial) within the box rotates ``arm`` into ``away`` (N, 3)."""
    sine, cosine = np.sin(elevation), np.cos(elevation)
    forward = (away[:, 1] - cosine * arm[:, 1]) / sine
    possible = np.abs(forward) <= np.hypot(arm[:, 0], arm[:, 2])
    spread = np.arccos(np.clip(forward / np.hypot(arm[:, 0], arm[:, 2]), -1, 1))
    allowed = np.zeros(len(away), dtype=np.bool_)
    for sign in (-1, 1):
        axial = sign * spread - np.arctan2(arm[:, 0], arm[:, 2])
        across = arm[:, 0] * np.cos(axial) + arm[:, 2] * np.sin(axial)
        plane = np.arctan2(away[:, 0], away[:, 2]) - np.arctan2(across, cosine * forward - sine * arm[:, 1])
        allowed |= _is_within(axial, box[2]) & _is_within(plane, box[0])
    return np.asarray(possible & allowed)


def _is_within(angle: FloatArray, limits: FloatArray) -> BoolArray:
    return np.asarray(np.mod(angle - limits[0], 2 * np.pi) <= limits[1] - limits[0])
