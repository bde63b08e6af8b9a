"""From the options to everything that is measured, in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.simulation.cameras import (
    Burst,
    Jump,
    astray,
    draw_bursts,
    draw_jumps,
    measured,
    true_positions,
    visible,
)
from mocap_id.simulation.forces import Exact
from mocap_id.simulation.motion import Motion
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.plate import measure
from mocap_id.simulation.scene import Scene, Streams, draw_scene, streams
from mocap_id.simulation.skin import of_a_person, of_a_trial


@dataclass(frozen=True)
class Simulated:
    """A trial in memory.

    Parameters
    ----------
    scene : Scene
    state : Exact
        Truth at the T frames.
    positions : (T, M, 3) array
        Markers in the laboratory without measurement error, m.
    seen : (T, M) bool array
    bursts : tuple of Burst
    jumps : tuple of Jump
    points : (T, M, 3) array
        Markers as measured, m; NaN where not seen.
    signals : PlateSignals
        The plate's channels, ``analog_rate / rate`` samples a frame.
    seat_signals : PlateSignals or None
        Those of the plate under the chair.
    """

    scene: Scene
    state: Exact
    positions: FloatArray
    seen: BoolArray
    bursts: tuple[Burst, ...]
    jumps: tuple[Jump, ...]
    points: FloatArray
    signals: PlateSignals
    seat_signals: PlateSignals | None


def generate(kind: Kind, options: Options, given: Motion | None = None) -> Simulated:
    """Draw a trial and measure it; the same options give the same numbers. What is ``given`` is the motion."""
    rng = streams(options.seed, options.subject)
    return take(draw_scene(kind, options, rng, given), options, rng)


def take(scene: Scene, options: Options, rng: Streams) -> Simulated:
    """Measure a scene, whoever drew it."""
    frames = round(scene.motion.duration * options.rate)
    state = scene.at(np.arange(frames) / options.rate)
    scene, skin = _with_skin(scene, options, rng, state)
    positions = true_positions(scene, state, skin)
    bursts = draw_bursts(rng["occlusion"], scene.markers, frames, options.rate, options.occlusions)
    jumps = draw_jumps(rng["jumps"], scene.markers, frames, options.jumps)
    seen = visible(scene.markers, bursts, frames)
    samples = frames * round(options.analog_rate / options.rate)
    loaded = scene.at(np.arange(samples) / options.analog_rate + options.clock_offset)
    return Simulated(
        scene=scene,
        state=state,
        positions=positions,
        seen=seen,
        bursts=bursts,
        jumps=jumps,
        points=measured(rng["cameras"], positions + astray(scene.markers, jumps, frames), options.marker_noise, seen),
        signals=measure(rng["channels"], scene.plate, *scene.load_on_plate(loaded), options.analog_rate),
        seat_signals=None
        if scene.seat_plate is None
        else measure(rng["seat channels"], scene.seat_plate, *scene.load_on_seat_plate(loaded), options.analog_rate),
    )


def _with_skin(scene: Scene, options: Options, rng: Streams, state: Exact) -> tuple[Scene, FloatArray]:
    """The skin's displacement (T, M, 3), m, and the scene with the places that markers have on average."""
    if options.subject is None:
        return scene, of_a_trial(rng["skin"], scene.markers, state.q, state.time)
    skin, markers = of_a_person(rng["skin"], rng["wander"], scene.markers, state.q, state.time)
    return replace(scene, markers=markers), skin
