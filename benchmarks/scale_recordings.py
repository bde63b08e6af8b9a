"""Recordings of any length, with any number of markers or joints: a part of benchmarks/scale.py."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.plane import PlaneFrame
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.recording.writing import write_c3d
from mocap_id.simulation import Motion, Options, Simulated, through
from mocap_id.simulation.body import Body, Link
from mocap_id.simulation.generate import take
from mocap_id.simulation.markers import PLATE, MarkerSet
from mocap_id.simulation.motion import smoothstep
from mocap_id.simulation.plate import draw_plate
from mocap_id.simulation.scene import Scene, Streams, draw_scene, streams

SEED = 930_000
REPETITIONS = 4  # half a minute of sit-to-stands
LINK, WIDTH = 0.30, 0.06  # m, of a chain of many joints
STEP, PAD = 0.02, 2.0  # s
SCATTER = 0.03  # m, between a marker and one that is added to it

_TRIAL = """\
trial: {name}
recording: {name}.c3d
protocol: {protocol}
subject: {{{subject}}}
"""


@dataclass(frozen=True)
class Wanted:
    """A recording to make: its frames, rate and analog rate (Hz), markers, and joints (None for a sit-to-stand)."""

    frames: int
    rate: float = 100.0
    analog: float = 1000.0
    markers: int = 50
    joints: int | None = None

    @property
    def name(self) -> str:
        """Of its files."""
        body = "sts" if self.joints is None else f"chain-{self.joints}"
        return f"{body}-{self.rate:g}-hz-{self.markers}-markers-{self.frames}-frames"

    @property
    def marker_frames(self) -> int:
        """Positions that it holds."""
        return self.frames * self.markers


def make(wanted: Wanted, place: Path) -> Path:
    """Write the recording and its trial's file, which is returned; what is there already is taken as it is."""
    file = place / f"{wanted.name}.yaml"
    if file.exists():
        return file
    options = Options(seed=SEED, rate=wanted.rate, analog_rate=wanted.analog, repetitions=REPETITIONS)
    rng = streams(options.seed)
    scene = _chain(wanted, rng) if wanted.joints else _person(wanted, options, rng)
    made = take(scene, options, rng)
    points, signals = played(made, wanted)
    write_c3d(place / f"{wanted.name}.c3d", scene.markers.labels, points, wanted.rate, plates=(signals,))
    told = f"mass: {scene.body.mass:.2f}"
    if wanted.joints is None:
        told = f"height: {scene.body.description['subject']['height_m']:.3f}, {told}"
    protocol = "free" if wanted.joints else "sit-to-stand"
    file.write_text(_TRIAL.format(name=wanted.name, protocol=protocol, subject=told), encoding="utf-8")
    return file


def played(made: Simulated, wanted: Wanted) -> tuple[FloatArray, PlateSignals]:
    """The trial to and fro for so many frames (backwards too the forces are those of the motion): points, channels."""
    per_frame = round(wanted.analog / wanted.rate)
    frames = len(made.points)
    there = to_and_fro(frames, wanted.frames)
    samples = to_and_fro((frames - 1) * per_frame + 1, wanted.frames * per_frame)
    return made.points[there], replace(made.signals, channels=made.signals.channels[samples])


def to_and_fro(own: int, count: int) -> IntArray:
    """``count`` indices 0 … own - 1 … 0 …"""
    period = np.concatenate([np.arange(own), np.arange(own - 2, 0, -1)])
    return np.resize(period, count)


def _person(wanted: Wanted, options: Options, rng: Streams) -> Scene:
    """A sit-to-stand with as many markers as wanted: evenly fewer, or more beside those there are."""
    scene = draw_scene("sit-to-stand", options, rng)
    own = scene.markers
    if wanted.markers <= len(own.labels):
        return replace(scene, markers=_some(own, _spread(own, wanted.markers)))
    more = np.resize(np.flatnonzero(~own.on_plate), wanted.markers - len(own.labels))
    added = _some(own, more)
    rounds = np.arange(len(more)) // int((~own.on_plate).sum())
    labels = tuple(f"{label}X{k + 1}" for label, k in zip(added.labels, rounds, strict=True))
    moved = rng["markers"].normal(0, SCATTER, added.local.shape)
    added = replace(added, labels=labels, local=added.local + moved, at_joint=(None,) * len(more))
    return replace(scene, markers=_joined(own, added))


def _spread(markers: MarkerSet, count: int) -> IntArray:
    """So many markers, of each link in its share and no fewer than three."""
    links = [np.flatnonzero(markers.link == link) for link in np.unique(markers.link)]
    share = [max(3, round(count * len(link) / len(markers.link))) for link in links]
    share[-1] += count - sum(share)
    chosen = [link[np.linspace(0, len(link) - 1, k).round().astype(int)] for link, k in zip(links, share, strict=True)]
    return np.sort(np.concatenate(chosen))


def _some(markers: MarkerSet, chosen: IntArray) -> MarkerSet:
    return MarkerSet(
        labels=tuple(markers.labels[k] for k in chosen),
        link=markers.link[chosen],
        local=markers.local[chosen],
        softness=markers.softness[chosen],
        hidden=markers.hidden[chosen],
        on_plate=markers.on_plate[chosen],
        at_joint=tuple(markers.at_joint[k] for k in chosen),
    )


def _joined(one: MarkerSet, other: MarkerSet) -> MarkerSet:
    return MarkerSet(
        labels=one.labels + other.labels,
        link=np.concatenate([one.link, other.link]),
        local=np.concatenate([one.local, other.local]),
        softness=np.concatenate([one.softness, other.softness]),
        hidden=np.concatenate([one.hidden, other.hidden]),
        on_plate=np.concatenate([one.on_plate, other.on_plate]),
        at_joint=one.at_joint + other.at_joint,
    )


def _chain(wanted: Wanted, rng: Streams) -> Scene:
    """A chain of equal links that stands on a plate, each joint swinging at a frequency of its own."""
    assert wanted.joints
    base = Link("base", None, (0.0, 0.0), 0.1, 5.0, (0.0, 0.05), 0.02)
    links = [Link(f"l{k}", f"j{k}", (0.0, LINK if k > 1 else 0.1), LINK, 2.0, (0.01, LINK / 2), 0.02)
             for k in range(1, wanted.joints + 1)]  # fmt: skip
    plate = draw_plate(rng["plate"], "reaction", moved=False, flipped=False, noise=1.0, bias=0.0)
    return Scene(
        body=Body((base, *links), (-0.2, 0.2), {}, {}),
        motion=_swinging(wanted.joints, wanted.frames / wanted.rate, rng["motion"]),
        chair=None,
        markers=_on_chain(wanted, rng["markers"]),
        plate=plate,
        plane=PlaneFrame(float(rng["place"].uniform(-np.pi, np.pi)), plate.centre),
        offset=0.0,
        protocol={"reps": []},
    )


def _swinging(joints: int, seconds: float, rng: np.random.Generator) -> Motion:
    """Sines of 0.2 to 0.5 Hz by 17 to 29°, from rest to rest."""
    time = np.arange(-PAD, seconds + PAD, STEP)
    frequency, size = rng.uniform(0.2, 0.5, joints), rng.uniform(0.3, 0.5, joints)
    moving = smoothstep((np.minimum(time, seconds - time) - 0.5) / 1.5)
    swing = np.sin(2 * np.pi * np.multiply.outer(time, frequency) + rng.uniform(0, 2 * np.pi, joints))
    return through(time, moving[:, None] * size * swing, seconds)


def _on_chain(wanted: Wanted, rng: np.random.Generator) -> MarkerSet:
    """Seven markers on the plate, the others on the links in turn."""
    assert wanted.joints
    count = wanted.markers - len(PLATE)
    link = 1 + np.arange(count) % wanted.joints
    low, high = (-WIDTH, 0.1 * LINK, -WIDTH), (WIDTH, 0.9 * LINK, WIDTH)
    local = np.concatenate([rng.uniform(low, high, (count, 3)), [(x, 0.004, z) for x, z in PLATE]])
    total = wanted.markers
    return MarkerSet(
        labels=tuple(f"M{k:03}" for k in range(count)) + tuple(f"PLT{k + 1}" for k in range(len(PLATE))),
        link=np.concatenate([link, np.zeros(len(PLATE), dtype=int)]),
        local=local,
        softness=np.where(np.arange(total) < count, 0.001, 0.0),
        hidden=np.arange(total) < count,
        on_plate=np.arange(total) >= count,
        at_joint=(None,) * total,
    )
