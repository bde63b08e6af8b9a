"""Prior of the parameters of a chain in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.kinematics.space.bundle_model import BundleProblem, BundleState, locate_columns, tangents

CENTRE_SD = 0.1
"""Standard deviation of each coordinate of a centre about the point between its clusters, m."""
MARKED_SD = 0.03
"""Standard deviation of each coordinate of a centre about markers that are known to be beside the joint, m."""
_ON_HINGE = 0.005  # m; standard deviation along a hinge, where the motion does not determine the centre
_GLIDE = 0.02  # m; standard deviation of the glide of the girdle
_LONG_AXIS = np.radians(3.5)  # standard deviation in the fit; small, because the fit treats soft tissue as noise
_OFF_LONG_AXIS = np.radians(8)  # typical angle between the axis of pronation and the line between the joints
_SLOPE = 0.6  # fraction of axial rotation that the skin does not follow at the near end of a segment
_SCATTER = 0.12  # scatter of single markers about the linear increase from the far end
_NO_SKIN = 1e-4


@dataclass(frozen=True)
class ChainPrior:
    """Likely values of the parameters of a chain.

    The centre of a joint is between its clusters. The second axis of a two-axis joint is the long axis of its segment;
    for example, the forearm rotates about the line from elbow to wrist. The skin follows the axial rotation of the bone
    at the far end of a segment, at elbow and wrist, and lags behind it by a fraction that grows towards the near end.
    """

    centres: FloatArray  # (n, 3) likely centres in the frames of the parents, m
    along: BoolArray  # (n,) two-axis joints whose second axis may be the long axis of their segment
    soft: BoolArray  # (n,) segments 1 … n whose skin may move
    centre_sd: FloatArray  # (n,) standard deviation of each coordinate of the centres, m
    glide_sd: float = _GLIDE  # standard deviation of each coordinate of the glide, m

    def equations(self, problem: BundleProblem, state: BundleState) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residuals (K,) of the prior, and their derivatives (K, P) by the parameters."""
        cols = locate_columns(problem)
        values, rows = [], []

        def add(value: FloatArray, place: slice, by: FloatArray) -> None:
            block = np.zeros((len(value), cols.size))
            block[:, place] = by
            values.append(value)
            rows.append(block)

        for j, place in enumerate(cols.centre):
            sd = self.centre_sd[j]
            add((state.centres[j] - self.centres[j]) / sd, place, np.eye(3) / sd)
            if problem.kinds[j] == "hinge":
                axis = state.first[j][None]
                add(axis @ (state.centres[j] - self.centres[j]) / _ON_HINGE, place, axis / _ON_HINGE)
            second = cols.second[j]
            if self.along[j] and second is not None:
                across = tangents(problem.long_axes[j]).T / _LONG_AXIS
                add(across @ state.second[j], second, across @ tangents(state.second[j]))
        if cols.glide is not None:
            add(state.glide / self.glide_sd, cols.glide, np.eye(3) / self.glide_sd)
        root = self._skin_root(problem, state)
        add(root @ state.skin, cols.skin, root)
        return np.concatenate(values), np.concatenate(rows)

    def axis_errors(self, problem: BundleProblem, state: BundleState) -> FloatArray:
        """Return the gradients (K, P) of the cost for typical errors of the likely second axes."""
        cols = locate_columns(problem)
        rows = np.zeros((2 * len(problem.kinds), cols.size))
        for j, second in enumerate(cols.second):
            if self.along[j] and second is not None:
                across = tangents(problem.long_axes[j]).T @ tangents(state.second[j])
                rows[2 * j : 2 * j + 2, second] = across * _OFF_LONG_AXIS / _LONG_AXIS**2
        return rows

    def _skin_root(self, problem: BundleProblem, state: BundleState) -> FloatArray:
        """Return the root (M, M) of the inverse covariance of the fractions ``state.skin``."""
        root = np.eye(len(problem.segment)) / _NO_SKIN
        for k in np.flatnonzero(self.soft) + 1:
            here = np.flatnonzero(problem.segment == k)
            length = np.linalg.norm(state.centres[problem.parents.index(k)])
            height = np.clip(1 + state.local[here] @ problem.long_axes[k - 1] / length, 0, 1.2)
            covariance = _SCATTER**2 * np.eye(len(here)) + _SLOPE**2 * np.outer(height, height)
            root[np.ix_(here, here)] = np.linalg.cholesky(np.linalg.inv(covariance)).T
        return root
