"""Simulated trials in space, in memory, and chains of bodies without anatomy: ball joints, hinges, two-axis joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id.anatomy.frames import draw_skin_motion
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id_simulation.instruments import MarkerEpisode, draw_occlusions, find_visible, measure_positions
from mocap_id_simulation.options import PRESETS, ChainOptions, Difficulty, Preset
from mocap_id_simulation.sit_to_stand import (
    STEP,
    constant_attitude,
    draw_sway,
    motion_through,
    ramp_up,
)

_OCCLUSIONS = 0.4 / 24  # times the usual number of bursts, for one marker


@dataclass(frozen=True)
class SimulatedSpaceTrial:
    """A trial of S segments and M markers at F frames; all vectors are in laboratory axes with z up."""

    labels: tuple[str, ...]  # names of the markers in the file
    names: tuple[str, ...]  # names of the landmarks and cluster markers, also if the recording is anonymous
    rate: float  # Hz
    time: FloatArray  # (F,) s
    positions: FloatArray  # (F, M, 3) measured positions, m; NaN where a marker was not seen
    true_positions: FloatArray  # (F, M, 3) positions with soft tissue, without noise and occlusions, m
    bursts: tuple[MarkerEpisode, ...]  # occlusions
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
) -> tuple[FloatArray, tuple[MarkerEpisode, ...]]:
    """Return measured positions (F, M, 3), m, and the occlusions, in which the positions are NaN."""
    frames, count = positions.shape[:2]
    bursts = draw_occlusions(rng, labels, frames, rate, sizes.occlusions * count * _OCCLUSIONS)
    return measure_positions(rng, positions, sizes.marker_noise, find_visible(labels, bursts, frames)), bursts


# --- chains of bodies

_REST = 1.0  # s of rest at the start
_AXES = {"S": 3, "T": 2, "H": 1}
_LEAST_BETWEEN = np.radians(60.0)  # least angle between the axes of a two-axis joint
_FREQUENCIES = (0.15, 0.6)  # Hz
_TILT = 2.0  # rad of rotation of a swaying base for each metre of its sway


def simulate_chain(
    seed: int = 0, kinds: str = "SS", arc_deg: float = 40.0, preset: Preset = "default", **more: Any
) -> SimulatedSpaceTrial:
    """Simulate a chain; the same arguments give the same numbers. ``more`` are further fields of :class:`ChainOptions`.

    Examples
    --------
    >>> trial = simulate_chain(1, "SH", arc_deg=15)
    >>> trial.positions.shape, trial.segments
    ((2000, 12, 3), ('base', 'link1', 'link2'))
    """
    return generate_chain(ChainOptions(seed=seed, kinds=kinds, arc_deg=arc_deg, preset=preset, **more))


def generate_chain(options: ChainOptions) -> SimulatedSpaceTrial:
    """Simulate a chain with the given options."""
    of_body, of_motion, of_skin, of_cameras = (np.random.default_rng([options.seed, 30 + i]) for i in range(4))
    lengths = of_body.uniform(0.25, 0.38, len(options.kinds))
    axes = [_draw_axes(of_body, kind) for kind in options.kinds]
    # joint centres in the parents' frames: the chain hangs from the top of the base
    centres = of_body.normal(0, 0.01, (len(lengths), 3))
    centres[1:, 2] = -lengths[:-1]
    centres[0] = (*of_body.uniform(-0.05, 0.05, 2), of_body.uniform(0.85, 1.0))
    # markers on every body: labels, segments and local positions (M, 3), m
    names: list[str] = []
    places: list[FloatArray] = []
    number = options.markers
    for k, length in enumerate((None, *lengths)):
        around = of_body.uniform(0, 2 * np.pi, number)
        if length is None:
            radius, height = of_body.uniform(0.06, 0.2, number), of_body.uniform(0.2, 0.9, number)
        else:
            radius, height = of_body.uniform(0.03, 0.09, number), -length * of_body.uniform(0.2, 0.9, number)
        places.append(np.stack([radius * np.cos(around), radius * np.sin(around), height], axis=1))
        names += [f"BAS{i + 1}" if length is None else f"L{k}M{i + 1}" for i in range(number)]
    labels, local = tuple(names), np.concatenate(places)
    segment = np.repeat(np.arange(len(lengths) + 1), number)
    time = np.arange(round(options.duration * options.rate)) / options.rate
    # the motion: first coordinate of every joint (F, n), translation of the base (F, 3), m, and all attitudes
    fine = np.arange(-1.0, options.duration + 1.0, STEP)
    count = sum(each.shape[1] for each in axes)
    # irregular waves whose largest value is the arc
    frequency = of_motion.uniform(*_FREQUENCIES, (3, count))
    weight = np.array([1.0, 0.5, 0.25])[:, None]
    phase = of_motion.uniform(0, 2 * np.pi, (3, count))
    waves = (weight * np.sin(2 * np.pi * frequency * fine[:, None, None] + phase)).sum(axis=1)
    waves = waves / np.abs(waves).max(axis=0) * np.radians(options.arc_deg)
    size = options.sway_mm / 1e3
    base = draw_sway(of_motion, fine, np.repeat([size * _TILT, size], 3))
    motion = motion_through(fine, ramp_up(fine, _REST) * np.hstack([waves, base]), options.duration)
    q, dq, ddq, _ = motion.at(time)
    all_axes = np.concatenate([*axes, np.eye(3)], 1).T
    turns = [(axis, q[:, i], dq[:, i], ddq[:, i]) for i, axis in enumerate(all_axes)]
    attitudes = [constant_attitude(np.eye(3), len(time)).rotate(turns[count:])]
    first = np.cumsum([0, *(each.shape[1] for each in axes)])
    for start, end in pairwise(first):
        attitudes.append(attitudes[-1].rotate(turns[start:end]))
    q, shift = q[:, first[:-1]], q[:, count + 3 :]
    origins = [shift]
    for attitude, centre in zip(attitudes, centres, strict=False):
        origins.append(origins[-1] + attitude.rotation @ centre)
    rotations = np.stack([each.rotation for each in attitudes], axis=1)
    placed = np.stack(origins, axis=1)
    softness = np.full(len(labels), options.soft_tissue_mm / 1e3)
    skin = draw_skin_motion(of_skin, segment, softness, q, time, wander=of_skin, middle=q[0])
    skin = np.asarray(skin - skin[0])  # zero in the first frame
    true = transform_points(placed, rotations, segment, local + skin)
    positions, bursts = film_markers(of_cameras, labels, true, options.rate, PRESETS[options.preset])
    return SimulatedSpaceTrial(
        labels=labels,
        names=labels,
        rate=options.rate,
        time=time,
        positions=positions,
        true_positions=true,
        bursts=bursts,
        segments=("base", *(f"link{k + 1}" for k in range(len(lengths)))),
        assignment=segment,
        local=local,
        skin=skin,
        origins=placed,
        rotations=rotations,
        omega=np.stack([each.omega for each in attitudes], axis=1),
        alpha=np.stack([each.alpha for each in attitudes], axis=1),
        angles={},
        rates={},
        accelerations={},
        arrays={
            "joint_lab": placed[:, 1:],
            "joint_R": np.einsum("fjba,fjbc->fjac", rotations[:, :-1], rotations[:, 1:]),
        },
        document={
            "types": options.kinds,
            "joint_in_parent_m": centres.tolist(),
            "joint_axes": [each.tolist() for each in axes],
            "lengths_m": lengths.tolist(),
        },
        still=_REST,
    )


def _draw_axes(rng: np.random.Generator, kind: str) -> FloatArray:
    """Return the d axes (3, d) of a joint: orthogonal for a ball joint, at 60 … 90° for a two-axis joint."""
    frame: FloatArray = so3.exp(rng.normal(0, 2, 3))
    if kind == "T":
        angle = rng.uniform(_LEAST_BETWEEN, np.pi / 2)
        return np.stack([frame[:, 0], np.cos(angle) * frame[:, 0] + np.sin(angle) * frame[:, 1]], axis=1)
    return frame[:, : _AXES[kind]]
