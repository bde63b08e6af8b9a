"""A simulated trial in memory: truth, marker positions and plate signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.simulation.cameras import (
    Burst,
    Jump,
    compute_true_positions,
    draw_bursts,
    draw_jumps,
    find_visible,
    jump_displacements,
    measure_positions,
)
from mocap_id.simulation.faults import add_camera_faults, add_plate_faults, draw_displacement, draw_skin_faults
from mocap_id.simulation.forces import TrueState
from mocap_id.simulation.joint_motion import JointMotion
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.plate import measure_load
from mocap_id.simulation.scene import Scene, Streams, draw_scene, random_streams
from mocap_id.simulation.skin import draw_subject_skin_motion, draw_trial_skin_motion


@dataclass(frozen=True)
class SimulatedTrial:
    """A trial in memory, with T frames and M markers."""

    scene: Scene
    state: TrueState  # true state at the frames
    positions: FloatArray  # (T, M, 3) true marker positions in the laboratory, m
    visible: BoolArray  # (T, M) whether the cameras see each marker
    bursts: tuple[Burst, ...]
    jumps: tuple[Jump, ...]
    points: FloatArray  # (T, L, 3) measured positions of the L labels, m; NaN where not visible
    signals: PlateSignals  # channels of the plate, ``analog_rate / rate`` samples for each frame
    seat_signals: PlateSignals | None  # channels of the plate under the chair; None without it
    labels: tuple[str, ...]  # L names in the file: of the M markers, then of trajectories that belong to no marker
    fault_truth: Mapping[str, Any]  # which markers have a fault, and when


def generate(kind: Kind, options: Options, given: JointMotion | None = None) -> SimulatedTrial:
    """Draw a trial and measure it; the same options give the same numbers.

    With a ``given`` motion, the body performs it without a chair.
    """
    rng = random_streams(options.seed, options.subject)
    return measure_scene(draw_scene(kind, options, rng, given), options, rng)


def measure_scene(scene: Scene, options: Options, rng: Streams) -> SimulatedTrial:
    """Measure a scene with the simulated cameras and plates."""
    frames = round(scene.motion.duration * options.rate)
    state = scene.at(np.arange(frames) / options.rate)
    scene, skin = _draw_skin(scene, options, rng, state)
    faults, schedule = options.faults, None if scene.chair is None else scene.chair.schedule
    skin = skin + draw_skin_faults(rng["faults"], faults, scene.markers, state.time)
    seed = int(rng["displacement"].integers(2**32))
    positions = compute_true_positions(scene, state, skin, draw_displacement(seed, faults, schedule, state.time))
    bursts = draw_bursts(rng["occlusion"], scene.markers, frames, options.rate, options.occlusions)
    jumps = draw_jumps(rng["jumps"], scene.markers, frames, options.jumps)
    visible = find_visible(scene.markers, bursts, frames)
    samples = frames * round(options.analog_rate / options.rate)
    loaded = scene.at(np.arange(samples) / options.analog_rate + options.clock_offset)
    points = measure_positions(
        rng["cameras"], positions + jump_displacements(scene.markers, jumps, frames), options.marker_noise, visible
    )
    labels, points, fault_truth = add_camera_faults(rng["faults"], faults, scene, points, options.rate)
    displacement = draw_displacement(seed, faults, schedule, loaded.time)
    signals = measure_load(
        rng["channels"], scene.plate, *scene.load_on_plate(loaded, displacement), options.analog_rate
    )
    seat_signals = None
    if scene.seat_plate is not None:
        load = scene.load_on_seat_plate(loaded, displacement)
        seat_signals = measure_load(rng["seat channels"], scene.seat_plate, *load, options.analog_rate)
    return SimulatedTrial(
        scene=scene,
        state=state,
        positions=positions,
        visible=visible,
        bursts=bursts,
        jumps=jumps,
        points=points,
        signals=add_plate_faults(faults, signals, scene.plane.axes[0]),
        seat_signals=seat_signals,
        labels=labels,
        fault_truth=fault_truth,
    )


def _draw_skin(scene: Scene, options: Options, rng: Streams, state: TrueState) -> tuple[Scene, FloatArray]:
    """Return the scene with the markers at their mean positions, and their displacement (T, M, 3) by the skin, m."""
    if options.subject is None:
        return scene, draw_trial_skin_motion(rng["skin"], scene.markers, state.q, state.time)
    skin, markers = draw_subject_skin_motion(rng["skin"], rng["wander"], scene.markers, state.q, state.time)
    return replace(scene, markers=markers), skin
