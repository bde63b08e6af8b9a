"""Simulated cameras: marker positions in the laboratory, with noise, occlusions and jumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import planar
from mocap_id.simulation.faults import Displacement
from mocap_id.simulation.forces import TrueState
from mocap_id.simulation.markers import MarkerSet
from mocap_id.simulation.scene import Scene

BURST = (5, 200)  # frames
BURSTS_PER_SECOND = 0.6
JUMP = (0.02, 0.08)  # m
JUMP_LENGTH = (5, 100)  # frames


@dataclass(frozen=True)
class Burst:
    """An occlusion of one marker in frames ``first`` … ``first + count - 1``."""

    label: str
    first: int
    count: int


@dataclass(frozen=True)
class Jump:
    """A displacement of one marker in frames ``first`` … ``first + count - 1``."""

    label: str
    first: int
    count: int
    by: FloatArray  # (3,) m


def compute_true_positions(
    scene: Scene, state: TrueState, skin: FloatArray, displacement: Displacement | None = None
) -> FloatArray:
    """Return marker positions (T, M, 3) in the laboratory without measurement error, m.

    ``skin`` (T, M, 3) is the displacement of the markers in their links' frames, m. ``displacement`` moves all markers
    except those on the plate.
    """
    link, angle, origin, local = _segment_poses(scene, state)
    local = local + skin
    flat = origin[:, link] + planar.rotate(angle[:, link], local[..., :2])
    depth = local[..., 2:] + scene.offset
    positions = np.concatenate([flat, depth], axis=-1)
    if displacement is not None:
        positions = np.where(scene.markers.on_plate[:, None], positions, displacement.positions(positions))
    return scene.plane.from_plane(positions)


def _segment_poses(scene: Scene, state: TrueState) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return each marker's segment (M,), angles (T, C) and origins (T, C, 2) of C segments, and positions (M, 3)."""
    markers = scene.markers
    if scene.divided is None or state.bodies is None:
        angle, origin = planar.segment_poses(state.q, scene.body.centres)
        return markers.link, angle, origin, markers.local
    pose, body = state.bodies.pose, scene.divided.body
    pose = np.concatenate([np.zeros_like(pose[:, :1]), pose], axis=1)  # the plate first
    return body.part_of(markers) + 1, pose[..., 2], pose[..., :2], body.local(markers)


def draw_bursts(
    rng: np.random.Generator, markers: MarkerSet, frames: int, rate: float, often: float
) -> tuple[Burst, ...]:
    """Draw occlusions of markers that can be hidden; ``often`` is a factor on the usual number, ``rate`` is in Hz."""
    candidates = [label for label, hidden in zip(markers.labels, markers.hidden, strict=True) if hidden]
    bursts = []
    for _ in range(round(often * BURSTS_PER_SECOND * frames / rate)):
        count = min(int(np.exp(rng.uniform(*np.log(BURST)))), frames // 2)
        bursts.append(Burst(str(rng.choice(candidates)), int(rng.integers(frames - count)), count))
    return tuple(bursts)


def draw_jumps(rng: np.random.Generator, markers: MarkerSet, frames: int, number: int) -> tuple[Jump, ...]:
    """Draw ``number`` jumps of random markers at random times in random directions."""
    jumps = []
    for _ in range(number):
        count = int(rng.integers(JUMP_LENGTH[0], min(JUMP_LENGTH[1], frames // 2) + 1))
        direction = rng.normal(0, 1, 3)
        by = rng.uniform(*JUMP) * direction / np.linalg.norm(direction)
        jumps.append(Jump(str(rng.choice(markers.labels)), int(rng.integers(frames - count)), count, by))
    return tuple(jumps)


def jump_displacements(markers: MarkerSet, jumps: tuple[Jump, ...], frames: int) -> FloatArray:
    """Return the displacements (T, M, 3) caused by jumps, m."""
    added = np.zeros((frames, len(markers.labels), 3))
    for jump in jumps:
        added[jump.first : jump.first + jump.count, markers.labels.index(jump.label)] += jump.by
    return added


def find_visible(markers: MarkerSet, bursts: tuple[Burst, ...], frames: int) -> BoolArray:
    """Return whether each marker is visible, (T, M)."""
    visible = np.ones((frames, len(markers.labels)), dtype=np.bool_)
    for burst in bursts:
        visible[burst.first : burst.first + burst.count, markers.labels.index(burst.label)] = False
    return visible


def measure_positions(rng: np.random.Generator, positions: FloatArray, noise: float, visible: BoolArray) -> FloatArray:
    """Return positions (T, M, 3) with white noise of standard deviation ``noise``, m; NaN where not visible."""
    noisy = positions + rng.normal(0, 1, positions.shape) * noise
    return np.where(visible[..., None], noisy, np.nan)
