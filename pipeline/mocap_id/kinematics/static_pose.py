"""Joint angles of a planar chain in a still pose of another recording, which may look in any direction.

Only the vertical is common to both recordings. The sagittal plane of the pose is the one in which every cluster of
markers has the same shape as in the chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.planar import PlaneFrame, marker_positions, rotate

_MARKER_SD = 0.005  # m; skin motion between the pose and the movement
_BASE_SD = np.radians(1.0)  # the feet are flat on the floor in both recordings
_STEPS = 72  # directions of the first search
_UNKNOWN = np.radians(20.0)  # standard deviation above which the markers do not determine an angle


@dataclass(frozen=True)
class StaticPose:
    """Joint angles in a still pose."""

    theta: FloatArray  # (n,) joint angles with the zero of the chain's frames, rad; NaN where not determined
    sd: FloatArray  # (n,) standard deviations, rad
    residual: float  # rms distance of the markers from the chain, m


def fit_static_pose(
    points: FloatArray, lateral: FloatArray, segment: IntArray, local: FloatArray, centres: FloatArray
) -> StaticPose:
    """Fit a chain to the marker positions of a still pose.

    ``points`` (M, 3) are the markers in the pose, in a lab with Z up, m. ``lateral`` (M,) are the mean out-of-plane
    coordinates of the same markers in the trial of the chain, m; they and ``local`` determine the direction of the
    plane. The other arguments are as for :func:`mocap_id.geometry.planar.marker_positions`.
    """
    count = len(centres)
    groups = [np.flatnonzero(segment == k) for k in range(count + 1)]
    own = local[:, 0] + 1j * local[:, 1]

    def turn(yaw: float) -> tuple[FloatArray, list[complex], float]:
        """Return the points in a plane, the rotation of each cluster (0 for one marker), and the squared misfit."""
        plane = PlaneFrame(yaw).to_plane(points)
        at, misfit, turned = plane[:, 0] + 1j * plane[:, 1], 0.0, []
        for group in groups:
            if not len(group):
                turned.append(0j)
                continue
            seen, shape, side = (each[group] - each[group].mean() for each in (at, own, plane[:, 2] - lateral))
            common = complex(np.vdot(shape, seen))
            misfit += float(np.sum(np.abs(seen) ** 2 + np.abs(shape) ** 2 + side**2)) - 2 * abs(common)
            turned.append(common)
        return plane, turned, misfit

    step = 2 * np.pi / _STEPS
    first = min((k * step for k in range(_STEPS)), key=lambda yaw: turn(yaw)[2])
    yaw = minimize_scalar(lambda yaw: turn(yaw)[2], bounds=(first - step, first + step), method="bounded").x
    plane, turned, _ = turn(float(yaw))
    angles = np.zeros(count + 1)
    for k in range(1, count + 1):  # a segment with one marker starts with the angle of the segment below
        angles[k] = np.angle(turned[k]) if abs(turned[k]) > 1e-9 else angles[k - 1]

    def residuals(state: FloatArray) -> FloatArray:
        placed = rotate(state[2], marker_positions(state[3:], centres, segment, local)) + state[:2]
        return np.append(((placed - plane[:, :2]) / _MARKER_SD).ravel(), state[2] / _BASE_SD)

    start = np.concatenate([[0.0, 0.0, 0.0], np.diff(angles)])
    start[:2] = (plane[:, :2] - marker_positions(start[3:], centres, segment, local)).mean(axis=0)
    fit = least_squares(residuals, start)
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    size = max(1.0, 2 * fit.cost / max(len(fit.fun) - len(start), 1))  # the misfit, if it is more than skin motion
    weak = np.diag(np.full(len(start), 1e-6))  # keeps the inverse finite; its sd of 1000 rad counts as unknown
    sd = np.sqrt(size * np.diag(np.linalg.inv(jacobian.T @ jacobian + weak)))[3:]
    theta = (fit.x[3:] + np.pi) % (2 * np.pi) - np.pi
    distance = np.linalg.norm(fit.fun[:-1].reshape(-1, 2), axis=1) * _MARKER_SD
    return StaticPose(np.where(sd < _UNKNOWN, theta, np.nan), sd, float(np.sqrt(np.mean(distance**2))))
