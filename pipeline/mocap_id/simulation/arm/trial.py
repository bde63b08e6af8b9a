"""A simulated trial in space, in memory: what the cameras saw, and the exact truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.simulation.arm.markers import marker_set
from mocap_id.simulation.arm.options import Difficulty
from mocap_id.simulation.cameras import Burst, draw_bursts, measure_positions, visibility

_OCCLUSIONS = 0.4 / 24  # times the usual number of bursts, for one marker


@dataclass(frozen=True)
class SpatialTrial:
    """A trial of S segments and M markers at F frames; all vectors in laboratory axes with z up.

    Parameters
    ----------
    labels, names : tuples of str, length M
        Names in the file, and what the markers are.
    rate : float
        Hz.
    time : (F,) array
        s.
    positions : (F, M, 3) array
        Measured positions, m; NaN where a marker was not seen.
    true_positions : (F, M, 3) array
        Without noise and occlusions, with soft tissue, m.
    bursts : tuple of Burst
        Occlusions.
    segments : tuple of str, length S
    assignment : (M,) int array
        Segment of every marker.
    local : (M, 3) array
        Marker positions in the segments' frames in the still start, m.
    skin : (F, M, 3) array
        Displacement by soft tissue in the segments' frames, m.
    origins : (F, S, 3) array
        Origins of the segments' frames, m.
    rotations : (F, S, 3, 3) array
        Segment to laboratory.
    omega, alpha : (F, S, 3) arrays
        Angular velocities and accelerations, rad/s and rad/s².
    angles, rates, accelerations : mappings from str to (F,) array
        Angles as ``angles.parquet`` names them, rad, and their derivatives; empty for a plain chain.
    arrays : mapping from str to array
        Further arrays of ``truth.npz``.
    document : mapping
        Further entries of ``truth.json``.
    still : float
        Duration of the still start, s.
    """

    labels: tuple[str, ...]
    names: tuple[str, ...]
    rate: float
    time: FloatArray
    positions: FloatArray
    true_positions: FloatArray
    bursts: tuple[Burst, ...]
    segments: tuple[str, ...]
    assignment: IntArray
    local: FloatArray
    skin: FloatArray
    origins: FloatArray
    rotations: FloatArray
    omega: FloatArray
    alpha: FloatArray
    angles: Mapping[str, FloatArray]
    rates: Mapping[str, FloatArray]
    accelerations: Mapping[str, FloatArray]
    arrays: Mapping[str, FloatArray]
    document: Mapping[str, Any]
    still: float


def carry(origins: FloatArray, rotations: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return points (F, M, 3) in the laboratory; ``local`` (F, M, 3) is in the segments' frames."""
    points: FloatArray = origins[:, segment] + np.einsum("fmij,fmj->fmi", rotations[:, segment], local)
    return points


def film(
    rng: np.random.Generator, labels: tuple[str, ...], positions: FloatArray, rate: float, sizes: Difficulty
) -> tuple[FloatArray, tuple[Burst, ...]]:
    """Return measured positions (F, M, 3), m, NaN where not visible, and the occlusions."""
    frames, count = positions.shape[:2]
    markers = marker_set(labels, np.zeros(count, dtype=np.int64), np.zeros((count, 3)), np.zeros(count))
    often = sizes.occlusions * count * _OCCLUSIONS
    bursts = draw_bursts(rng, markers, frames, rate, often)
    return measure_positions(rng, positions, sizes.marker_noise, visibility(markers, bursts, frames)), bursts
