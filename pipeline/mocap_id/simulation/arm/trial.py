"""A simulated trial in space, in memory: the recording and the exact truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.simulation.arm.markers import marker_set
from mocap_id.simulation.arm.options import Difficulty
from mocap_id.simulation.cameras import Burst, draw_bursts, find_visible, measure_positions

_OCCLUSIONS = 0.4 / 24  # times the usual number of bursts, for one marker


@dataclass(frozen=True)
class SpatialTrial:
    """A trial of S segments and M markers at F frames; all vectors are in laboratory axes with z up."""

    labels: tuple[str, ...]  # names of the markers in the file
    names: tuple[str, ...]  # names of the landmarks and cluster markers, also if the recording is anonymous
    rate: float  # Hz
    time: FloatArray  # (F,) s
    positions: FloatArray  # (F, M, 3) measured positions, m; NaN where a marker was not seen
    true_positions: FloatArray  # (F, M, 3) positions with soft tissue, without noise and occlusions, m
    bursts: tuple[Burst, ...]  # occlusions
    segments: tuple[str, ...]
    assignment: IntArray  # (M,) segment of every marker
    local: FloatArray  # (M, 3) positions in the segments' frames while the body is still at the start, m
    skin: FloatArray  # (F, M, 3) displacement by soft tissue in the segments' frames, m
    origins: FloatArray  # (F, S, 3) origins of the segments' frames, m
    rotations: FloatArray  # (F, S, 3, 3) from the segment to the laboratory
    omega: FloatArray  # (F, S, 3) angular velocities, rad/s
    alpha: FloatArray  # (F, S, 3) angular accelerations, rad/s²
    angles: Mapping[str, FloatArray]  # angles (F,) by their names in angles.parquet, rad; empty for a plain chain
    rates: Mapping[str, FloatArray]  # their first derivatives, rad/s
    accelerations: Mapping[str, FloatArray]  # their second derivatives, rad/s²
    arrays: Mapping[str, FloatArray]  # further arrays of truth.npz
    document: Mapping[str, Any]  # further entries of truth.json
    still: float  # duration of the rest at the start, s


def transform_points(origins: FloatArray, rotations: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return points (F, M, 3) in the laboratory from positions ``local`` (F, M, 3) in their segments' frames."""
    return np.asarray(origins[:, segment] + np.einsum("fmij,fmj->fmi", rotations[:, segment], local))


def film_markers(
    rng: np.random.Generator, labels: tuple[str, ...], positions: FloatArray, rate: float, sizes: Difficulty
) -> tuple[FloatArray, tuple[Burst, ...]]:
    """Return measured positions (F, M, 3), m, and the occlusions, in which the positions are NaN."""
    frames, count = positions.shape[:2]
    markers = marker_set(labels, np.zeros(count, dtype=np.int64), np.zeros((count, 3)), np.zeros(count))
    often = sizes.occlusions * count * _OCCLUSIONS
    bursts = draw_bursts(rng, markers, frames, rate, often)
    return measure_positions(rng, positions, sizes.marker_noise, find_visible(markers, bursts, frames)), bursts
