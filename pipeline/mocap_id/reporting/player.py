"""The page's player: what moves at moments that an eye can follow, and curves with a line at the time shown."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Line, Panel, Points, Rule, to_json
from mocap_id.reporting.figures import states, wrench
from mocap_id.reporting.figures.skeleton import ALONG, UP
from mocap_id.reporting.material import Material
from mocap_id.reporting.tracks import tracks

RATE = 30.0
"""Moments per second, at most."""
MOST = 1800
"""Moments, at most: a minute at :data:`RATE`; longer recordings are shown at longer steps."""
_VALUES = 900_000
"""Numbers in all moments together, at most: 2.4 MB as text."""
_UNKNOWN = -32768
_REACH = 0.45  # of the figure's height, for the largest force
_TALL, _LOW = 5.9, 1.12  # inches, of the figure and of each curve beside it
_SHAPE = 0.54  # of the figure: its width by its height


@dataclass(frozen=True)
class Part:
    """Lines or points that move together: how they look, and where they are at K moments, (K, 2, rows), m."""

    name: str
    look: Mapping[str, Any]
    values: FloatArray

    @property
    def item(self) -> Line | Points:
        """The part as the figure draws it first."""
        made = Points if "symbol" in self.look else Line
        return made(*self.values[0], **self.look)


@dataclass(frozen=True)
class Player:
    """What moves, at K moments, and what is known over time.

    Parameters
    ----------
    time : (K,) array
        s.
    parts : tuple of Part
    curves : tuple of Panel
        Angles, wrench and centre of pressure; none where nothing is known over time.
    newton_per_metre : float or None
        Force that an arrow of one metre stands for; None where there are no forces.
    motion : str
        A sentence on what moves the figure and the model; empty where nothing was identified.
    """

    time: FloatArray
    parts: tuple[Part, ...]
    curves: tuple[Panel, ...]
    newton_per_metre: float | None
    motion: str

    def to_json(self) -> Mapping[str, Any]:
        """For the page: the figure, the curves, and the moments as 16-bit numbers, one row a moment, by part x and y.

        A step of these numbers is smaller than an eye could see.
        """
        rows = np.concatenate([part.values.reshape(len(self.time), -1) for part in self.parts], axis=1)
        known = np.isfinite(rows)
        step = max(float(np.abs(rows[known]).max(initial=0.0)), 1e-6) / 32767
        whole = np.where(known, np.round(np.where(known, rows, 0.0) / step), _UNKNOWN).astype("<i2")
        curves = Figure(tuple((panel,) for panel in self.curves))
        return {
            "figure": to_json(Figure(((self._panel(),),))),
            "curves": to_json(curves) if self.curves else None,
            "time": [round(float(moment), 4) for moment in self.time],
            "values": base64.b64encode(whole.tobytes()).decode("ascii"),
            "step": step,
            "unknown": _UNKNOWN,
            "rows": [part.values.shape[2] for part in self.parts],
        }

    def _panel(self) -> Panel:
        """Sticks, joints, markers and arrows over the ground."""
        x, y = _to_scale(bounds(self.parts))
        items = (Rule("y", 0.0, style.FAINT), *(part.item for part in self.parts))
        return Panel(items, x=ALONG, y=UP, x_range=x, y_range=y, equal=True, height=_TALL)


def player(material: Material) -> Player | None:
    """The moments of a trial; None where nothing moves, not even markers."""
    planar = material.long("planar.parquet")
    if planar is None or not len(planar.labels):
        return None
    time = _moments(planar.time, len(planar.labels))
    if len(time) < 2:
        return None
    labels = tuple(str(label) for label in planar.labels)
    moving = [*_chain(material, time), *_markers(material, labels, tracks(planar, time, labels))]
    scale, forces = _forces(material, time, float(np.ptp(bounds(moving)[1])))
    return Player(time, (*moving, *forces), _curves(material), scale, _motion(material))


def bounds(parts: Sequence[Part]) -> FloatArray:
    """Lowest and highest x, and y, of all that moves, (2, 2), m; outliers aside."""
    seen = [part.values for part in parts if not part.name.startswith("force")]
    points = np.concatenate([values.swapaxes(1, 2).reshape(-1, 2) for values in seen])
    points = points[np.isfinite(points).all(axis=1)]
    found: FloatArray = np.quantile(points, (0.001, 0.999), axis=0).T if len(points) else np.array([[-1, 1], [0, 2]])
    return found


def _to_scale(found: FloatArray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ranges of x and y that hold the bounds and the ground in a figure of the player's shape."""
    low, high = np.minimum(found[:, 0], [np.inf, 0.0]), np.maximum(found[:, 1], [-np.inf, 0.0])
    shape = np.array([_SHAPE, 1.0])
    half = 0.56 * max(float(np.max((high - low) / shape)), 1e-3) * shape
    (left, below), (right, above) = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    return (float(left), float(right)), (float(below), float(above))


def _moments(time: FloatArray, markers: int) -> FloatArray:
    """Evenly spread samples of the recording's own times."""
    if len(time) < 2:
        return time
    wanted = int((time[-1] - time[0]) * RATE) + 1
    count = max(2, min(len(time), wanted, MOST, _VALUES // (2 * markers + 32)))
    return time[np.unique(np.linspace(0, len(time) - 1, count).round().astype(np.int64))]


def _chain(material: Material, time: FloatArray) -> list[Part]:
    """Sticks from joint to joint and to the middle of the last segment's markers, and the joints."""
    skeleton, motion = material.skeleton, material.motion
    if skeleton is None or motion is None or not len(motion.time):
        return []
    angle, origin = segment_poses(motion.angles[_nearest(motion.time, time)], skeleton.centres)
    tip = origin[:, -1] + rotate(angle[:, -1], skeleton.tip)
    points = np.concatenate([origin[:, 1:], tip[:, None]], axis=1).swapaxes(1, 2)  # (K, 2, n + 1)
    sticks = [
        Part("stick", {"colour": style.colour(j + 1), "label": style.printable(name, 20), "width": 5.0, "opacity": 0.6},
             points[..., j : j + 2])
        for j, name in enumerate(skeleton.joints)
    ]  # fmt: skip
    return [*sticks, Part("joints", {"colour": style.INK, "symbol": "ring", "size": 10.0}, points[..., :-1])]


def _markers(material: Material, labels: tuple[str, ...], values: FloatArray) -> list[Part]:
    """The markers (K, M, 2) of each segment, and crosses for those of none."""
    skeleton = material.skeleton
    known = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    segments = np.array([known.get(label, -1) for label in labels])
    parts = []
    for k in np.unique(segments).tolist():
        own = np.flatnonzero(segments == k)
        names = tuple(style.printable(labels[i], 24) for i in own)
        look = {"colour": style.colour(k), "symbol": "x" if k < 0 else "dot", "size": 3.7, "names": names}
        parts.append(Part("markers", look, values[:, own].swapaxes(1, 2)))
    return parts


def _forces(material: Material, time: FloatArray, height: float) -> tuple[float | None, list[Part]]:
    """Arrows of the ground's force from the centre of pressure, measured and by the model; N per metre of arrow."""
    table = wrench.forces(material)
    if table is None or not table.length:
        return None, []
    row = _nearest(table["time"], time)
    found = {
        suffix: table.stack(columns)[row]
        for suffix in ("", "_model")
        if set(columns := [f"{name}{suffix}" for name in ("cop_x", "Fx", "Fy")]) <= set(table.names)
    }
    largest = np.nanmax(np.abs(found[""][:, 2]), initial=0.0) if "" in found else 0.0
    if not largest > 0 or not height > 0:
        return None, []
    scale = float(largest) / (_REACH * height)
    parts = []
    for suffix, force in found.items():
        colour, label = (style.MODEL, "identified model") if suffix else (style.MEASURED, "measured")
        arrow = _arrows(force, scale)
        look = {"colour": colour, "label": label, "width": 1.6 if suffix else 2.2}
        parts += [
            Part(f"force{suffix}", look, arrow),
            Part("force's foot", {"colour": colour, "symbol": "dot", "size": 5.0}, arrow[..., :1]),
        ]
    return scale, parts


def _arrows(force: FloatArray, scale: float) -> FloatArray:
    """Start and end of arrows, (K, 2, 2), m, of (cop_x, Fx, Fy)."""
    cop, Fx, Fy = force.T
    start = np.where(np.isfinite(force.sum(axis=1)), 0.0, np.nan)
    ends = [[cop, cop + Fx / scale], [start, start + Fy / scale]]
    return np.moveaxis(np.array(ends), -1, 0)


def _curves(material: Material) -> tuple[Panel, ...]:
    motion = material.motion
    told = motion is not None and motion.mean.size
    angles = [states.panel(motion, 0, states.joint_names(material), _LOW)] if motion is not None and told else []
    forces = [panel for panel in wrench.panels(material, _LOW) if any(isinstance(item, Line) for item in panel.items)]
    return (*angles, *forces)


def _motion(material: Material) -> str:
    if material.measured_poses:
        return "The stick figure is the pinned chain; the model's forces rest on the measured poses."
    known = material.facts("dynamics.h5").get("motion") is not None
    return "Stick figure and model move as the pinned chain." if known else ""


def _nearest(clock: FloatArray, time: FloatArray) -> IntArray:
    """Sample of ``clock`` (T,) nearest to each ``time`` (K,)."""
    after = np.searchsorted(clock, time).clip(1, max(len(clock) - 1, 1))
    before = after - 1
    after = after.clip(0, len(clock) - 1)
    nearer = np.abs(clock[before] - time) <= np.abs(clock[after] - time)
    return np.where(nearer, before, after).astype(np.int64)
