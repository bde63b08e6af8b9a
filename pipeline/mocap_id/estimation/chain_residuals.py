"""Residuals of the markers in their segments' frames, without the part that depends on the posture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, as_complex, as_xy
from mocap_id.estimation.smoothing import States
from mocap_id.geometry.planar import segment_poses

_RIDGE = 1e-9  # added to the diagonal of the regression, relative to it, for angles that do not move
_LEAST = 10  # frames per unknown of a regression


@dataclass(frozen=True)
class ChainResiduals:
    """Differences of the markers from the positions that the chain predicts."""

    states: States
    used_markers: FloatArray  # (F, M, 2) markers used for the states, plane frame, m; NaN elsewhere
    rate: float  # frames per second

    @cached_property
    def _posture(self) -> FloatArray:
        """Linear and quadratic functions (F, P) of the angles; zero in frames in which an angle is missing."""
        angles = self.states.mean[..., 0]
        given = np.isfinite(angles)
        centred = angles - np.sum(angles, axis=0, where=given) / np.maximum(np.sum(given, axis=0), 1)
        products = [centred[:, i] * centred[:, j] for i in range(centred.shape[1]) for j in range(i, centred.shape[1])]
        basis = np.column_stack([np.ones(len(centred)), centred, *products])
        basis[~np.isfinite(basis).all(axis=1)] = 0
        return np.asarray(basis / np.sqrt(np.mean(basis**2, axis=0) + 1e-30))

    def columns(self) -> Iterator[tuple[int, ComplexArray, BoolArray]]:
        """Yield for each marker with enough samples: its index, its residual (F,), m, and whether each frame uses it.

        The residual is x + 1j y in the segment's axes, interpolated in gaps. The part that is a quadratic function of
        the joint angles is removed, because it is attributed to sliding skin (:mod:`mocap_id.kinematics.skin_slides`).
        """
        chain, basis = self.states.chain, self._posture
        rotation, origin = segment_poses(self.states.mean[..., 0], chain.centres)
        every, whole = np.arange(len(rotation)), basis.T @ basis
        for segment in np.unique(chain.segment):
            back, start = np.exp(-1j * rotation[:, segment]), as_complex(origin[:, segment])
            for k in np.flatnonzero(chain.segment == segment):
                off = (as_complex(self.used_markers[:, k]) - start) * back - complex(*chain.local[k])
                seen: BoolArray = np.isfinite(off)
                if np.count_nonzero(seen) < _LEAST * basis.shape[1]:
                    continue
                missing = np.flatnonzero(~seen)
                off[missing] = 0
                square = whole - basis[missing].T @ basis[missing] + _RIDGE * len(basis) * np.eye(basis.shape[1])
                off -= as_complex(basis @ np.linalg.solve(square, basis.T @ as_xy(off)))
                if missing.size:
                    off[missing] = np.interp(missing, every[seen], off[seen])
                yield int(k), off, seen
