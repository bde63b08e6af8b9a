"""Faults of a recording: bad markers, a base that moves, wrong rates, gains and corners, filtered or coloured noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.simulation.joint_motion import smoothstep
from mocap_id.simulation.markers import MarkerSet
from mocap_id.simulation.options import FaultOptions
from mocap_id.simulation.schedule import Schedule

if TYPE_CHECKING:
    from mocap_id.simulation.scene import Scene

GHOST = "GHOST"
"""Label of a trajectory that is no marker."""

_WOBBLE_HZ = 4.0


@dataclass(frozen=True)
class Displacement:
    """Displacement of the whole person from the true chain.

    Parameters
    ----------
    shift : (T,) array
        Along the motion, m.
    turn : (T,) array
        About the vertical through the plane's origin, rad.
    lean : float
        About the motion's direction through the plane's origin, rad.
    """

    shift: FloatArray
    turn: FloatArray
    lean: float

    def positions(self, points: FloatArray) -> FloatArray:
        """Return displaced positions (T, M, 3) in the plane frame, m."""
        return _leaned(_turned(points + self.shift[:, None, None] * (1.0, 0.0, 0.0), self.turn[:, None]), self.lean)

    def load(
        self, force: FloatArray, moment: FloatArray, weight: float, com: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the ground's force and moment (T, 3) on the displaced person, about the origin of the plane frame.

        The weight stays vertical.

        Parameters
        ----------
        force, moment : (T, 3) arrays
            Of the ground on the upright person, N, N·m.
        weight : float
            N.
        com : (T, 3) array
            Centre of mass, m.
        """
        moment = moment + np.cross(self.shift[:, None] * (1.0, 0.0, 0.0), force)
        force, moment = _turned(force, self.turn), _turned(moment, self.turn)
        up = np.array([0.0, weight, 0.0])
        com = _turned(com + self.shift[:, None] * (1.0, 0.0, 0.0), self.turn)
        leaned = _leaned(com, self.lean)
        return (
            _leaned(force - up, self.lean) + up,
            _leaned(moment - np.cross(com, up), self.lean) + np.cross(leaned, up),
        )


def draw_displacement(
    seed: int, faults: FaultOptions, schedule: Schedule | None, time: FloatArray
) -> Displacement | None:
    """Draw the displacement at times (T,), s; it changes only while the person sits. None if there is none."""
    if not (faults.foot_slide_mm or faults.foot_moves_mm or faults.turn_deg or faults.plane_tilt_deg):
        return None
    rng = np.random.default_rng(seed)
    shift, turn = np.zeros_like(time), np.zeros_like(time)
    done = () if schedule is None else schedule.repetitions
    gaps = [(before.sit_end, after.rise_start) for before, after in pairwise(done)]
    at = np.zeros(len(gaps) + 1)
    if gaps and faults.foot_slide_mm:
        at[1 + int(rng.integers(len(gaps))) :] += faults.foot_slide_mm / 1e3 * rng.choice((-1, 1))
    if gaps and faults.foot_moves_mm:
        at[1:] += rng.uniform(-1, 1, len(gaps)) * faults.foot_moves_mm / 1e3
    for k, (begin, end) in enumerate(gaps):
        step = smoothstep((time - begin) / (end - begin))
        shift += (at[k + 1] - at[k]) * step
        if k == (len(gaps) - 1) // 2:
            turn += np.radians(faults.turn_deg) * step
    return Displacement(shift + at[0], turn, float(np.radians(faults.plane_tilt_deg)))


def _turned(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors (..., 3) of the plane frame turned about its y."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x + s * z, y, -s * x + c * z], axis=-1)


def _leaned(vectors: FloatArray, angle: float) -> FloatArray:
    """Return vectors (..., 3) of the plane frame turned about its x."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x, c * y - s * z, s * y + c * z], axis=-1)


def skin_faults(rng: np.random.Generator, faults: FaultOptions, markers: MarkerSet, time: FloatArray) -> FloatArray:
    """Return displacements (T, M, 3) in the links' frames, m: a reattached marker, and wobbling skin."""
    added = np.zeros((len(time), len(markers.labels), 3))
    if faults.reattached_mm:
        marker = _moving(rng, markers)
        away = rng.normal(size=3) * (1, 1, 0.3)
        since = time >= time[0] + rng.uniform(0.3, 0.7) * np.ptp(time)
        added[since, marker] += faults.reattached_mm / 1e3 * away / np.linalg.norm(away)
    if faults.wobble_mm:
        for link in range(1, int(markers.link.max()) + 1):
            swell = 1 + 0.5 * np.sin(2 * np.pi * rng.uniform(0.1, 0.3) * time + rng.uniform(0, 6.3))
            wave = swell * np.sin(2 * np.pi * _WOBBLE_HZ * rng.uniform(0.9, 1.1) * time + rng.uniform(0, 6.3))
            direction = rng.normal(size=3)
            wobble = np.sqrt(2) * faults.wobble_mm / 1e3 * wave[:, None] * direction / np.linalg.norm(direction)
            added[:, markers.link == link] += wobble[:, None, :]
    return added


def camera_faults(
    rng: np.random.Generator, faults: FaultOptions, scene: Scene, points: FloatArray, rate: float
) -> tuple[tuple[str, ...], FloatArray, dict[str, Any]]:
    """Add the cameras' faults to measured positions.

    Parameters
    ----------
    rng : Generator
    faults : FaultOptions
    scene : Scene
    points : (T, M, 3) array
        Laboratory, m; NaN where not visible.
    rate : float
        Hz.

    Returns
    -------
    labels, points, truth
        With trajectories that are no markers last; the truth says which marker and when.
    """
    markers, truth = scene.markers, dict[str, Any]()
    points, labels, frames = points.copy(), markers.labels, len(points)
    if faults.wander_mm:
        frequency = rng.uniform(0.02, 0.5, (8, 1, *points.shape[1:]))
        phase = rng.uniform(0, 2 * np.pi, frequency.shape)
        waves = np.sin(2 * np.pi * frequency * (np.arange(frames) / rate)[:, None, None] + phase).sum(axis=0)
        points += faults.wander_mm / 1e3 * waves / 2
    if faults.frozen_s:
        marker, (first, last) = _moving(rng, markers), _stretch(rng, frames, faults.frozen_s * rate)
        seen = np.flatnonzero(np.isfinite(points[: last + 1, marker, 0]))
        points[first:last, marker] = points[seen[np.argmin(np.abs(seen - first))], marker]
        truth["frozen"] = {"label": labels[marker], "first_frame": first, "n_frames": last - first}
    if faults.mislabelled_s:
        one, other = rng.choice(np.flatnonzero(markers.link > 0), 2, replace=False)
        first, last = _stretch(rng, frames, faults.mislabelled_s * rate)
        points[first:last, [one, other]] = points[first:last, [other, one]]
        truth["mislabelled"] = {
            "labels": [labels[one], labels[other]],
            "first_frame": first,
            "n_frames": last - first,
        }
    ghosts = _ghosts(rng, faults, markers, points)
    if ghosts:
        points = np.concatenate([points, np.stack(ghosts, axis=1)], axis=1)
        labels = (*labels, *(f"{GHOST}{k + 1}" for k in range(len(ghosts))))
        truth["ghosts"] = list(labels[-len(ghosts) :])
    if faults.filter_hz:
        points = _filtered(points, faults.filter_hz, rate)
    if faults.repeated_share:
        source = np.maximum.accumulate(np.where(rng.uniform(size=frames) < faults.repeated_share, 0, np.arange(frames)))
        points = points[source]
    points *= 1 + faults.camera_scale
    if faults.tilt_deg:
        points = points @ _about(scene.plane.axes[2], np.radians(faults.tilt_deg)).T
    return labels, points, truth


def _ghosts(rng: np.random.Generator, faults: FaultOptions, markers: MarkerSet, points: FloatArray) -> list[FloatArray]:
    """Return trajectories (T, 3) that are no markers, m."""
    ghosts = []
    if faults.ghost_walks:
        start, end = rng.uniform(-1.5, 1.5, 3), rng.uniform(-1.5, 1.5, 3)
        start[2], end[2] = rng.uniform(0.2, 1.8, 2)
        ghosts.append(np.linspace(start, end, len(points)) + rng.normal(0, 5e-4, (len(points), 3)))
    if faults.ghost_reflects:
        marker, normal = _moving(rng, markers), rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        mirror = np.nanmean(points[:, marker], axis=0) + rng.uniform(0.1, 0.4) * normal
        ghosts.append(points[:, marker] - 2 * ((points[:, marker] - mirror) @ normal)[:, None] * normal)
    return ghosts


def plate_faults(faults: FaultOptions, signals: PlateSignals, along: FloatArray) -> PlateSignals:
    """Return the channels with their gains and offset, and the corners moved ``along`` (3,)."""
    gains = (1 + faults.gain) * np.array([1, 1, 1 + faults.gain_fz, *[1 + faults.gain_moments] * 3])
    offset = np.array([0, 0, faults.offset_fz_N, 0, 0, 0])
    corners = signals.corners + faults.corners_mm / 1e3 * along
    return replace(signals, channels=signals.channels * gains + offset, corners=corners)


def _moving(rng: np.random.Generator, markers: MarkerSet) -> int:
    return int(rng.choice(np.flatnonzero(markers.link > 0)))


def _stretch(rng: np.random.Generator, frames: int, count: float) -> tuple[int, int]:
    """Begin and end of ``count`` frames somewhere in the middle three quarters of the trial."""
    count = min(round(count), frames // 2)
    first = int(rng.integers(frames // 8, max(frames - frames // 8 - count, frames // 8 + 1)))
    return first, first + count


def _filtered(points: FloatArray, cut_off: float, rate: float) -> FloatArray:
    """Return the visible samples after a zero-phase Butterworth low-pass; gaps are bridged for it and stay gaps."""
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415  loads scipy.stats

    seen, time = np.isfinite(points), np.arange(len(points))
    out = points.copy()
    for marker in range(points.shape[1]):
        for axis in range(3):
            known = seen[:, marker, axis]
            if known.sum() > 30:
                filled = np.interp(time, time[known], points[known, marker, axis])
                out[known, marker, axis] = sosfiltfilt(butter(2, cut_off, fs=rate, output="sos"), filled)[known]
    return out


def _about(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation matrix (3, 3) about a unit axis."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew)
