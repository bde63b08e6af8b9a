"""Backfill: states before a joint's angle is determined, extrapolated backwards from later frames.

A joint whose angle is too uncertain starts again in every frame until a frame determines its angle. The smoother does
not connect the states before such a start with those after it. Therefore the process model (eq. 3.17) is run backwards
from the last start. The uncertainty of the extrapolated states grows with the distance, as in a gap.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.filter_problem import FilterProblem, Track
from mocap_id.estimation.process_model import noise_shape, transition


def backfill(problem: FilterProblem, track: Track, mean: FloatArray, sd: FloatArray) -> BoolArray:
    """Extrapolate into the frames before each joint's last start where this reduces the variance; return where (F, n).

    ``track`` is the smoothed track. ``mean`` and ``sd`` (F, n, 4) are its states by joint, which are changed in place.
    The state x before a state x' = F x + w, where w has the covariance Q, has the covariance P = F⁻¹ (P' + Q) F⁻ᵀ.
    """
    back = np.linalg.inv(transition(problem.dt))
    filled = np.zeros(track.restarted.shape, dtype=np.bool_)
    for j, density in enumerate(problem.density):
        noise = density * noise_shape(problem.dt)
        own = np.arange(4) * problem.joints + j
        for k in np.flatnonzero(track.found[:, j]).tolist():
            x, p = mean[k, j], track.covariance[k][np.ix_(own, own)]
            for before in range(k - 1, -1, -1):
                x, p = back @ x, back @ (p + noise) @ back.T
                if p[0, 0] >= sd[before, j, 0] ** 2:
                    break
                mean[before, j], sd[before, j], filled[before, j] = x, np.sqrt(np.diagonal(p)), True
    return filled
