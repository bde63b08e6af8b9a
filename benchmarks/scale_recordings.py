"""Recordings of any length, with any number of markers or joints: a part of benchmarks/scale.py."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import IntArray
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.recording.writer import write_c3d
from mocap_id_simulation import JointMotion, Options, motion_through
from mocap_id_simulation.bodies import PLATE, Link, MarkerSet, SimulatedBody, add_plate_markers
from mocap_id_simulation.instruments import draw_plate
from mocap_id_simulation.motion import smoothstep
from mocap_id_simulation.scene import Scene, Streams, draw_scene, measure_scene, random_streams

SEED = 930_000
REPETITIONS = 4  # half a minute of sit-to-stands
LINK, WIDTH = 0.30, 0.06  # m, of a chain of many joints
STEP, PAD = 0.02, 2.0  # s
SCATTER = 0.03  # m, between a marker and an added one


@dataclass(frozen=True)
class Wanted:
    """Frames, rate and analog rate (Hz), markers, and joints (None for a sit-to-stand) of a recording to make."""

    frames: int
    rate: float = 100.0
    analog: float = 1000.0
    markers: int = 50
    joints: int | None = None

    @property
    def name(self) -> str:
        """Name of its files."""
        body = "sts" if self.joints is None else f"chain-{self.joints}"
        return f"{body}-{self.rate:g}-hz-{self.markers}-markers-{self.frames}-frames"

    @property
    def marker_frames(self) -> int:
        """Number of marker positions."""
        return self.frames * self.markers


def make(wanted: Wanted, place: Path) -> Path:
    """Write the recording and return its configuration; if it exists, return it unchanged."""
    file = place / f"{wanted.name}.yaml"
    if file.exists():
        return file
    options = Options(seed=SEED, rate=wanted.rate, analog_rate=wanted.analog, repetitions=REPETITIONS)
    rng = random_streams(options.seed)
    scene = _make_chain(wanted, rng) if wanted.joints else _make_person(wanted, options, rng)
    made = measure_scene(scene, options, rng)
    per_frame = round(wanted.analog / wanted.rate)
    frames = len(made.points)
    points = made.points[count_to_and_fro(frames, wanted.frames)]  # played forwards and backwards
    samples = count_to_and_fro((frames - 1) * per_frame + 1, wanted.frames * per_frame)
    signals = replace(made.signals, channels=made.signals.channels[samples])
    write_c3d(place / f"{wanted.name}.c3d", scene.markers.labels, points, wanted.rate, plates=(signals,))
    subject = {"mass": round(scene.body.mass, 2)}
    if wanted.joints is None:
        subject["height"] = round(scene.body.description["subject"]["height_m"], 3)
    keys = {"trial": wanted.name, "recording": f"{wanted.name}.c3d", "subject": subject}
    keys["protocol"] = "free" if wanted.joints else "sit-to-stand"
    file.write_text(json.dumps(keys), encoding="utf-8")
    return file


def count_to_and_fro(own: int, count: int) -> IntArray:
    """Return ``count`` indices that go from 0 to own - 1, back to 0, and so on."""
    period = np.concatenate([np.arange(own), np.arange(own - 2, 0, -1)])
    return np.resize(period, count)


def _make_person(wanted: Wanted, options: Options, rng: Streams) -> Scene:
    """Return a sit-to-stand with the wanted number of markers.

    Fewer markers are chosen evenly; additional markers are beside the usual markers.
    """
    scene = draw_scene("sit-to-stand", options, rng)
    own = scene.markers
    if wanted.markers <= len(own.labels):
        return replace(scene, markers=_select(own, _choose_evenly(own, wanted.markers)))
    more = np.resize(np.flatnonzero(~own.on_plate), wanted.markers - len(own.labels))
    added = _select(own, more)
    rounds = np.arange(len(more)) // int((~own.on_plate).sum())
    labels = tuple(f"{label}X{k + 1}" for label, k in zip(added.labels, rounds, strict=True))
    moved = rng["markers"].normal(0, SCATTER, added.local.shape)
    added = replace(added, labels=labels, local=added.local + moved, at_joint=(None,) * len(more))
    return replace(scene, markers=_join(own, added))


def _choose_evenly(markers: MarkerSet, count: int) -> IntArray:
    """Return ``count`` chosen markers, in proportion to the markers of each link and at least three of each."""
    links = [np.flatnonzero(markers.link == link) for link in np.unique(markers.link)]
    share = [max(3, round(count * len(link) / len(markers.link))) for link in links]
    share[-1] += count - sum(share)
    chosen = [link[np.linspace(0, len(link) - 1, k).round().astype(int)] for link, k in zip(links, share, strict=True)]
    return np.sort(np.concatenate(chosen))


def _select(markers: MarkerSet, chosen: IntArray) -> MarkerSet:
    def pick(values: Any) -> Any:
        return tuple(values[k] for k in chosen) if isinstance(values, tuple) else values[chosen]

    return MarkerSet(**{field.name: pick(getattr(markers, field.name)) for field in fields(MarkerSet)})


def _join(one: MarkerSet, other: MarkerSet) -> MarkerSet:
    pairs = {field.name: (getattr(one, field.name), getattr(other, field.name)) for field in fields(MarkerSet)}
    return MarkerSet(**{k: a + b if isinstance(a, tuple) else np.concatenate([a, b]) for k, (a, b) in pairs.items()})


def _make_chain(wanted: Wanted, rng: Streams) -> Scene:
    """Return a chain of equal links on a plate, whose joints swing at different frequencies."""
    assert wanted.joints
    base = Link("base", None, (0.0, 0.0), 0.1, 5.0, (0.0, 0.05), 0.02)
    links = [Link(f"l{k}", f"j{k}", (0.0, LINK if k > 1 else 0.1), LINK, 2.0, (0.01, LINK / 2), 0.02)
             for k in range(1, wanted.joints + 1)]  # fmt: skip
    plate = draw_plate(rng["plate"], "reaction", moved=False, flipped=False, noise=1.0, bias=0.0)
    return Scene(
        body=SimulatedBody((base, *links), (-0.2, 0.2), {}, {}),
        motion=_make_swing(wanted.joints, wanted.frames / wanted.rate, rng["motion"]),
        chair=None,
        markers=_place_markers(wanted, rng["markers"]),
        plate=plate,
        plane=PlaneFrame(float(rng["place"].uniform(-np.pi, np.pi)), plate.centre),
        offset=0.0,
        protocol={"reps": []},
    )


def _make_swing(joints: int, seconds: float, rng: np.random.Generator) -> JointMotion:
    """Return a motion of sines of 0.2 to 0.5 Hz and 17 to 29°, from rest to rest."""
    time = np.arange(-PAD, seconds + PAD, STEP)
    frequency, size = rng.uniform(0.2, 0.5, joints), rng.uniform(0.3, 0.5, joints)
    moving = smoothstep((np.minimum(time, seconds - time) - 0.5) / 1.5)
    swing = np.sin(2 * np.pi * np.multiply.outer(time, frequency) + rng.uniform(0, 2 * np.pi, joints))
    return motion_through(time, moving[:, None] * size * swing, seconds)


def _place_markers(wanted: Wanted, rng: np.random.Generator) -> MarkerSet:
    """Put the plate's markers on the plate and the others on the links in turn."""
    assert wanted.joints
    count = wanted.markers - len(PLATE)
    low, high = (-WIDTH, 0.1 * LINK, -WIDTH), (WIDTH, 0.9 * LINK, WIDTH)
    return add_plate_markers(
        rng,
        tuple(f"M{k:03}" for k in range(count)),
        1 + np.arange(count) % wanted.joints,
        rng.uniform(low, high, (count, 3)),
        softness=np.full(count, 0.001),
        hidden=np.ones(count, dtype=np.bool_),
        at_joint=(None,) * count,
    )
