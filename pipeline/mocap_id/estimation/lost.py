"""Before a joint is found: what the frames after tell about the time in which the filter had lost it.

A joint that is lost starts over in every frame until one determines it, and the smoother joins nothing with what lies
before a start. The frames just before the joint is found need not stay empty for that: the process (eq. 3.17) run
backwards carries the state into them, and its uncertainty grows as it does at the beginning of a gap.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.problem import Problem, Track
from mocap_id.estimation.process import noise_shape, transition


def carry_back(problem: Problem, track: Track, mean: FloatArray, sd: FloatArray) -> BoolArray:
    """Fill the frames before a joint is found, as long as that is surer than what they hold; in place.

    With x = F⁻¹ (x' − w), of which nothing else is known, P = F⁻¹ (P' + Q) F⁻ᵀ.

    Parameters
    ----------
    problem : Problem
    track : Track
        Smoothed.
    mean, sd : (F, n, 4) array
        Of the track, by joint; changed.

    Returns
    -------
    (F, n) bool array
        Where the state is carried back.
    """
    back = np.linalg.inv(transition(problem.dt))
    carried = np.zeros(track.restarted.shape, dtype=np.bool_)
    for j, density in enumerate(problem.density):
        noise = density * noise_shape(problem.dt)
        own = np.arange(4) * problem.joints + j
        for k in np.flatnonzero(track.found[:, j]).tolist():
            x, p = mean[k, j], track.covariance[k][np.ix_(own, own)]
            for before in range(k - 1, -1, -1):
                x, p = back @ x, back @ (p + noise) @ back.T
                if p[0, 0] >= sd[before, j, 0] ** 2:
                    break
                mean[before, j], sd[before, j], carried[before, j] = x, np.sqrt(np.diagonal(p)), True
    return carried
