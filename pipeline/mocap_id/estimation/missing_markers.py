"""Growth of the angles' variance from sliding skin in frames with missing markers (docs/concepts/dropouts.md).

Displacements of the markers ("slides") with the variance s² cause errors of the angles with the covariance A⁻¹ (Σ s²
JᵀJ) A⁻¹, where J is the Jacobian of a marker and A = Σ JᵀJ. The sums run over the visible markers. The variance grows
gradually after a marker vanishes, because its displacement becomes unknown gradually.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.dropouts import compute_forgotten_share
from mocap_id.estimation.inverse_kinematics import compute_angle_covariance, find_observed_angles
from mocap_id.estimation.smoothing import States
from mocap_id.geometry.planar import marker_jacobian

_LEAST = 1e-5  # m; least rms displacement
_ENOUGH = 4000  # frames, spread evenly over the trial, from which the rms displacements are estimated


def compute_variance_growth(
    states: States, used_markers: FloatArray, angles: FloatArray, frames: IntArray, *, rate: float, camera: float
) -> FloatArray:
    """Return the factor (T, n), at least 1, by which missing markers increase the variance of errors from skin.

    It is 1 where the markers do not determine an angle, because the filter's own variance covers this case.
    ``used_markers`` (F, M, 2) are the markers used for the states, plane frame, m, otherwise NaN; ``angles`` (F, n)
    have no gaps, rad; ``frames`` (T,) are the frames of the factor; ``camera`` is the camera noise of a coordinate, m.
    """
    used, chain = states.used, states.chain
    often, slide = used.mean(axis=0), _measure_slides(states, used_markers, camera)
    forgotten = compute_forgotten_share(used, frames, rate)
    factor = np.ones((len(frames), angles.shape[1]))
    some = np.flatnonzero(~used[frames][:, often > 0].all(axis=1))
    for chunk in chunks(len(some)):
        part = some[chunk]
        at = frames[part]
        jacobian = marker_jacobian(angles[at], chain.centres, chain.segment, chain.local)
        factor[part] = _compute_growth(
            jacobian, used[at], often=often, slide=slide, forgotten=forgotten[part], marker_sd=states.noise.marker_sd
        )
    return factor


def _measure_slides(states: States, used_markers: FloatArray, camera: float) -> FloatArray:
    """Return the mean square (M,) of each marker's residual per coordinate without camera noise, m^2."""
    squares, count = np.zeros(used_markers.shape[1]), np.zeros(used_markers.shape[1])
    frames = np.arange(0, len(used_markers), max(1, len(used_markers) // _ENOUGH))
    for part in chunks(len(frames)):
        off = used_markers[frames[part]] - states.predicted_in(frames[part])
        known = np.isfinite(off)
        squares += np.where(known, off**2, 0.0).sum(axis=(0, 2))
        count += known.sum(axis=(0, 2))
    return np.asarray(np.maximum(squares / np.maximum(count, 1) - camera**2, _LEAST**2))


def _compute_growth(
    jacobian: FloatArray,
    used: BoolArray,
    *,
    often: FloatArray,
    slide: FloatArray,
    forgotten: FloatArray,
    marker_sd: float,
) -> FloatArray:
    """Return the factor (f, n) in f frames, from the Jacobians (f, M, 2, n) of the markers.

    ``used`` (f, M) marks the used markers. ``often`` (M,) is the fraction of frames that use each marker, ``slide``
    (M,) the mean square of its displacement, m^2, and ``forgotten`` (f, M) the fraction of this that is unknown.
    """
    own = np.einsum("fmik,fmil->fmkl", jacobian, jacobian)  # (f, M, n, n)
    seen = np.einsum("fm,fmkl->fkl", used, own)
    observed = find_observed_angles(compute_angle_covariance(seen, marker_sd))
    both = observed[:, :, None] & observed[:, None, :]
    inverse = np.where(both, np.linalg.inv(np.where(both, seen, np.eye(seen.shape[1]))), 0.0)
    usual = np.linalg.inv(np.einsum("m,fmkl->fkl", often, own))
    now, usually = (
        np.einsum("fjk,fkl,flj->fj", left, np.einsum("fm,fmkl->fkl", weight * slide, own), left)
        for left, weight in ((inverse, used), (usual, np.broadcast_to(often**2, used.shape)))
    )
    share = np.einsum("fkl,fmkl->fm", usual, own) * often * ~used
    mean_forgotten = np.sum(share * forgotten, axis=1) / np.sum(share, axis=1)
    return np.asarray(1.0 + mean_forgotten[:, None] * np.where(observed, np.maximum(now / usually - 1.0, 0.0), 0.0))
