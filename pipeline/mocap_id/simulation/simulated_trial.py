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
    draw_bursts,
    draw_jumps,
    jump_displacements,
    measure_positions,
    true_positions,
    visibility,
)
from mocap_id.simulation.faults import camera_faults, draw_displacement, plate_faults, skin_faults
from mocap_id.simulation.forces import TrueState
from mocap_id.simulation.joint_motion import JointMotion
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.plate import measure
from mocap_id.simulation.scene import Scene, Streams, draw_scene, streams
from mocap_id.simulation.skin import subject_displacement, trial_displacement


@dataclass(frozen=True)
class SimulatedTrial:
    """A trial in memory.

    Parameters
    ----------
    scene : Scene
    state : TrueState
        True state at the T frames.
    positions : (T, M, 3) array
        True marker positions in the laboratory, m.
    visible : (T, M) bool array
        Whether the cameras see each marker.
    bursts : tuple of Burst
    jumps : tuple of Jump
    points : (T, M, 3) array
        Measured marker positions, m; NaN where not visible.
    signals : PlateSignals
        The plate's channels, ``analog_rate / rate`` samples a frame.
    seat_signals : PlateSignals or None
        Channels of the plate under the chair.
    labels : tuple of str
        Names in the file: those of the M markers, then trajectories that are no markers.
    fault_truth : mapping
        Which markers a fault concerns, and when.
    """

    scene: Scene
    state: TrueState
    positions: FloatArray
    visible: BoolArray
    bursts: tuple[Burst, ...]
    jumps: tuple[Jump, ...]
    points: FloatArray
    signals: PlateSignals
    seat_signals: PlateSignals | None
    labels: tuple[str, ...]
    fault_truth: Mapping[str, Any]


def generate(kind: Kind, options: Options, given: JointMotion | None = None) -> SimulatedTrial:
    """Draw a trial and measure it, with a ``given`` motion if any; the same options give the same numbers."""
    rng = streams(options.seed, options.subject)
    return measure_scene(draw_scene(kind, options, rng, given), options, rng)


def measure_scene(scene: Scene, options: Options, rng: Streams) -> SimulatedTrial:
    """Measure a scene with the simulated cameras and plates."""
    frames = round(scene.motion.duration * options.rate)
    state = scene.at(np.arange(frames) / options.rate)
    scene, skin = _with_skin(scene, options, rng, state)
    faults, schedule = options.faults, None if scene.chair is None else scene.chair.schedule
    skin = skin + skin_faults(rng["faults"], faults, scene.markers, state.time)
    seed = int(rng["displacement"].integers(2**32))
    positions = true_positions(scene, state, skin, draw_displacement(seed, faults, schedule, state.time))
    bursts = draw_bursts(rng["occlusion"], scene.markers, frames, options.rate, options.occlusions)
    jumps = draw_jumps(rng["jumps"], scene.markers, frames, options.jumps)
    visible = visibility(scene.markers, bursts, frames)
    samples = frames * round(options.analog_rate / options.rate)
    loaded = scene.at(np.arange(samples) / options.analog_rate + options.clock_offset)
    points = measure_positions(
        rng["cameras"], positions + jump_displacements(scene.markers, jumps, frames), options.marker_noise, visible
    )
    labels, points, fault_truth = camera_faults(rng["faults"], faults, scene, points, options.rate)
    displacement = draw_displacement(seed, faults, schedule, loaded.time)
    signals = measure(rng["channels"], scene.plate, *scene.load_on_plate(loaded, displacement), options.analog_rate)
    return SimulatedTrial(
        scene=scene,
        state=state,
        positions=positions,
        visible=visible,
        bursts=bursts,
        jumps=jumps,
        points=points,
        signals=plate_faults(faults, signals, scene.plane.axes[0]),
        seat_signals=None
        if scene.seat_plate is None
        else measure(
            rng["seat channels"],
            scene.seat_plate,
            *scene.load_on_seat_plate(loaded, displacement),
            options.analog_rate,
        ),
        labels=labels,
        fault_truth=fault_truth,
    )


def _with_skin(scene: Scene, options: Options, rng: Streams, state: TrueState) -> tuple[Scene, FloatArray]:
    """Return the scene with mean marker positions, and the skin's displacement from them (T, M, 3), m."""
    if options.subject is None:
        return scene, trial_displacement(rng["skin"], scene.markers, state.q, state.time)
    skin, markers = subject_displacement(rng["skin"], rng["wander"], scene.markers, state.q, state.time)
    return replace(scene, markers=markers), skin
