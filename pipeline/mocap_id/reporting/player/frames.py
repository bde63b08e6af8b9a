"""What moves in the player: sticks, joints, markers and forces at moments that an eye can follow."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.reporting.material import Material
from mocap_id.reporting.tracks import tracks
from mocap_id.reporting.views import Motion, Skeleton

RATE = 30.0
"""Moments per second, at most."""
MOST = 1800
"""Moments, at most: a minute at :data:`RATE`; longer recordings are shown at longer steps."""
_VALUES = 900_000
"""Numbers in all moments together, at most: 2.4 MB as text."""
_UNKNOWN = -32768
_REACH = 0.45  # of the figure's height, for the largest force


@dataclass(frozen=True)
class Part:
    """Things of one kind that move; ``values`` is (K, C, rows), m, with a column for each name."""

    source: str
    columns: tuple[str, ...]
    values: FloatArray


@dataclass(frozen=True)
class Frames:
    """What moves, at K moments."""

    time: FloatArray  # (K,)
    parts: tuple[Part, ...]
    labels: tuple[str, ...]  # of the markers
    segments: IntArray  # of the markers; -1 = none
    newton_per_metre: float | None
    """Force that an arrow of one metre stands for; None where there are no forces."""

    @property
    def bounds(self) -> FloatArray:
        """Lowest and highest x, and y, of markers and joints, (2, 2), m; outliers aside."""
        seen = [part.values.swapaxes(1, 2).reshape(-1, 2) for part in self.parts if part.columns == ("x", "y")]
        points = np.concatenate(seen)
        points = points[np.isfinite(points).all(axis=1)]
        found: FloatArray = (
            np.quantile(points, (0.001, 0.999), axis=0).T if len(points) else np.array([[-1, 1], [0, 2]])
        )
        return found

    def packed(self) -> Mapping[str, Any]:
        """The moments as JSON: 16-bit numbers, one row a moment, of steps that lose nothing an eye could see."""
        rows = np.concatenate([part.values.reshape(len(self.time), -1) for part in self.parts], axis=1)
        known = np.isfinite(rows)
        step = max(float(np.abs(rows[known]).max(initial=0.0)), 1e-6) / 32767
        whole = np.where(known, np.round(np.where(known, rows, 0.0) / step), _UNKNOWN).astype("<i2")
        return {
            "time": [round(float(moment), 4) for moment in self.time],
            "values": base64.b64encode(whole.tobytes()).decode("ascii"),
            "step": step,
            "unknown": _UNKNOWN,
            "parts": [
                {"source": part.source, "columns": part.columns, "rows": part.values.shape[2]} for part in self.parts
            ],
        }


def frames(material: Material) -> Frames | None:
    """The moments of a trial; None where nothing moves, not even markers."""
    planar, skeleton, motion = material.frame("planar.parquet"), material.skeleton, material.motion
    if planar is None or planar.empty:
        return None
    own = planar["time"].to_numpy(dtype=np.float64)
    labels = tuple(str(label) for label in planar["marker"].cat.categories)
    time = _moments(np.unique(own), len(labels))
    if len(time) < 2:
        return None
    parts = [Part("markers", ("x", "y"), tracks(planar, time, labels).swapaxes(1, 2))]
    if skeleton is not None and motion is not None and len(motion.time):
        parts = [*_chain(skeleton, motion, time), *parts]
    known = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    segments = np.array([known.get(label, -1) for label in labels], dtype=np.int64)
    whole = Frames(time, tuple(parts), labels, segments, None)
    scale, forces = _forces(material, time, float(np.ptp(whole.bounds[1])))
    return Frames(time, (*parts, *forces), labels, segments, scale)


def _moments(time: FloatArray, markers: int) -> FloatArray:
    """Evenly spread samples of the recording's own times."""
    if len(time) < 2:
        return time
    wanted = int((time[-1] - time[0]) * RATE) + 1
    count = max(2, min(len(time), wanted, MOST, _VALUES // (2 * markers + 32)))
    return time[np.unique(np.linspace(0, len(time) - 1, count).round().astype(np.int64))]


def _chain(skeleton: Skeleton, motion: Motion, time: FloatArray) -> tuple[Part, Part]:
    """Sticks from joint to joint and to the middle of the last segment's markers, and the joints."""
    angles = motion.angles[_nearest(motion.time, time)]  # (K, n)
    angle, origin = segment_poses(angles, skeleton.centres)  # (K, n + 1), (K, n + 1, 2)
    tip = origin[:, -1] + rotate(angle[:, -1], skeleton.tip)
    points = np.concatenate([origin[:, 1:], tip[:, None]], axis=1).swapaxes(1, 2)  # (K, 2, n + 1)
    sticks = np.concatenate([points[..., :-1], points[..., 1:]], axis=1)
    return Part("sticks", ("x0", "y0", "x1", "y1"), sticks), Part("joints", ("x", "y"), points[..., :-1])


def _forces(material: Material, time: FloatArray, height: float) -> tuple[float | None, list[Part]]:
    """Arrows of the ground's force from the centre of pressure, measured and by the model; N per metre of arrow."""
    table = material.frame("dynamics.parquet")
    table = material.frame("wrench.parquet") if table is None else table
    if table is None or table.empty:
        return None, []
    rows = table.iloc[_nearest(table["time"].to_numpy(dtype=np.float64), time)]
    found = {}
    for name, suffix in (("measured", ""), ("model", "_model")):
        columns = [f"{column}{suffix}" for column in ("cop_x", "Fx", "Fy")]
        if set(columns) <= set(rows.columns):
            found[name] = rows[columns].to_numpy(dtype=np.float64)  # (K, 3)
    largest = np.nanmax(np.abs(found["measured"][:, 2]), initial=0.0) if "measured" in found else 0.0
    if not largest > 0 or not height > 0:
        return None, []
    scale = float(largest) / (_REACH * height)
    ends = ("x0", "y0", "x1", "y1")
    return scale, [Part(name, ends, _arrows(force, scale)) for name, force in found.items()]


def _arrows(force: FloatArray, scale: float) -> FloatArray:
    """Start and end of arrows, (K, 4, 1), m, of (cop_x, Fx, Fy)."""
    cop, Fx, Fy = force.T
    start = np.where(np.isfinite(force.sum(axis=1)), 0.0, np.nan)
    return np.stack([cop, start, cop + Fx / scale, start + Fy / scale], axis=1)[..., None]


def _nearest(clock: FloatArray, time: FloatArray) -> IntArray:
    """Sample of ``clock`` (T,) nearest to each ``time`` (K,)."""
    after = np.searchsorted(clock, time).clip(1, max(len(clock) - 1, 1))
    before = after - 1
    after = after.clip(0, len(clock) - 1)
    nearer = np.abs(clock[before] - time) <= np.abs(clock[after] - time)
    return np.where(nearer, before, after).astype(np.int64)
