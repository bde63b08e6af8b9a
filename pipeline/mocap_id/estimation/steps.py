"""What a drop-out does to velocities: markers that slide take their share of the angle along when they vanish.

The angle that a set of markers gives is off by the mean, in the sense of the fit, of what its markers slid. Where the
set changes the angle steps, and the smoother makes a bump in the velocity of it and a swing in the acceleration. How
far it steps can be told: the residuals of the markers, beside the edge, give the angle that either set would have had.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.inverse import angle_covariance, observed_angles
from mocap_id.estimation.process import ORDER
from mocap_id.estimation.skin import corner
from mocap_id.estimation.smoothing import States
from mocap_id.geometry.planar import marker_jacobian

_BESIDE = 5  # frames on either side of an edge over which a residual is taken

_EDGES = 256  # at a time, to bound the memory


class Steps(NamedTuple):
    """Frames (E,) before which the set of the markers used changes, and by how much the angles step (E, n), rad."""

    edges: IntArray
    sizes: FloatArray


def steps(states: States, rested: FloatArray, angles: FloatArray) -> Steps:
    """Find the steps.

    Parameters
    ----------
    states : States
    rested : (F, M, 2) array
        Markers that the states rest on, plane frame, m; NaN elsewhere.
    angles : (F, n) array
        The states', rad, without gaps.
    """
    edges = 1 + np.flatnonzero((states.used[1:] != states.used[:-1]).any(axis=1))
    sizes = [_sizes(states, rested, angles, edges[part]) for part in chunks(len(edges), _EDGES)]
    return Steps(edges, np.concatenate(sizes))


def stepping_errors(found: Steps, states: States, joint: int, rate: float) -> FloatArray:
    """(F, 4) variances of a joint's states about the steps.

    The steps pass the smoother, H = 1 / (1 + (w / w0)^8), and its derivatives; the mean square over its memory counts.

    Parameters
    ----------
    found : Steps
    states : States
        With the filter's own deviations.
    joint : int
    rate : float
        Frames per second.
    """
    count = len(states.sd)
    total = np.zeros((count, ORDER))
    if not found.edges.size:
        return total
    turning = 2 * np.pi * np.fft.rfftfreq(2 * count, 1 / rate)  # as long again, so that the end does not meet the start
    impulses = np.zeros(2 * count)
    impulses[found.edges] = found.sizes[:, joint] * rate  # the derivative of the steps
    w0 = corner(np.median(states.sd[:, joint] ** 2, axis=0))
    passed = np.fft.rfft(impulses) / (1 + (turning / w0) ** (2 * ORDER))
    memory = np.exp(-0.5 * (turning / w0) ** 2)
    for order in range(1, ORDER):
        part = np.fft.irfft((1j * turning) ** (order - 1) * passed, 2 * count)
        square = np.fft.irfft(np.fft.rfft(part**2) * memory, 2 * count)[:count]
        total[:, order] = np.maximum(square, 0)
    return total


def _sizes(states: States, rested: FloatArray, angles: FloatArray, edges: IntArray) -> FloatArray:
    """(E, n) steps of the angles, rad; 0 where what stays does not determine the angle.

    What goes counts with the residuals before the edge, what comes with those after it: the pose that they refer to is
    already on its way from one to the other.
    """
    chain = states.chain
    jacobian = marker_jacobian(angles[edges], chain.centres, chain.segment, chain.local)  # (E, M, 2, n)
    step = np.zeros((len(edges), angles.shape[1]))
    for side, beside in ((-1, np.arange(-_BESIDE, 0)), (1, np.arange(_BESIDE))):
        frames = np.clip(edges[:, None] + beside, 0, len(rested) - 1)
        near = rested[frames] - states.predicted_in(frames)  # (E, b, M, 2)
        known = np.isfinite(near)
        slid = np.where(known, near, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        there = states.used[edges + min(side, 0)] & known.any(axis=(1, 3))
        both = there & states.used[edges - max(side, 0)]
        (all_of_it, sure), (rest, still) = (
            _turned(slid, jacobian, used, states.noise.marker_sd) for used in (there, both)
        )
        step += np.where(sure & still, side * (all_of_it - rest), 0.0)
    return step


def _turned(slid: FloatArray, jacobian: FloatArray, used: BoolArray, marker_sd: float) -> tuple[FloatArray, BoolArray]:
    """Angles (E, n) that residuals (E, M, 2) of the markers used make, and whether these determine them."""
    own = jacobian * used[..., None, None]
    covariance = angle_covariance(np.einsum("emik,emil->ekl", own, own), marker_sd)
    turned = np.einsum("ekl,emil,emi->ek", covariance, own, slid) / marker_sd**2
    return turned, observed_angles(covariance)
