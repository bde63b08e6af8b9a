"""What the cameras see: marker positions in the laboratory, with noise and occlusions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import planar
from mocap_id.simulation.forces import Exact
from mocap_id.simulation.markers import MarkerSet
from mocap_id.simulation.scene import Scene

BURST = (5, 200)  # frames
BURSTS_PER_SECOND = 0.6
JUMP = (0.02, 0.08)  # m
ASTRAY = (5, 100)  # frames


@dataclass(frozen=True)
class Burst:
    """Frames ``first`` … ``first + count - 1`` in which one marker is not seen."""

    label: str
    first: int
    count: int


@dataclass(frozen=True)
class Jump:
    """Frames ``first`` … ``first + count - 1`` in which one marker is taken for something else, (3,) ``by`` m away."""

    label: str
    first: int
    count: int
    by: FloatArray


def true_positions(scene: Scene, state: Exact, skin: FloatArray) -> FloatArray:
    """Marker positions without measurement error, in the laboratory.

    Parameters
    ----------
    scene : Scene
    state : Exact
        At T frames.
    skin : (T, M, 3) array
        Displacement of the markers in their links' frames, m.

    Returns
    -------
    (T, M, 3) array
        m.
    """
    link, angle, origin, local = _carriers(scene, state)
    local = local + skin
    flat = origin[:, link] + planar.rotate(angle[:, link], local[..., :2])
    depth = local[..., 2:] + scene.offset
    return scene.plane.from_plane(np.concatenate([flat, depth], axis=-1))


def _carriers(scene: Scene, state: Exact) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """What carries each marker (M,): an index into angles (T, C) and origins (T, C, 2), and its place there (M, 3)."""
    markers = scene.markers
    if scene.loose is None or state.bodies is None:
        angle, origin = planar.segment_poses(state.q, scene.body.centres)
        return markers.link, angle, origin, markers.local
    pose, body = state.bodies.pose, scene.loose.body
    pose = np.concatenate([np.zeros_like(pose[:, :1]), pose], axis=1)  # the plate first
    return body.part_of(markers) + 1, pose[..., 2], pose[..., :2], body.local(markers)


def draw_bursts(
    rng: np.random.Generator, markers: MarkerSet, frames: int, rate: float, often: float
) -> tuple[Burst, ...]:
    """Occlusions: short ones as frequent as long ones, only of what something can hide; ``often`` times the usual."""
    candidates = [label for label, hidden in zip(markers.labels, markers.hidden, strict=True) if hidden]
    bursts = []
    for _ in range(round(often * BURSTS_PER_SECOND * frames / rate)):
        count = min(int(np.exp(rng.uniform(*np.log(BURST)))), frames // 2)
        bursts.append(Burst(str(rng.choice(candidates)), int(rng.integers(frames - count)), count))
    return tuple(bursts)


def draw_jumps(rng: np.random.Generator, markers: MarkerSet, frames: int, often: int) -> tuple[Jump, ...]:
    """Markers mistaken: any marker, any moment, any direction."""
    jumps = []
    for _ in range(often):
        count = int(rng.integers(ASTRAY[0], min(ASTRAY[1], frames // 2) + 1))
        direction = rng.normal(0, 1, 3)
        by = rng.uniform(*JUMP) * direction / np.linalg.norm(direction)
        jumps.append(Jump(str(rng.choice(markers.labels)), int(rng.integers(frames - count)), count, by))
    return tuple(jumps)


def astray(markers: MarkerSet, jumps: tuple[Jump, ...], frames: int) -> FloatArray:
    """(T, M, 3) what the jumps add to the positions, m."""
    added = np.zeros((frames, len(markers.labels), 3))
    for jump in jumps:
        added[jump.first : jump.first + jump.count, markers.labels.index(jump.label)] += jump.by
    return added


def visible(markers: MarkerSet, bursts: tuple[Burst, ...], frames: int) -> BoolArray:
    """(T, M): False within a burst."""
    seen = np.ones((frames, len(markers.labels)), dtype=np.bool_)
    for burst in bursts:
        seen[burst.first : burst.first + burst.count, markers.labels.index(burst.label)] = False
    return seen


def measured(rng: np.random.Generator, positions: FloatArray, noise: float, seen: BoolArray) -> FloatArray:
    """Positions (T, M, 3) with white noise of ``noise`` m a coordinate, NaN where not seen."""
    noisy = positions + rng.normal(0, 1, positions.shape) * noise
    return np.where(seen[..., None], noisy, np.nan)
