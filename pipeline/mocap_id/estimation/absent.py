"""How much less sure of the angles the markers of a frame are than all of them would be.

Slides of the skin of variance s² make an error of the variance A⁻¹ (Σ s² JᵀJ) A⁻¹ with A = Σ JᵀJ, the sums over the
markers that are seen: more where fewer are. Near the edge of a gap it is still that of all of them, for how those that
are missing had slid is remembered (:mod:`mocap_id.estimation.dropouts`), and grows as that is forgotten.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.dropouts import forgotten
from mocap_id.estimation.inverse import angle_covariance, observed_angles
from mocap_id.estimation.smoothing import States
from mocap_id.geometry.planar import marker_jacobian

_LEAST = 1e-5  # m; least slide that counts
_ENOUGH = 4000  # frames, evenly over the trial, tell the size of the slides


def growth(
    states: States, rested: FloatArray, angles: FloatArray, frames: IntArray, *, rate: float, camera: float
) -> FloatArray:
    """(T, n) by which the variance of errors that last is larger at ``frames`` than with all markers; 1 or more.

    Where the markers do not determine an angle it is 1: the filter's own variance tells.

    Parameters
    ----------
    states : States
    rested : (F, M, 2) array
        Markers that the states rest on, plane frame, m; NaN elsewhere.
    angles : (F, n) array
        The states', rad, without gaps.
    frames : (T,) int array
    rate : float
        Frames per second.
    camera : float
        Camera noise of a coordinate, m.
    """
    used, chain = states.used, states.chain
    often, slide, new = used.mean(axis=0), _slides(states, rested, camera), forgotten(used, frames, rate)
    found = np.ones((len(frames), angles.shape[1]))
    some = np.flatnonzero(~used[frames][:, often > 0].all(axis=1))
    for some_of_them in chunks(len(some)):
        part = some[some_of_them]
        at = frames[part]
        jacobian = marker_jacobian(angles[at], chain.centres, chain.segment, chain.local)
        found[part] = _growth(
            jacobian, used[at], often=often, slide=slide, new=new[part], marker_sd=states.noise.marker_sd
        )
    return found


def _slides(states: States, rested: FloatArray, camera: float) -> FloatArray:
    """(M,) mean square of a coordinate's residual, camera noise apart, m^2."""
    squares, count = np.zeros(rested.shape[1]), np.zeros(rested.shape[1])
    frames = np.arange(0, len(rested), max(1, len(rested) // _ENOUGH))
    for part in chunks(len(frames)):
        off = rested[frames[part]] - states.predicted_in(frames[part])
        known = np.isfinite(off)
        squares += np.where(known, off**2, 0.0).sum(axis=(0, 2))
        count += known.sum(axis=(0, 2))
    return np.asarray(np.maximum(squares / np.maximum(count, 1) - camera**2, _LEAST**2))


def _growth(
    jacobian: FloatArray, used: BoolArray, *, often: FloatArray, slide: FloatArray, new: FloatArray, marker_sd: float
) -> FloatArray:
    """(f, n) of frames with Jacobians (f, M, 2, n), markers used (f, M) and new (f, M) since they vanished."""
    own = np.einsum("fmik,fmil->fmkl", jacobian, jacobian)  # (f, M, n, n)
    seen = np.einsum("fm,fmkl->fkl", used, own)
    observed = observed_angles(angle_covariance(seen, marker_sd))
    both = observed[:, :, None] & observed[:, None, :]
    inverse = np.where(both, np.linalg.inv(np.where(both, seen, np.eye(seen.shape[1]))), 0.0)
    usual = np.linalg.inv(np.einsum("m,fmkl->fkl", often, own))
    now, usually = (
        np.einsum("fjk,fkl,flj->fj", left, np.einsum("fm,fmkl->fkl", weight * slide, own), left)
        for left, weight in ((inverse, used), (usual, np.broadcast_to(often**2, used.shape)))
    )
    share = np.einsum("fkl,fmkl->fm", usual, own) * often * ~used
    forgot = np.sum(share * new, axis=1) / np.sum(share, axis=1)
    return np.asarray(1.0 + forgot[:, None] * np.where(observed, np.maximum(now / usually - 1.0, 0.0), 0.0))
