"""Simulated cameras, and faults of a recording: noise, occlusions, bad markers, moving feet, wrong rates and gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.lab_plates import PlateSignals
from mocap_id_simulation.bodies import MarkerSet
from mocap_id_simulation.motion import smoothstep
from mocap_id_simulation.options import FaultOptions
from mocap_id_simulation.sit_to_stand import Schedule

if TYPE_CHECKING:
    from mocap_id_simulation.scene import Scene

BURST = (5, 200)  # frames
BURSTS_PER_SECOND = 0.6
JUMP = (0.02, 0.08)  # m
JUMP_LENGTH = (5, 100)  # frames


@dataclass(frozen=True)
class MarkerEpisode:
    """Frames of one marker with an occlusion or a jump, named as in truth.json."""

    label: str
    first_frame: int
    n_frames: int

    @property
    def frames(self) -> slice:
        """The frames."""
        return slice(self.first_frame, self.first_frame + self.n_frames)


def draw_occlusions(
    rng: np.random.Generator, labels: Sequence[str], frames: int, rate: float, often: float
) -> tuple[MarkerEpisode, ...]:
    """Draw occlusions of the markers ``labels``; ``often`` is a factor on the usual number, ``rate`` is in Hz."""
    bursts = []
    for _ in range(round(often * BURSTS_PER_SECOND * frames / rate)):
        count = min(int(np.exp(rng.uniform(*np.log(BURST)))), frames // 2)
        bursts.append(MarkerEpisode(str(rng.choice(labels)), int(rng.integers(frames - count)), count))
    return tuple(bursts)


def draw_jumps(
    rng: np.random.Generator, labels: Sequence[str], frames: int, number: int
) -> tuple[tuple[MarkerEpisode, FloatArray], ...]:
    """Draw ``number`` jumps of random markers at random times, with their shift (3,) in a random direction, m."""
    jumps = []
    for _ in range(number):
        count = int(rng.integers(JUMP_LENGTH[0], min(JUMP_LENGTH[1], frames // 2) + 1))
        direction = rng.normal(0, 1, 3)
        shift = rng.uniform(*JUMP) * direction / np.linalg.norm(direction)
        jumps.append((MarkerEpisode(str(rng.choice(labels)), int(rng.integers(frames - count)), count), shift))
    return tuple(jumps)


def find_visible(labels: Sequence[str], occlusions: Sequence[MarkerEpisode], frames: int) -> BoolArray:
    """Return whether each marker is visible, (T, M)."""
    visible = np.ones((frames, len(labels)), dtype=np.bool_)
    for each in occlusions:
        visible[each.frames, labels.index(each.label)] = False
    return visible


def measure_positions(rng: np.random.Generator, positions: FloatArray, noise: float, visible: BoolArray) -> FloatArray:
    """Return positions (T, M, 3) with white noise of standard deviation ``noise``, m; NaN where not visible."""
    noisy = positions + rng.normal(0, 1, positions.shape) * noise
    return np.where(visible[..., None], noisy, np.nan)


# --- faults

GHOST = "GHOST"
"""Beginning of the label of a trajectory that belongs to no marker."""

_WOBBLE_HZ = 4.0
_X = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Displacement:
    """Displacement of the whole person from the simulated motion; rotations are about the plane's origin."""

    shift: FloatArray  # (T,) translation along the motion, m
    turn: FloatArray  # (T,) rotation about the vertical, rad
    lean: float  # rotation about the direction of the motion, rad

    def positions(self, points: FloatArray) -> FloatArray:
        """Return displaced positions (T, M, 3) in the plane frame, m."""
        turned = _rotate_about_y(points + self.shift[:, None, None] * _X, self.turn[:, None])
        return _rotate_about_x(turned, self.lean)

    def load(
        self, force: FloatArray, moment: FloatArray, weight: float, com: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return force and moment (T, 3) of the ground on the displaced person about the plane's origin, N and N·m.

        ``force`` and ``moment`` (T, 3) act on the person before the displacement; ``com`` (T, 3) is the centre of mass
        then, m. The ``weight``, N, stays vertical.
        """
        moment = moment + np.cross(self.shift[:, None] * _X, force)
        force, moment = _rotate_about_y(force, self.turn), _rotate_about_y(moment, self.turn)
        up = np.array([0.0, weight, 0.0])
        com = _rotate_about_y(com + self.shift[:, None] * _X, self.turn)
        leaned = _rotate_about_x(com, self.lean)
        return (
            _rotate_about_x(force - up, self.lean) + up,
            _rotate_about_x(moment - np.cross(com, up), self.lean) + np.cross(leaned, up),
        )


def draw_displacement(
    seed: int, faults: FaultOptions, schedule: Schedule | None, time: FloatArray
) -> Displacement | None:
    """Draw the displacement at times (T,), s; it changes only while the person sits. None if no fault displaces."""
    if not (faults.foot_slide_mm or faults.foot_moves_mm or faults.turn_deg or faults.plane_tilt_deg):
        return None
    rng = np.random.default_rng(seed)
    shift, turn = np.zeros_like(time), np.zeros_like(time)
    repetitions = () if schedule is None else schedule.repetitions
    gaps = [(before.sit_end, after.rise_start) for before, after in pairwise(repetitions)]
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


def _rotate_about_y(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors (..., 3) of the plane frame after a rotation about its y axis by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x + s * z, y, -s * x + c * z], axis=-1)


def _rotate_about_x(vectors: FloatArray, angle: float) -> FloatArray:
    """Return vectors (..., 3) of the plane frame after a rotation about its x axis by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x, c * y - s * z, s * y + c * z], axis=-1)


def draw_skin_faults(
    rng: np.random.Generator, faults: FaultOptions, markers: MarkerSet, time: FloatArray
) -> FloatArray:
    """Return the displacements (T, M, 3) by a reattached marker and by oscillating skin, in the links' frames, m."""
    added = np.zeros((len(time), len(markers.labels), 3))
    if faults.reattached_mm:
        marker = _draw_moving_marker(rng, markers)
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


def add_camera_faults(
    rng: np.random.Generator, faults: FaultOptions, scene: Scene, points: FloatArray, rate: float
) -> tuple[tuple[str, ...], FloatArray, dict[str, Any]]:
    """Return labels, positions and truth after adding the cameras' faults to measured positions.

    Positions (T, M, 3) are in the laboratory, m, and NaN where not visible; ``rate`` is in Hz. Trajectories that belong
    to no marker come last. The truth contains the markers and the frames of each fault.
    """
    markers, truth = scene.markers, dict[str, Any]()
    points, labels, frames = points.copy(), markers.labels, len(points)
    if faults.wander_mm:
        frequency = rng.uniform(0.02, 0.5, (8, 1, *points.shape[1:]))
        phase = rng.uniform(0, 2 * np.pi, frequency.shape)
        waves = np.sin(2 * np.pi * frequency * (np.arange(frames) / rate)[:, None, None] + phase).sum(axis=0)
        points += faults.wander_mm / 1e3 * waves / 2
    if faults.frozen_s:
        marker, (first, last) = _draw_moving_marker(rng, markers), _draw_frames(rng, frames, faults.frozen_s * rate)
        seen = np.flatnonzero(np.isfinite(points[: last + 1, marker, 0]))
        points[first:last, marker] = points[seen[np.argmin(np.abs(seen - first))], marker]
        truth["frozen"] = {"label": labels[marker], "first_frame": first, "n_frames": last - first}
    if faults.mislabelled_s:
        one, other = rng.choice(np.flatnonzero(markers.link > 0), 2, replace=False)
        first, last = _draw_frames(rng, frames, faults.mislabelled_s * rate)
        points[first:last, [one, other]] = points[first:last, [other, one]]
        names = [labels[one], labels[other]]
        truth["mislabelled"] = {"labels": names, "first_frame": first, "n_frames": last - first}
    ghosts = []  # trajectories that belong to no marker
    if faults.ghost_walks:
        start, end = rng.uniform(-1.5, 1.5, 3), rng.uniform(-1.5, 1.5, 3)
        start[2], end[2] = rng.uniform(0.2, 1.8, 2)
        ghosts.append(np.linspace(start, end, frames) + rng.normal(0, 5e-4, (frames, 3)))
    if faults.ghost_reflects:
        marker, normal = _draw_moving_marker(rng, markers), rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        mirror = np.nanmean(points[:, marker], axis=0) + rng.uniform(0.1, 0.4) * normal
        ghosts.append(points[:, marker] - 2 * ((points[:, marker] - mirror) @ normal)[:, None] * normal)
    if ghosts:
        points = np.concatenate([points, np.stack(ghosts, axis=1)], axis=1)
        labels = (*labels, *(f"{GHOST}{k + 1}" for k in range(len(ghosts))))
        truth["ghosts"] = list(labels[-len(ghosts) :])
    if faults.filter_hz:
        points = _filter_visible(points, faults.filter_hz, rate)
    if faults.repeated_share:
        source = np.maximum.accumulate(np.where(rng.uniform(size=frames) < faults.repeated_share, 0, np.arange(frames)))
        points = points[source]
    points *= 1 + faults.camera_scale
    if faults.tilt_deg:
        # rotation about the plane's normal
        (x, y, z), angle = scene.plane.axes[2], np.radians(faults.tilt_deg)
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        points = points @ (np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew).T
    return labels, points, truth


def add_plate_faults(faults: FaultOptions, signals: PlateSignals, along: FloatArray) -> PlateSignals:
    """Return the plate's signals with wrong gains and offset, and with corners displaced in the direction ``along``."""
    gains = (1 + faults.gain) * np.array([1, 1, 1 + faults.gain_fz, *[1 + faults.gain_moments] * 3])
    offset = np.array([0, 0, faults.offset_fz_N, 0, 0, 0])
    corners = signals.corners + faults.corners_mm / 1e3 * along
    return replace(signals, channels=signals.channels * gains + offset, corners=corners)


def _draw_moving_marker(rng: np.random.Generator, markers: MarkerSet) -> int:
    """Return the index of a random marker that is not on the base."""
    return int(rng.choice(np.flatnonzero(markers.link > 0)))


def _draw_frames(rng: np.random.Generator, frames: int, count: float) -> tuple[int, int]:
    """Return the first frame, and the frame after the last, of up to ``count`` frames away from the trial's ends."""
    count = min(round(count), frames // 2)
    first = int(rng.integers(frames // 8, max(frames - frames // 8 - count, frames // 8 + 1)))
    return first, first + count


def _filter_visible(points: FloatArray, cut_off: float, rate: float) -> FloatArray:
    """Return the positions after a zero-phase low-pass filter; gaps are interpolated for the filter and stay NaN."""
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415  loads scipy.stats

    visible, time = np.isfinite(points), np.arange(len(points))
    out = points.copy()
    for marker in range(points.shape[1]):
        for axis in range(3):
            known = visible[:, marker, axis]
            if known.sum() > 30:
                filled = np.interp(time, time[known], points[known, marker, axis])
                out[known, marker, axis] = sosfiltfilt(butter(2, cut_off, fs=rate, output="sos"), filled)[known]
    return out
