"""What is known about a chain in space before its motion is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.kinematics.space.bundle_model import BundleProblem, BundleState, locate_columns, tangents

CENTRE_SD = 0.1
"""Standard deviation of each coordinate of a centre about the middle of its clusters, m."""
MARKED_SD = 0.03
"""The same about markers that are known to be beside the joint, whose skin moves, m."""
_ON_HINGE = 0.005  # m; along a hinge, where no motion shows the centre
_GLIDE = 0.02  # m; of the girdle at 180° of elevation
_LONG_AXIS = np.radians(3.5)  # weight in the fit; small, because soft tissue counts as noise there and pulls too hard
_OFF_LONG_AXIS = np.radians(8)  # usual angle between an axis of pronation and the line between the joints
_SLOPE = 0.6  # twist that the skin misses at the near end of a segment
_SCATTER = 0.12  # of one marker about the straight line from the far end, where the skin follows the bone
_NO_SKIN = 1e-4


@dataclass(frozen=True)
class ChainPrior:
    """Likely values of the parameters of a chain.

    The centre of a joint is somewhere between its clusters. The second axis of a joint of two axes is the long axis of
    its segment: the forearm turns about the line from elbow to wrist. The skin follows the twist of the bone at the far
    end of a segment, at the elbow and the wrist, and misses a part of it that grows towards the near end.

    Parameters
    ----------
    centres : (n, 3) array
        Likely centres in the frames of the parents, m.
    along : (n,) bool array
        Joints of two axes whose second axis may be the long axis of their segment.
    soft : (n,) bool array
        Segments 1 … n whose skin may move.
    centre_sd : (n,) array
        Standard deviation of each coordinate of the centres, m.
    glide_sd : float
        Standard deviation of each coordinate of the glide, m.
    """

    centres: FloatArray
    along: BoolArray
    soft: BoolArray
    centre_sd: FloatArray
    glide_sd: float = _GLIDE

    def equations(self, problem: BundleProblem, state: BundleState) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residuals (K,) and their derivatives by the parameters (K, P)."""
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
        """Return the gradients (K, P) from usual errors of the likely second axes."""
        cols = locate_columns(problem)
        rows = np.zeros((2 * len(problem.kinds), cols.size))
        for j, second in enumerate(cols.second):
            if self.along[j] and second is not None:
                across = tangents(problem.long_axes[j]).T @ tangents(state.second[j])
                rows[2 * j : 2 * j + 2, second] = across * _OFF_LONG_AXIS / _LONG_AXIS**2
        return rows

    def _skin_root(self, problem: BundleProblem, state: BundleState) -> FloatArray:
        """Return the root of the inverse covariance of the skin's shares (M, M)."""
        root = np.eye(len(problem.segment)) / _NO_SKIN
        for k in np.flatnonzero(self.soft) + 1:
            here = np.flatnonzero(problem.segment == k)
            length = np.linalg.norm(state.centres[problem.parents.index(k)])
            height = np.clip(1 + state.local[here] @ problem.long_axes[k - 1] / length, 0, 1.2)
            covariance = _SCATTER**2 * np.eye(len(here)) + _SLOPE**2 * np.outer(height, height)
            root[np.ix_(here, here)] = np.linalg.cholesky(np.linalg.inv(covariance)).T
        return root
