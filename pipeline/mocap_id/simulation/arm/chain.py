"""A simulated chain of bodies without anatomy, connected by ball joints, hinges and two-axis joints."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.simulation.arm.markers import marker_set
from mocap_id.simulation.arm.options import PRESETS, ChainOptions, Preset
from mocap_id.simulation.arm.rotations import Attitude, AxisRotation, constant_attitude
from mocap_id.simulation.arm.trial import SpatialTrial, film_markers, transform_points
from mocap_id.simulation.joint_motion import STEP, draw_sway, motion_through, ramp_up
from mocap_id.simulation.skin import draw_skin_motion

STILL = 1.0  # s of rest at the start
_AXES = {"S": 3, "T": 2, "H": 1}
_LEAST_BETWEEN = np.radians(60.0)  # least angle between the axes of a two-axis joint
_FREQUENCIES = (0.15, 0.6)  # Hz
_TILT = 2.0  # rad of rotation of a swaying base for each metre of its sway


def simulate_chain(
    seed: int = 0, kinds: str = "SS", arc_deg: float = 40.0, preset: Preset = "default", **more: Any
) -> SpatialTrial:
    """Simulate a chain; the same arguments give the same numbers. ``more`` are further fields of :class:`ChainOptions`.

    Examples
    --------
    >>> trial = simulate_chain(1, "SH", arc_deg=15)
    >>> trial.positions.shape, trial.segments
    ((2000, 12, 3), ('base', 'link1', 'link2'))
    """
    return generate_chain(ChainOptions(seed=seed, kinds=kinds, arc_deg=arc_deg, preset=preset, **more))


def generate_chain(options: ChainOptions) -> SpatialTrial:
    """Simulate a chain with the given options."""
    of_body, of_motion, of_skin, of_cameras = (np.random.default_rng([options.seed, 30 + i]) for i in range(4))
    lengths = of_body.uniform(0.25, 0.38, len(options.kinds))
    axes = [_draw_axes(of_body, kind) for kind in options.kinds]
    centres = _draw_centres(of_body, lengths)
    labels, segment, local = _draw_markers(of_body, lengths, options.markers)
    time = np.arange(round(options.duration * options.rate)) / options.rate
    q, shift, attitudes = _draw_motion(of_motion, options, axes, time)
    origins = [shift]
    for attitude, centre in zip(attitudes, centres, strict=False):
        origins.append(origins[-1] + attitude.rotation @ centre)
    rotations = np.stack([each.rotation for each in attitudes], axis=1)
    placed = np.stack(origins, axis=1)
    skin = _draw_skin(of_skin, options, q, (labels, segment, local), time)
    true = transform_points(placed, rotations, segment, local + skin)
    positions, bursts = film_markers(of_cameras, labels, true, options.rate, PRESETS[options.preset])
    return SpatialTrial(
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
        still=STILL,
    )


def _draw_axes(rng: np.random.Generator, kind: str) -> FloatArray:
    """Return the d axes (3, d) of a joint: orthogonal for a ball joint, at 60 … 90° for a two-axis joint."""
    frame: FloatArray = so3.exp(rng.normal(0, 2, 3))
    if kind == "T":
        angle = rng.uniform(_LEAST_BETWEEN, np.pi / 2)
        return np.stack([frame[:, 0], np.cos(angle) * frame[:, 0] + np.sin(angle) * frame[:, 1]], axis=1)
    return frame[:, : _AXES[kind]]


def _draw_centres(rng: np.random.Generator, lengths: FloatArray) -> FloatArray:
    """Return joint centres (n, 3) in the parents' frames, m: the chain hangs from the top of the base."""
    centres = rng.normal(0, 0.01, (len(lengths), 3))
    centres[1:, 2] = -lengths[:-1]
    centres[0] = (*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.85, 1.0))
    return centres


def _draw_markers(
    rng: np.random.Generator, lengths: FloatArray, each: int
) -> tuple[tuple[str, ...], IntArray, FloatArray]:
    """Return labels, segments and local positions (M, 3), m, of ``each`` markers on every body."""
    labels, local = [], []
    for k, length in enumerate((None, *lengths)):
        around = rng.uniform(0, 2 * np.pi, each)
        if length is None:
            radius, height = rng.uniform(0.06, 0.2, each), rng.uniform(0.2, 0.9, each)
        else:
            radius, height = rng.uniform(0.03, 0.09, each), -length * rng.uniform(0.2, 0.9, each)
        local.append(np.stack([radius * np.cos(around), radius * np.sin(around), height], axis=1))
        labels += [f"BAS{i + 1}" if length is None else f"L{k}M{i + 1}" for i in range(each)]
    return tuple(labels), np.repeat(np.arange(len(lengths) + 1), each), np.concatenate(local)


def _draw_motion(
    rng: np.random.Generator, options: ChainOptions, axes: list[FloatArray], time: FloatArray
) -> tuple[FloatArray, FloatArray, list[Attitude]]:
    """Return the first coordinate of every joint (F, n), the translation of the base (F, 3), m, and all attitudes."""
    fine = np.arange(-1.0, options.duration + 1.0, STEP)
    count = sum(each.shape[1] for each in axes)
    waves = _draw_waves(rng, fine, count) * np.radians(options.arc_deg)
    size = options.sway_mm / 1e3
    base = draw_sway(rng, fine, np.repeat([size * _TILT, size], 3))
    motion = motion_through(fine, ramp_up(fine, STILL) * np.hstack([waves, base]), options.duration)
    q, dq, ddq, _ = motion.at(time)
    all_axes = np.concatenate([*axes, np.eye(3)], 1).T
    rotations = [AxisRotation(axis, q[:, i], dq[:, i], ddq[:, i]) for i, axis in enumerate(all_axes)]
    attitudes = [constant_attitude(np.eye(3), len(time)).rotate(rotations[count:])]
    first = np.cumsum([0, *(each.shape[1] for each in axes)])
    for start, end in pairwise(first):
        attitudes.append(attitudes[-1].rotate(rotations[start:end]))
    return q[:, first[:-1]], q[:, count + 3 :], attitudes


def _draw_waves(rng: np.random.Generator, time: FloatArray, count: int) -> FloatArray:
    """Return irregular waves (T, count) whose largest value is 1."""
    frequency = rng.uniform(*_FREQUENCIES, (3, count))
    weight = np.array([1.0, 0.5, 0.25])[:, None]
    phase = rng.uniform(0, 2 * np.pi, (3, count))
    waves = (weight * np.sin(2 * np.pi * frequency * time[:, None, None] + phase)).sum(axis=1)
    return np.asarray(waves / np.abs(waves).max(axis=0))


def _draw_skin(
    rng: np.random.Generator,
    options: ChainOptions,
    q: FloatArray,
    markers: tuple[tuple[str, ...], IntArray, FloatArray],
    time: FloatArray,
) -> FloatArray:
    """Return the displacement (F, M, 3) of all markers by sliding skin, m; it is zero in the first frame."""
    labels, segment, local = markers
    softness = np.full(len(labels), options.soft_tissue_mm / 1e3)
    moved = draw_skin_motion(rng, marker_set(labels, segment, local, softness), q, time, wander=rng, middle=q[0])
    return np.asarray(moved - moved[0])
