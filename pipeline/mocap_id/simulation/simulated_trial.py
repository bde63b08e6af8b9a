"""A simulated trial in memory: truth, marker positions and plate signals."""

from __future__ import annotations

from dataclasses import dataclass, replace

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


def generate(kind: Kind, options: Options, given: JointMotion | None = None) -> SimulatedTrial:
    """Draw a trial and measure it, with a ``given`` motion if any; the same options give the same numbers."""
    rng = streams(options.seed, options.subject)
    return measure_scene(draw_scene(kind, options, rng, given), options, rng)


def measure_scene(scene: Scene, options: Options, rng: Streams) -> SimulatedTrial:
    """Measure a scene with the simulated cameras and plates."""
    frames = round(scene.motion.duration * options.rate)
    state = scene.at(np.arange(frames) / options.rate)
    scene, skin = _with_skin(scene, options, rng, state)
    positions = true_positions(scene, state, skin)
    bursts = draw_bursts(rng["occlusion"], scene.markers, frames, options.rate, options.occlusions)
    jumps = draw_jumps(rng["jumps"], scene.markers, frames, options.jumps)
    visible = visibility(scene.markers, bursts, frames)
    samples = frames * round(options.analog_rate / options.rate)
    loaded = scene.at(np.arange(samples) / options.analog_rate + options.clock_offset)
    return SimulatedTrial(
        scene=scene,
        state=state,
        positions=positions,
        visible=visible,
        bursts=bursts,
        jumps=jumps,
        points=measure_positions(
            rng["cameras"], positions + jump_displacements(scene.markers, jumps, frames), options.marker_noise, visible
        ),
        signals=measure(rng["channels"], scene.plate, *scene.load_on_plate(loaded), options.analog_rate),
        seat_signals=None
        if scene.seat_plate is None
        else measure(rng["seat channels"], scene.seat_plate, *scene.load_on_seat_plate(loaded), options.analog_rate),
    )


def _with_skin(scene: Scene, options: Options, rng: Streams, state: TrueState) -> tuple[Scene, FloatArray]:
    """Return the scene with mean marker positions, and the skin's displacement from them (T, M, 3), m."""
    if options.subject is None:
        return scene, trial_displacement(rng["skin"], scene.markers, state.q, state.time)
    skin, markers = subject_displacement(rng["skin"], rng["wander"], scene.markers, state.q, state.time)
    return replace(scene, markers=markers), skin
