"""Parameters of the chain, full and base (eq. 6.1), from the parameters of separately moving bodies.

The chain has no body for arms and head; these are added to its last segment at their mean position. Two segments of the
chain can be one body. This body is then divided between the segments as in a reference table, as far as their sum
allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base_parameters import BaseSet, structural_base
from mocap_id.dynamics.body_prior import average_transform
from mocap_id.dynamics.measured_motion import BodyPoses
from mocap_id.geometry import planar

_STEP = 1e-5  # m: step of numerical derivatives
_SHARES = 21  # number of divisions of a body that are tried, from the table's division to an even one
_ROUNDING = 1e-9  # relative rounding error of m·Izz


@dataclass(frozen=True)
class ChainMap:
    """Linear map from the full parameters of the bodies to those of the chain: ``matrix @ bodies + constant``."""

    matrix: FloatArray  # (4(n + 1), 4K) linear part of the map
    constant: FloatArray  # (4(n + 1),) constant part of the map
    open: FloatArray  # (4(n + 1), 4(n + 1)) covariance of the division of bodies between two segments
    halves: FloatArray  # (4(n + 1), 4K) linear map that divides every body evenly between its segments

    def apply(self, full: FloatArray) -> FloatArray:
        """Return physically possible full parameters (4(n + 1),) of the chain from those of the bodies (4K,).

        If the table's division of a body gives an impossible segment, the division is changed towards an even one as
        far as necessary. The sum does not change. If no division is possible, the table's division is returned.
        """
        likely, even = self.matrix @ full + self.constant, self.halves @ full
        for share in np.linspace(0.0, 1.0, _SHARES):
            chain = (1.0 - share) * likely + share * even
            if _is_possible(chain):
                return np.asarray(chain)
        return np.asarray(likely)


def map_to_chain(
    poses: BodyPoses, q: FloatArray, samples: BoolArray, reference: FloatArray, reference_sd: FloatArray
) -> ChainMap:
    """Compute the map from the bodies to the segments of the chain.

    Parameters
    ----------
    q : (T, n) array
        Joint angles of the chain, rad.
    samples : (T,) bool array
        True for samples over which the mean position of the bodies is computed.
    reference, reference_sd : (4(n + 1),) arrays
        Full parameters of a reference table and their standard deviations; NaN if no table applies.
    """
    count, bodies = len(poses.body), poses.angle.shape[1]
    matrix, constant, spread = np.zeros((4 * count, 4 * bodies)), np.zeros(4 * count), np.zeros((4 * count, 4 * count))
    halves = np.zeros_like(matrix)
    for body in range(bodies):
        own = np.flatnonzero(poses.body == body)
        columns = slice(4 * body, 4 * body + 4)
        if len(own) == 1:
            matrix[4 * own[0] : 4 * own[0] + 4, columns] = halves[4 * own[0] : 4 * own[0] + 4, columns] = np.eye(4)
        elif len(own) > 1:
            rows = np.concatenate([np.arange(4 * k, 4 * k + 4) for k in own])
            total = merge_segments(poses.centres, q, samples, own)
            halves[rows, columns] = np.concatenate(
                [np.linalg.inv(total[:, 4 * k : 4 * k + 4]) / len(own) for k in range(len(own))]
            )
            gain, rest, left = _divide_sum(total, reference[rows], reference_sd[rows])
            matrix[rows, columns] += gain
            constant[rows] += rest
            spread[np.ix_(rows, rows)] += left
    last = int(poses.body[-1])
    for body in np.setdiff1d(np.arange(bodies), poses.body):
        angle, shift = measure_relative_pose(poses, int(body), last, samples)
        transform = average_transform(angle, shift)
        columns = slice(4 * body, 4 * body + 4)
        for each in (matrix, halves):
            each[:, columns] += each[:, 4 * last : 4 * last + 4] @ transform
    return ChainMap(matrix, constant, spread, halves)


def measure_relative_pose(poses: BodyPoses, body: int, other: int, samples: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return angle (S,), rad, and origin (S, 2), m, of a body's frame in another's, in the S samples with both."""
    origin, angle = poses.origin, poses.angle
    known = samples & np.isfinite(angle[:, [body, other]]).all(axis=1)
    shift = planar.rotate(-angle[known, other], origin[known, body] - origin[known, other])
    return np.asarray(angle[known, body] - angle[known, other]), shift


def merge_segments(centres: FloatArray, q: FloatArray, samples: BoolArray, segments: IntArray) -> FloatArray:
    """Return the matrix (4, 4s) that maps parameters of s adjacent segments to their sum in the first one's frame."""
    known = samples & np.isfinite(q).all(axis=1)
    blocks, angle, shift = [np.eye(4)], np.zeros(int(known.sum())), np.zeros((int(known.sum()), 2))
    for segment in segments[1:]:
        shift = shift + planar.rotate(angle, centres[segment - 1])
        angle = angle + q[known, segment - 1]
        blocks.append(average_transform(angle, shift))
    return np.concatenate(blocks, axis=1)


def propagate_to_base(chain_map: ChainMap, base: BaseSet, own: FloatArray) -> FloatArray:
    """Return the covariance (b, b) of the chain's base parameters, without errors of the joint centres.

    ``own`` (4K, 4K) is the covariance of the full parameters of the bodies.
    """
    known = chain_map.matrix @ own @ chain_map.matrix.T + chain_map.open
    return np.asarray(base.regrouping @ known @ base.regrouping.T)


def propagate_centres(base: BaseSet, centres: FloatArray, q: FloatArray, chain: FloatArray) -> FloatArray:
    """Return the derivative (b, n, 2) of the base parameters with respect to each joint centre, per metre.

    The centres are in the frames of the segments before the joints. A displaced joint changes the regrouping of the
    masses beyond it and the origin for the parameters of the next segment. ``q`` (n,) are the mean joint angles, rad,
    and ``chain`` (4(n + 1),) the full parameters of the chain.
    """
    out: FloatArray = np.zeros((len(base.kept), *centres.shape))
    undisturbed = structural_base(centres)
    regroups = np.array_equal(undisturbed.kept, base.kept)
    for joint in range(len(centres)):
        for axis in range(2):
            shift = np.zeros_like(centres)
            shift[joint, axis] = _STEP
            after = chain.copy()
            block = slice(4 * joint + 4, 4 * joint + 8)
            own = planar.rotate(-q[joint], shift[joint])  # in the frame of the segment after the joint
            after[block] = average_transform(np.zeros(1), -own[None]) @ chain[block]
            if joint + 1 < len(centres):  # the next joint stays where it is
                shift[joint + 1] = -own
            moved = base.regrouping @ (after - chain)
            if regroups:
                moved += (structural_base(centres + shift).regrouping - undisturbed.regrouping) @ chain
            out[:, joint, axis] = moved / _STEP
    return out


def _is_possible(full: FloatArray) -> bool:
    """Return whether every segment is physically possible: m ≥ 0 and m·Izz ≥ mx² + my²."""
    mass, mx, my, inertia = full.reshape(-1, 4).T
    return bool(np.all((mass >= 0) & (mass * inertia * (1 + _ROUNDING) >= mx**2 + my**2)))


def _divide_sum(total: FloatArray, reference: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Divide a sum between s segments as in a table; return gain (4s, 4), constant (4s,) and covariance (4s, 4s)."""
    if not np.isfinite(reference).all():
        gain = np.zeros((total.shape[1], 4))
        gain[:4] = np.eye(4)
        return gain, np.zeros(total.shape[1]), np.zeros((total.shape[1], total.shape[1]))
    spread: FloatArray = np.diag(sd**2)
    gain = np.asarray(np.linalg.solve(total @ spread @ total.T, total @ spread).T)
    return gain, reference - gain @ total @ reference, spread - gain @ total @ spread
