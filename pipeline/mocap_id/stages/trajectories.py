"""The long planar table as arrays: every kinematic stage starts here."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from mocap_id.kinematics import find_bursts, frames_along_motion
from mocap_id.store import Table


@dataclass(frozen=True)
class PlanarView:
    """The coordinates of a ``planar.parquet`` where they stand: for a stage that cannot afford a copy.

    Parameters
    ----------
    frames : (F,) int array
        The file's own frame numbers.
    time : (F,) array
        s, the recording's clock.
    labels : tuple of str
        The M markers.
    x, y, z : (F, M) array
        Along the motion, up, and out of the plane, m; NaN where unseen. Not to be written to.
    rate : float
        Frames per second.
    """

    frames: IntArray
    time: FloatArray
    labels: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    z: FloatArray
    rate: float

    @classmethod
    def of(cls, planar: Table) -> PlanarView:
        """Views of a table whose rows are sorted by frame, every frame holding every marker."""
        frame = planar.frame
        count = len(frame["marker"].cat.categories)
        labels = tuple(str(label) for label in frame["marker"].iloc[:count])
        frames, time = (frame[name].to_numpy()[::count].copy() for name in ("frame", "time"))
        x, y, z = (frame[name].to_numpy(dtype=np.float64).reshape(-1, count) for name in ("x", "y", "z"))
        return cls(frames, time, labels, x, y, z, float(planar.facts["rate_hz"]))

    def points(self, markers: IntArray, frames: slice = slice(None)) -> FloatArray:
        """(f, m, 2) copy of some markers, by their columns, m."""
        found = np.empty((len(self.x[frames]), len(markers), 2))
        for axis, values in enumerate((self.x, self.y)):
            found[..., axis] = values[frames, markers]
        return found

    def without_bursts(self, markers: IntArray) -> FloatArray:
        """(F, m, 2) copy of some markers, m; NaN also where they jump there and back."""
        found = self.points(markers)
        for k, marker in enumerate(markers):
            track = np.stack([self.x[:, marker], self.y[:, marker], self.z[:, marker]], axis=1)
            found[find_bursts(track[:, None], self.rate)[:, 0], k] = np.nan
        return found


@dataclass(frozen=True)
class Trajectories:
    """Marker trajectories in the plane frame.

    Parameters
    ----------
    frames : (F,) int array
        The file's own frame numbers.
    time : (F,) array
        s, the recording's clock.
    labels : tuple of str
        The M markers.
    points : (F, M, 3) array
        x along the motion, y up, z out of the plane, m; NaN where unseen.
    rate : float
        Frames per second.
    """

    frames: IntArray
    time: FloatArray
    labels: tuple[str, ...]
    points: FloatArray
    rate: float

    @classmethod
    def of(cls, planar: Table) -> Trajectories:
        """Arrays of a ``planar.parquet``, whose rows are sorted by frame, every frame holding every marker."""
        view = PlanarView.of(planar)
        points = planar.frame[["x", "y", "z"]].to_numpy(dtype=np.float64).reshape(-1, len(view.labels), 3)
        return cls(view.frames, view.time, view.labels, points, view.rate)

    @property
    def plane(self) -> ComplexArray:
        """(F, M) complex ``x + i y``, m."""
        return np.asarray(self.points[..., 0] + 1j * self.points[..., 1])

    def without_bursts(self) -> Trajectories:
        """The same with jumps there and back taken for unseen."""
        points = self.points.copy()
        points[find_bursts(points, self.rate)] = np.nan
        return replace(self, points=points)

    def along_motion(self, count: int, useful: BoolArray) -> Trajectories:
        """``count`` of the useful frames (F,), evenly along the way of the markers; all where there are fewer."""
        candidates = np.flatnonzero(useful)
        if len(candidates) <= count:
            return self
        return self._at(frames_along_motion(self.plane, count, candidates))

    def thinned(self, count: int) -> Trajectories:
        """At most ``count`` frames, evenly over the trial."""
        if len(self.frames) <= count:
            return self
        return self._at(np.unique(np.linspace(0, len(self.frames) - 1, count).round().astype(np.int64)))

    def _at(self, kept: IntArray) -> Trajectories:
        return replace(self, frames=self.frames[kept], time=self.time[kept], points=self.points[kept])
