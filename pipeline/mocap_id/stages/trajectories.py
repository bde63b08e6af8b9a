"""The markers of a ``planar.parquet`` as later stages see them: without the jumps that planarise found."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from mocap_id.store import LongTable


@dataclass(frozen=True)
class PlanarView:
    """The coordinates of a ``planar.parquet`` where they stand: every copy is of the markers and frames asked for."""

    planar: LongTable

    @property
    def frames(self) -> IntArray:
        """(F,) the file's own frame numbers."""
        return self.planar.frames

    @property
    def time(self) -> FloatArray:
        """(F,) s, the recording's clock."""
        return self.planar.time

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The M markers."""
        return tuple(self.planar.labels)

    @property
    def rate(self) -> float:
        """Frames per second."""
        return float(self.planar.facts["rate_hz"])

    @cached_property
    def bursts(self) -> BoolArray:
        """(F, M) between a jump away and the jump back, by the times that the facts name; none where they name none."""
        out = np.zeros((len(self.frames), len(self.labels)), dtype=np.bool_)
        for label, times in self.planar.facts.get("bursts", {}).items():
            for first, last in times:
                inside = slice(np.searchsorted(self.time, first), np.searchsorted(self.time, last, "right"))
                out[inside, self.labels.index(label)] = True
        return out

    def points(self, markers: IntArray, frames: slice = slice(None)) -> FloatArray:
        """(f, m, 2) copy of some markers, by their columns, m."""
        found = np.empty((len(self.time[frames]), len(markers), 2))
        for axis, name in enumerate("xy"):
            found[..., axis] = self.planar.values[name][frames, markers]
        return found

    def without_bursts(self, markers: IntArray) -> FloatArray:
        """(F, m, 2) copy of some markers, m; NaN also where they jump."""
        found = self.points(markers)
        found[self.bursts[:, markers]] = np.nan
        return found

    def plane(self) -> ComplexArray:
        """(F, M) copy ``x + i y`` of all markers, m; NaN also where they jump."""
        found = self.planar.values["x"] + 1j * self.planar.values["y"]
        found[self.bursts] = np.nan
        return found

    def spaced(self, count: int) -> FloatArray:
        """(f, M, 3) at most ``count`` frames, evenly over the trial, m; NaN also where a marker jumps."""
        every = np.arange(len(self.frames))
        kept = every if len(every) <= count else np.unique(np.linspace(0, every[-1], count).round().astype(np.int64))
        found = np.stack([np.asarray(self.planar.values[name][kept], np.float64) for name in "xyz"], axis=2)
        found[self.bursts[kept]] = np.nan
        return found
