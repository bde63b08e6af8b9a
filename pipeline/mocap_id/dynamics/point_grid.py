"""Point-mass grid, which makes every fit physically consistent (eq. 4.12, 4.25).

A segment is a set of points with non-negative masses. Its m, mx, my, Izz therefore belong to a possible body (m·Izz ≥
mx² + my²) within the grid. The grid covers the segment's joints and markers with a margin for flesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS

_FLESH, _LEAST_FLESH = 0.1, 0.04  # margin: fraction of the box's longer side; least value, m


@dataclass(frozen=True)
class PointGrid:
    """Grid points of all segments."""

    segment: IntArray  # (p,) segment of each point, base first
    position: FloatArray  # (p, 2) position of each point in the frame of its segment, m
    segments: int  # number of segments, base included

    def moments(self) -> FloatArray:
        """Return the matrix P (4(n + 1), p) of eq. 4.12: full parameters = P · masses."""
        x, y = self.position.T
        values = np.stack([np.ones_like(x), x, y, x * x + y * y])  # (4, p)
        matrix = np.zeros((self.segments, len(PLANAR_PARAMETERS), len(x)))
        for segment in range(self.segments):
            own = self.segment == segment
            matrix[segment][:, own] = values[:, own]
        return matrix.reshape(-1, len(x))

    def boxes(self) -> FloatArray:
        """Return the lowest and the highest corner of each segment's points, (n + 1, 2, 2), m."""
        own = [self.position[self.segment == segment] for segment in range(self.segments)]
        return np.stack([[points.min(axis=0), points.max(axis=0)] for points in own])


def build_grid(
    centres: FloatArray, marker_segment: IntArray, marker_local: FloatArray, points: tuple[int, int] = (5, 9)
) -> PointGrid:
    """Return the grid over the box of each segment's joints and markers, with a margin for flesh.

    ``marker_local`` (M, 2) are the markers in the frames of their segments ``marker_segment`` (M,), m. ``points`` are
    the numbers of points along the short and the long side of the box.
    """
    segments = len(centres) + 1
    boxes = [_fill_box(k, centres, marker_local[marker_segment == k], points) for k in range(segments)]
    return PointGrid(
        segment=np.repeat(np.arange(segments), [len(box) for box in boxes]),
        position=np.concatenate(boxes),
        segments=segments,
    )


def _fill_box(segment: int, centres: FloatArray, markers: FloatArray, points: tuple[int, int]) -> FloatArray:
    """Return the grid points (p, 2) of one segment."""
    corners = [np.zeros((1, 2)), markers.reshape(-1, 2)]
    if segment < len(centres):
        corners.append(centres[segment][None])
    known = np.concatenate(corners)
    low, high = known.min(axis=0), known.max(axis=0)
    flesh = max(_LEAST_FLESH, _FLESH * float(np.max(high - low)))
    low, high = low - flesh, high + flesh
    across, along = points
    counts = (across, along) if high[1] - low[1] >= high[0] - low[0] else (along, across)
    x, y = (np.linspace(low[i], high[i], counts[i]) for i in (0, 1))
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
