"""A simulated arm on a swaying thorax, with markers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.simulation.arm.body import SEGMENTS, ArmBody, draw_arm
from mocap_id.simulation.arm.curl_torque import curl_torques
from mocap_id.simulation.arm.markers import ArmMarkers, axial_displacement, draw_markers, draw_slide
from mocap_id.simulation.arm.movements import STILL, ArmMovement, draw_movement
from mocap_id.simulation.arm.options import PRESETS, ArmOptions, Difficulty, Movement, Preset
from mocap_id.simulation.arm.rotations import (
    Attitude,
    AxisRotation,
    X,
    Y,
    Z,
    constant_attitude,
    constant_rotation,
    elbow_angles,
)
from mocap_id.simulation.arm.trial import SpatialTrial, film_markers, transform_points

MIRROR = np.array([1.0, -1.0, 1.0])
"""Factors that mirror laboratory positions of a right arm to a left arm."""
_SHOULDER = ("shoulder_plane", "shoulder_elevation", "shoulder_axial")
_ELBOW = ("elbow_flexion", "elbow_carrying", "elbow_pronation")
_WRIST = ("wrist_flexion", "wrist_deviation")
_SEAT = 0.60  # height of IJ, as a fraction of the stature


@dataclass(frozen=True)
class _Scene:
    """A person with markers, in motion, before the recording."""

    body: ArmBody
    markers: ArmMarkers
    movement: ArmMovement
    time: FloatArray


@dataclass(frozen=True)
class _Skeleton:
    """Poses of the four segments and joint coordinates at F frames."""

    attitudes: tuple[Attitude, ...]
    origins: FloatArray  # (F, 4, 3) m
    coordinates: tuple[FloatArray, FloatArray, FloatArray]  # (F, 7) coordinates, first and second derivatives
    elbow: tuple[FloatArray, FloatArray, FloatArray]  # (F, 3) angles of the elbow, first and second derivatives
    shoulder_centre: FloatArray  # (F, 3) in the thorax, m


def simulate_arm(seed: int = 0, preset: Preset = "default", movement: Movement = "reach", **more: Any) -> SpatialTrial:
    """Simulate an arm; the same arguments give the same numbers. ``more`` are further fields of :class:`ArmOptions`.

    Examples
    --------
    >>> trial = simulate_arm(1, "clean", cycles=1)
    >>> trial.positions.shape[1:], trial.segments
    ((24, 3), ('thorax', 'upper_arm', 'forearm', 'hand'))
    """
    return generate_arm(ArmOptions(seed=seed, preset=preset, movement=movement, **more))


def generate_arm(options: ArmOptions) -> SpatialTrial:
    """Simulate an arm with the given options."""
    sizes = PRESETS[options.preset]
    scale = options.soft_tissue
    sizes = replace(sizes, soft_tissue=sizes.soft_tissue * scale, twist_loss=sizes.twist_loss * min(scale, 1.0))
    person = person_seed(options)
    of_motion, of_sway, of_cameras = (np.random.default_rng([options.seed, 10 + i]) for i in range(3))
    session = person if options.markers is None else options.markers
    of_markers, of_skin = (np.random.default_rng([session, 20 + i]) for i in range(2))
    movement = draw_movement(of_motion, options, sizes.tremor)
    body = draw_arm(person, options.glide_mm / 1e3 if options.movement == "reach" else 0.0)
    scene = _Scene(
        body=body,
        markers=draw_markers(of_markers, body, sizes, options.anonymous),
        movement=movement,
        time=np.arange(round(movement.motion.duration * options.rate)) / options.rate,
    )
    bones = _draw_skeleton(of_sway, scene)
    trial = _record(of_cameras, options, sizes, scene, bones, skin=_draw_skin(of_skin, of_sway, scene, bones))
    if options.movement == "reach":
        return trial
    return replace(trial, arrays={**trial.arrays, **curl_torques(options, trial)})


def person_seed(options: ArmOptions) -> int:
    """Return the seed of the person: ``subject``, or the trial's seed if it is omitted."""
    return options.seed if options.subject is None else options.subject


def _draw_skeleton(rng: np.random.Generator, scene: _Scene) -> _Skeleton:
    q, dq, ddq, _ = scene.movement.motion.at(scene.time)
    body, frames = scene.body, len(scene.time)

    def about(axis: FloatArray, column: int, sign: float = 1.0) -> AxisRotation:
        return AxisRotation(axis, sign * q[:, column], sign * dq[:, column], sign * ddq[:, column])

    axial = AxisRotation(Y, *(each[:, 2] - each[:, 0] for each in (q, dq, ddq)))
    joints = (
        (about(Y, 0), about(X, 1, -1.0), axial),
        (about(body.elbow_axis, 3), constant_rotation(X, body.carrying, frames), about(body.pronation_axis, 4)),
        (about(Z, 5), about(X, 6)),
    )
    thorax = constant_attitude(_draw_start(rng), frames).rotate((about(X, 7), about(Y, 8), about(Z, 9)))
    attitudes = [thorax]
    for rotations in joints:
        attitudes.append(attitudes[-1].rotate(rotations))
    centre = body.shoulder + (1 - np.cos(q[:, 1:2])) / 2 * body.glide
    seat = np.array([*rng.uniform(-0.2, 0.2, 2), _SEAT * body.subject.height])
    origins = [seat + q[:, 10:13]]
    for attitude, step in zip(attitudes, (centre, body.elbow, body.wrist), strict=False):
        origins.append(origins[-1] + (attitude.rotation @ np.broadcast_to(step, (frames, 3))[..., None])[..., 0])
    return _Skeleton(
        attitudes=tuple(attitudes),
        origins=np.stack(origins, axis=1),
        coordinates=(q[:, :7], dq[:, :7], ddq[:, :7]),
        elbow=elbow_angles(constant_attitude(np.eye(3), frames).rotate(joints[1])),
        shoulder_centre=centre,
    )


def _draw_start(rng: np.random.Generator) -> FloatArray:
    """Return the attitude (3, 3) of the thorax at the start: upright within a few degrees, in any direction."""
    yaw = rng.uniform(-np.pi, np.pi)
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    upright = np.stack([forward, Z, np.cross(forward, Z)], axis=1)
    return upright @ so3.exp(np.radians(rng.normal(0, 1.5, 3)))


def _draw_skin(rng: np.random.Generator, wander: np.random.Generator, scene: _Scene, bones: _Skeleton) -> FloatArray:
    """Return the displacement (F, M, 3) of all markers in their segments' frames by soft tissue, m."""
    q, time = bones.coordinates[0], scene.time
    none = np.zeros(len(time))
    axial = np.stack([none, q[:, 2], q[:, 4], none], axis=1)
    slide = draw_slide(rng, wander, scene.markers, q[:, (1, 3, 4, 5)], time)
    return axial_displacement(scene.markers, axial) + slide


def _record(
    rng: np.random.Generator,
    options: ArmOptions,
    sizes: Difficulty,
    scene: _Scene,
    bones: _Skeleton,
    *,
    skin: FloatArray,
) -> SpatialTrial:
    """Return the trial that the cameras record, with its truth."""
    markers = scene.markers
    rotations = np.stack([each.rotation for each in bones.attitudes], axis=1)
    girdle = (bones.shoulder_centre - bones.shoulder_centre[0])[:, None] * markers.on_glide[:, None]
    true = transform_points(bones.origins, rotations, markers.segment, markers.local + skin + girdle)
    if options.side == "left":
        true = true * MIRROR
    positions, bursts = film_markers(rng, markers.labels, true, options.rate, sizes)
    hinge, pronation = (np.stack([each[:, i] for each in bones.coordinates], axis=1) for i in (3, 4))
    angles, rates, accelerations = (
        _angles(each, elbow) for each, elbow in zip(bones.coordinates, bones.elbow, strict=True)
    )
    return SpatialTrial(
        labels=markers.labels,
        names=markers.names,
        rate=options.rate,
        time=scene.time,
        positions=positions,
        true_positions=true,
        bursts=bursts,
        segments=SEGMENTS,
        assignment=markers.segment,
        local=markers.local,
        skin=skin,
        origins=bones.origins,
        rotations=rotations,
        omega=np.stack([each.omega for each in bones.attitudes], axis=1),
        alpha=np.stack([each.alpha for each in bones.attitudes], axis=1),
        angles=angles,
        rates=rates,
        accelerations=accelerations,
        arrays={"gh_in_thorax": bones.shoulder_centre, "q_hinge": hinge, "q_pron": pronation},
        document={"body": scene.body, "markers": markers, "protocol": scene.movement.protocol},
        still=STILL,
    )


def _angles(q: FloatArray, elbow: FloatArray) -> dict[str, FloatArray]:
    """Return the angles, or their derivatives of one order, by name."""
    shoulder = (q[:, 0], q[:, 1], q[:, 2] - q[:, 0])
    return dict(zip((*_SHOULDER, *_ELBOW, *_WRIST), (*shoulder, *elbow.T, q[:, 5], q[:, 6]), strict=True))
