"""An arm that moves a handle: parameters of the forearm from a plate, with a sensor in the handle and in the elbow."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import harness
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.geometry import planar
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.workflows.advice import AdviceOptions, advise_movement
from mocap_id_simulation.bodies import Link, SimulatedBody, add_plate_markers
from mocap_id_simulation.forces import TrueState
from mocap_id_simulation.instruments import draw_plate
from mocap_id_simulation.options import Options
from mocap_id_simulation.scene import Scene, SimulatedTrial, Streams, measure_scene, random_streams
from mocap_id_simulation.sit_to_stand import motion_through, smoothstep
from mocap_id_simulation.trial_files import c3d_bytes, write_trial

KNOWN = ("plate, without a handle", "plate", "plate and handle", "plate, handle and elbow")
"""What is measured. The handle pulls the hand, except in the first."""
NAMES = ("first moment", "moment of inertia")
_SECONDS, _STEP = 30.0, 0.02
_RATE = 500.0  # Hz, of the sensors
_NOISE = np.repeat([0.1, 0.002], 3)  # N, N·m: a small six-axis sensor with strain gauges
_ZERO, _GAIN = np.repeat([0.05, 0.001], 3), 0.003
_STIFF = (40.0, 80.0)  # N/m, of the spring that pulls the handle
_SITES = (
    ("SEA1", 0, 0.10, 0.45, 0.15, 0.0),
    ("SEA2", 0, -0.12, 0.55, 0.16, 0.0),
    ("SEA3", 0, 0.08, 0.80, 0.17, 0.0),
    ("UPA1", 1, 0.04, 0.08, 0.05, 2.0),
    ("UPA2", 1, -0.04, 0.14, 0.06, 2.0),
    ("UPA3", 1, 0.04, 0.20, 0.05, 2.0),
    ("UPA4", 1, -0.03, 0.27, 0.06, 1.0),
    ("ELB", 1, 0.0, 0.30, 0.06, 0.0),
    ("FOA1", 2, 0.03, 0.05, 0.05, 1.0),
    ("FOA2", 2, -0.03, 0.12, 0.05, 1.0),
    ("FOA3", 2, 0.03, 0.19, 0.05, 1.0),
    ("WRI", 2, -0.03, 0.24, 0.04, 0.5),
    ("HAN", 2, 0.0, 0.33, 0.0, 0.0),
)
"""Markers: label, segment, place in its frame and beside the plane, m, and largest slide of the skin, mm."""
_HAND, _ELBOW = "HAN", "ELB"
"""Markers on the sensors in the handle and the elbow: reference points of the moments."""


@dataclass(frozen=True)
class Held(Scene):
    """A scene in which a spring pulls the handle from ``anchor`` (2,), m, with ``stiffness``, N/m."""

    anchor: tuple[float, float] = (0.0, 0.0)
    stiffness: float = 0.0

    def handle(self, state: TrueState) -> FloatArray:
        """Return the wrench (T, 3) of the handle on the hand about the plane's origin."""
        place = _locate(self, state, _HAND)
        x, y = place.T
        fx, fy = (self.stiffness * (np.array(self.anchor) - place)).T
        return np.column_stack([fx, fy, x * fy - y * fx])

    def elbow(self, state: TrueState) -> FloatArray:
        """Return the wrench (T, 3) of the upper arm on the forearm about the plane's origin."""
        fore, (x, y) = self.body.links[2], self.body.links[2].com
        rows = planar_regressor(self.body.centres, state.q, state.qd, state.qdd)[..., 8:]
        own = rows @ [fore.mass, fore.mass * x, fore.mass * y, fore.about_origin]
        return np.asarray(own - self.handle(state))

    def at(self, time: FloatArray) -> TrueState:
        """Return state and forces at times (T,), s; the handle carries a part of the load on the ground."""
        state = super().at(time)
        return replace(state, wrench=state.wrench - self.handle(state))


def make_table(seeds: Sequence[int], jobs: int | None) -> str:
    rows = []
    for known in KNOWN:
        done = harness.run_all(measure, [(seed, known) for seed in seeds], jobs)
        for k, name in enumerate(NAMES):
            columns = np.array([each[:, k] for each in done])
            error, stated, foreseen = columns.T
            inside = np.mean(error < harness.QUANTILE * stated)
            middle = harness.format_numbers((np.median(error), np.median(stated)), ".1f")
            middle += ["–" if np.isnan(foreseen).all() else f"{np.median(foreseen):.1f}", f"{100 * inside:.0f} %"]
            rows.append([known, name, *middle])
        harness.report_progress(rows[-2:])
    head = ["measured", "of the forearm", "error, %", "stated sd, %", "foreseen sd, %", "inside 95 %"]
    return harness.format_table(head, rows, numbers_from=2)


def measure(task: tuple[int, str]) -> FloatArray:
    """Simulate and run a trial; return error, stated and foreseen standard deviation (3, 2) of both parameters, %.

    The foreseen one is the prediction of `advise` for a sensor in the elbow, from a trial with the sensor in the handle
    alone.
    """
    seed, known = task
    rng, options = random_streams(seed), Options(seed=seed, plate_bias=1.0)
    scene = _draw(rng, pulled=known != KNOWN[0])
    trial = measure_scene(scene, options, rng)
    with harness.temporary_folder() as place:
        configuration = write_trial(
            place / "trial", lambda name: _make_files(name, options, known, scene, trial, rng["board"])
        )
        done = harness.run_trial(configuration)
        value, sd = done.base("value"), done.base("sd")
        foreseen = (
            advise_movement(configuration, AdviceOptions(seconds=_SECONDS)).sensor_sd if known == KNOWN[2] else None
        )
    fore = scene.body.links[2].inertial_parameters
    true = np.array([np.hypot(fore["mx"], fore["my"]), fore["Izz"]])
    away = np.abs(_describe_forearm(value, value) - true)
    last = np.full(2, np.nan) if foreseen is None else _describe_forearm(value, foreseen)
    return np.asarray(100 * np.stack([away, _describe_forearm(value, sd), last]) / true)


def _describe_forearm(value: FloatArray, of: FloatArray) -> FloatArray:
    """Return first moment and moment of inertia (2,) of the forearm, or their standard deviations from ``of`` (b,)."""
    moment = value[-3:-1]
    size = float(np.hypot(*moment))
    along = moment / size if size > 0 else np.full(2, 0.5**0.5)
    return np.array([size if of is value else np.hypot(*(along * of[-3:-1])), of[-1]])


def _draw(rng: Streams, *, pulled: bool) -> Held:
    """Draw a seated person on a plate, the movement of one arm, and the spring at the handle."""
    of = rng["body"]
    size = of.uniform(0.85, 1.15, 3)
    upper, fore = 2.0 * size[0], 1.6 * size[1]
    links = (
        Link("seat", None, (0.0, 0.0), 1.0, 62.0 * size[2], (float(of.uniform(-0.05, 0.05)), 0.6), 5.0),
        Link("upper arm", "shoulder", (0.0, 1.0), 0.30, upper, (0.0, 0.13), upper * 0.09**2),
        Link("forearm", "elbow", (0.0, 0.30), 0.33, fore, (float(of.normal(0, 0.005)), 0.16), fore * 0.10**2),
    )
    of, time = rng["motion"], np.arange(-1.0, _SECONDS + 1.0, _STEP)
    near = smoothstep(np.minimum(time - 1.0, _SECONDS - 1.0 - time) / 2.0)
    fast = of.uniform(0.85, 1.15, 4) * [0.45, 0.85, 0.60, 1.10]  # Hz
    waves = np.sin(2 * np.pi * (time[:, None] * fast + of.uniform(0, 1, 4))) * [0.5, 0.12, 0.55, 0.12]
    q = np.array([np.pi - 0.5, -0.9]) + near[:, None] * np.column_stack([waves[:, :2].sum(1), waves[:, 2:].sum(1)])
    labels, link, x, y, z, slide = zip(*_SITES, strict=True)
    markers = add_plate_markers(
        rng["markers"],
        labels,
        np.array(link, dtype=np.int64),
        np.column_stack([x, y, z]),
        softness=1e-3 * np.array(slide),
        hidden=np.array(slide) > 0,
        at_joint=(None,) * len(labels),
    )
    plate = draw_plate(rng["plate"], "reaction", moved=False, flipped=False, noise=1.0, bias=1.0)
    of = rng["place"]
    return Held(
        body=SimulatedBody(links, (-0.3, 0.3), {"upper arm": 0.30}, {}),
        motion=motion_through(time, q, _SECONDS),
        chair=None,
        markers=markers,
        plate=plate,
        plane=PlaneFrame(float(of.uniform(-np.pi, np.pi)), plate.centre),
        offset=0.0,
        protocol={"reps": []},
        anchor=(float(of.uniform(-0.5, -0.3)), float(of.uniform(0.3, 0.6))),
        stiffness=pulled * float(of.uniform(*_STIFF)),
    )


def _locate(scene: Scene, state: TrueState, label: str) -> FloatArray:
    """Return the position (T, 2) of a marker in the plane, m."""
    at = np.array([scene.markers.labels.index(label)])
    local = scene.markers.local[at, :2]
    return np.asarray(planar.marker_positions(state.q, scene.body.centres, scene.markers.link[at], local)[:, 0])


def _make_files(  # noqa: PLR0917
    name: str, options: Options, known: str, scene: Held, trial: SimulatedTrial, rng: np.random.Generator
) -> Mapping[str, bytes]:
    state = scene.at(np.arange(round(_SECONDS * _RATE)) / _RATE)
    sensors, logs = [], {}
    if known in KNOWN[2:]:
        logs["handle.csv"] = _make_log(rng, scene, state, scene.handle(state), _HAND)
        sensors.append({"file": "handle.csv", "name": "handle", "segment": 2, "at": _HAND})
    if known == KNOWN[3]:
        logs["elbow.csv"] = _make_log(rng, scene, state, scene.elbow(state), _ELBOW)
        sensors.append({"file": "elbow.csv", "name": "elbow", "segment": 2, "at": _ELBOW, "measures": "beyond"})
    keys = {"trial": name, "recording": "trial.c3d", "identify-dim": {"motion": "chain"}, "external": sensors}
    return {"trial.c3d": c3d_bytes(options, trial), "trial.yaml": json.dumps(keys).encode(), **logs}


def _make_log(rng: np.random.Generator, scene: Scene, state: TrueState, wrench: FloatArray, label: str) -> bytes:
    """Return a sensor's CSV text.

    It has a wrench (T, 3) of the plane, about a marker and in the laboratory's axes.
    """
    x, y = _locate(scene, state, label).T
    fx, fy, tauz = wrench.T
    axes = scene.plane.axes
    moment = tauz - x * fy + y * fx
    exact = np.hstack([wrench[:, :2] @ axes[:2], moment[:, None] * axes[2]])
    read = exact * (1.0 + rng.normal(0.0, _GAIN)) + rng.normal(size=6) * _ZERO + rng.normal(size=exact.shape) * _NOISE
    rows = np.column_stack([state.time, read])
    lines = [",".join(f"{value:.5f}" for value in row) for row in rows]
    return "\n".join(["time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm", *lines]).encode() + b"\n"
