"""A simulated arm on a swaying thorax, with markers, that reaches or curls; in axes of the ISB (Wu 2005).

The coordinates of a movement are plane of elevation, elevation, the sum of plane and axial rotation, hinge angle,
pronation, wrist flexion and wrist deviation, rad.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.anatomy.frames import draw_skin_motion
from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray
from mocap_id.dynamics.priors import look_up_arm
from mocap_id.geometry import so3
from mocap_id.stages.device import Condition, DeviceFile
from mocap_id.stages.trial_keys import Body
from mocap_id_simulation.options import (
    PRESETS,
    ArmOptions,
    Difficulty,
    Movement,
    Preset,
    SimulatedSubject,
    draw_subject,
)
from mocap_id_simulation.sit_to_stand import (
    STEP,
    AxisRotation,
    JointMotion,
    X,
    Y,
    Z,
    constant_attitude,
    decompose_elbow,
    draw_sway,
    draw_tremor,
    motion_through,
    ramp_up,
    smoothstep,
)
from mocap_id_simulation.space_robot import SimulatedSpaceTrial, film_markers, transform_points

SEGMENTS = ("thorax", "upper_arm", "forearm", "hand")
THORAX, UPPER_ARM, FOREARM, HAND = range(4)


@dataclass(frozen=True)
class ArmBody:
    """A right arm on a thorax, in ISB axes: x forward, y up, z to the right."""

    subject: SimulatedSubject
    upper_arm: float  # length from the shoulder centre GH to the elbow centre along y, m
    forearm: float  # length from the elbow centre to the wrist centre along y, m
    shoulder: FloatArray  # (3,) shoulder centre GH in the thorax at zero elevation, m
    glide: FloatArray  # (3,) translation of GH in the thorax at 180° of elevation, m
    elbow_axis: FloatArray  # (3,) unit axis of the elbow's hinge in the upper arm
    carrying: float  # constant carrying angle of the bones, rad; negative as for most right elbows
    pronation_axis: FloatArray  # (3,) unit axis in the forearm
    landmarks: Mapping[
        str, tuple[int, FloatArray]
    ]  # segment and (3,) position of each landmark, m; AC at zero elevation

    @property
    def elbow(self) -> FloatArray:
        """Elbow centre (3,) in the upper arm, m."""
        return np.array([0.0, -self.upper_arm, 0.0])

    @property
    def wrist(self) -> FloatArray:
        """Wrist centre (3,) in the forearm, the middle of RS and US, m."""
        return np.asarray((self.landmarks["RS"][1] + self.landmarks["US"][1]) / 2)


def draw_arm(seed: int, glide: float) -> ArmBody:
    """Draw a person whose shoulder centre is displaced by ``glide``, m, at 180° of elevation."""
    subject = draw_subject(seed, 1 + seed % 2)
    rng = np.random.default_rng([seed, 1])
    height = subject.height
    upper_arm = height * rng.normal(0.186, 0.006)
    forearm = height * rng.normal(0.150, 0.005)
    shoulder = height * rng.normal((-0.022, -0.0155, 0.0965), (0.002, 0.002, 0.003))
    direction = np.array([rng.normal(-0.2, 0.02), 0.9, -0.4])
    # the middle of IJ and C7 is above the middle of PX and T8
    px = height * rng.normal((0.027, -0.095, 0.0), (0.003, 0.007, 0.0))
    c7 = height * rng.normal((-0.061, 0.028, 0.0), (0.002, 0.004, 0.0))
    t8 = np.array([c7[0] - px[0], height * rng.normal(-0.096, 0.003), 0.0])
    points = {"IJ": np.zeros(3), "PX": px, "C7": c7, "T8": t8}
    landmarks = {name: (THORAX, point) for name, point in points.items()}
    landmarks["AC"] = (THORAX, shoulder + np.array([-0.004 * height, 0.0258 * height, 0.010]))
    elbow, wrist = height * rng.normal(0.019, 0.001), height * rng.normal(0.0295, 0.001)
    landmarks["EL"] = (UPPER_ARM, np.array([0.0, -upper_arm, elbow]))
    landmarks["EM"] = (UPPER_ARM, np.array([0.0, -upper_arm, -elbow]))
    landmarks["US"] = (FOREARM, np.array([0.0, 0.004 - forearm, 0.0]))
    landmarks["RS"] = (FOREARM, np.array([0.0, -0.004 - forearm, wrist]))
    return ArmBody(
        subject=subject,
        upper_arm=upper_arm,
        forearm=forearm,
        shoulder=shoulder,
        glide=glide * direction / np.linalg.norm(direction),
        elbow_axis=_normalise(np.array([*rng.normal(0, 0.05, 2), 1.0])),
        carrying=-np.radians(np.clip(rng.normal(10, 3), 3, 17)),
        pronation_axis=_normalise(np.insert(rng.normal(0, 0.025, 2), 1, 1.0)),
        landmarks=landmarks,
    )


def _normalise(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


# --- markers

_LANDMARK_SLIDE = {"IJ": 1.0, "PX": 1.5, "C7": 1.5, "T8": 1.5, "AC": 4.0, "EL": 3.0, "EM": 4.0, "US": 1.0, "RS": 1.0}
_LANDMARK_LOSS = {"EL": 0.05, "EM": 0.05, "US": 0.08, "RS": 0.03}
_CHEST = ((30.0, -65.0, 60.0), (25.0, -65.0, -60.0), (45.0, -145.0, 50.0), (42.0, -142.0, -50.0))
_ON_HAND = ((-15.0, -49.0, -20.0), (-25.0, -53.0, 24.0), (-20.0, -93.0, -1.0))
_UPPER = ((44.0, 17.0), (21.0, 43.0), (-10.0, 47.0), (-34.0, 33.0))
_FORE = ((36.0, 0.0), (29.0, 21.0), (14.0, 33.0), (-5.0, 35.0))
_UPPER_SHARES = np.linspace(0.3, 0.8, 4)
_FORE_SHARES = np.linspace(0.25, 0.8, 4)
JITTER = 0.003  # m


@dataclass(frozen=True)
class ArmMarkers:
    """M markers in the coordinate frames of their segments at the start."""

    labels: tuple[str, ...]  # names in the file
    names: tuple[str, ...]  # names of the landmarks and cluster markers, also if the recording is anonymous
    segment: IntArray  # (M,)
    local: FloatArray  # (M, 3) m
    slide: FloatArray  # (M,) size of the displacement by sliding skin, m
    twist_loss: FloatArray  # (M,) fraction of the segment's axial rotation that the skin does not follow
    on_glide: BoolArray  # (M,) whether a marker of the thorax moves with the shoulder girdle


def _draw_markers(rng: np.random.Generator, body: ArmBody, sizes: Difficulty, anonymous: bool) -> ArmMarkers:
    """Place 24 markers: nine landmarks with palpation errors, and clusters on every segment."""
    names, segment, local, slide, loss = [], [], [], [], []
    for name, millimetres in _LANDMARK_SLIDE.items():
        part, bone = body.landmarks[name]
        names.append(name)
        segment.append(part)
        local.append(bone + rng.normal(0, 1, 3) * sizes.palpation)
        slide.append(millimetres)
        loss.append(_LANDMARK_LOSS.get(name, 0.0))
    upper, fore = rng.permutation(_UPPER_SHARES), rng.permutation(_FORE_SHARES)
    upper_sites = [(x, -1e3 * share * body.upper_arm, z) for (x, z), share in zip(_UPPER, upper, strict=True)]
    fore_sites = [(x, -1e3 * share * body.forearm, z) for (x, z), share in zip(_FORE, fore, strict=True)]
    for prefix, part, sites, slides, losses in (
        ("THX", THORAX, _CHEST, [1.5] * 4, [0.0] * 4),
        ("UPA", UPPER_ARM, upper_sites, rng.uniform(3.0, 10.0, 4), 0.6 * (0.8 - 0.6 * upper)),
        ("FOR", FOREARM, fore_sites, rng.uniform(1.5, 4, 4), 0.55 * (1 - 0.9 * fore)),
        ("HND", HAND, _ON_HAND, [1.1] * 3, [0.0] * 3),
    ):
        names += [f"{prefix}{i + 1}" for i in range(len(sites))]
        segment += [part] * len(sites)
        local += list(np.array(sites) / 1e3 + rng.normal(0, JITTER, (len(sites), 3)))
        slide += list(slides)
        loss += list(losses)
    landmarks = len(_LANDMARK_SLIDE)
    labels = names[:landmarks] + [f"M{i:03d}" for i in range(len(names) - landmarks)] if anonymous else names
    return ArmMarkers(
        labels=tuple(labels),
        names=tuple(names),
        segment=np.array(segment),
        local=np.array(local),
        slide=np.array(slide) / 1e3 * sizes.soft_tissue,
        twist_loss=np.array(loss) * sizes.twist_loss,
        on_glide=np.array([name == "AC" for name in names]),
    )


# --- movements

COORDINATES = ("plane", "elevation", "twist", "hinge", "pronation", "wrist_flexion", "wrist_deviation")
STILL = 2.0  # s at the start
ROUGHNESS = 4  # order of the smooth step of a movement

_REST = (30.0, 22.0, 10.0, 22.0, 90.0)
_TASKS = {
    "hip": (-30.0, 46.0, 62.0, 70.0, 70.0),
    "shoulder_right": (40.0, 63.0, -42.0, 148.0, 30.0),
    "shoulder_left": (118.0, 36.0, 78.0, 117.0, 90.0),
    "mouth": (85.0, 76.0, 38.0, 128.0, 70.0),
    "head": (102.0, 120.0, 36.0, 113.0, 90.0),
}
_LOWEST = (-34.0, 15.0, -46.0, 10.0, 10.0)
_HIGHEST = (124.0, 142.0, 84.0, 149.0, 167.0)
_LIMITED = ((0.8, 0.0, 0.4, 0.0, 0.0), (0.2, 0.8, 0.22, 0.06, 0.0))
"""Fractions by which a severity of 1 reduces the lower and the upper limits."""
_BENCH = (89.5, 49.6, 4.0, 40.0, 90.0)
_EXTENDED, _CURL, _ATTEMPT = 21.0, 107.0, 33.0
_COMPENSATION = np.array([0.10, 0.08, 0.15])  # rad: plane, elevation, axial, in the last curl


def _compose(
    pose: FloatArray, moves: Iterable[tuple[FloatArray, float, float]], end: float
) -> tuple[FloatArray, FloatArray]:
    """Return times (T,) from -1 s to 1 s after ``end``, s, and coordinates (T, 7) of smooth moves between poses.

    Each of the ``moves`` has the next pose (7,), and its start and end, s.
    """
    time = np.arange(-1.0, end + 1.0, STEP)
    values = np.tile(pose, (len(time), 1))
    for after, start, stop in moves:
        step = smoothstep((time - start) / (stop - start), ROUGHNESS)
        values += step[:, None] * (after - pose)
        pose = after
    return time, values


def _draw_movement(
    rng: np.random.Generator, options: ArmOptions, tremor_size: float
) -> tuple[JointMotion, dict[str, Any]]:
    """Draw the movement of a trial, and its entries in truth.json; ``tremor_size`` is a factor on its irregularity.

    The motion has 13 columns: the coordinates, rotations of the thorax about its x, y, z, and its translation in the
    laboratory.
    """
    reach = options.movement == "reach"
    (time, values), protocol, end = (_draw_reaches if reach else _draw_curls)(rng, options)
    rough = np.array([1, 1, 1, 1, 1, 0, 0]) * 0.5 * tremor_size
    if not reach:
        rough[:3] /= 2
    hand = np.radians((0, 0, 0, 0, 1.5, 3.5, 2.2)) * (1.0 if reach else (0, 0, 0, 0, 1.0, 0.4, 0.4))
    size = np.array([*np.radians((2.0, 2.0, 1.0)), 0.005, 0.004, 0.004]) * (1.0 if reach else 0.25)
    values += ramp_up(time, STILL) * (draw_tremor(rng, time, rough) + draw_sway(rng, time, hand))
    trunk = ramp_up(time, STILL) * draw_sway(rng, time, size)
    return motion_through(time, np.hstack([values, trunk]), end), protocol


_Course: TypeAlias = tuple[FloatArray, FloatArray]  # times (T,), s, and coordinates (T, 7)


def _draw_reaches(rng: np.random.Generator, options: ArmOptions) -> tuple[_Course, dict[str, Any], float]:
    """Return the reaches, their entries in truth.json, and the end of the trial, s."""
    left = 1 - options.severity * np.array(_LIMITED)
    low, high = np.array(_LOWEST) * left[0], np.array(_HIGHEST) * left[1]
    names = []
    for _ in range(options.cycles):
        for target in _TASKS:
            names += [target, "rest"] if rng.random() < 0.75 or target == "head" else [target]
    now = STILL
    tasks: list[dict[str, Any]] = []
    for name in names:
        target_pose = _REST if name == "rest" else _TASKS[name]
        pose = np.clip(np.array(target_pose) + rng.normal(0, 4, 5), low, high)
        end = now + rng.uniform(1.15, 1.7)
        tasks.append({"name": name, "start": now, "reach": end, "pose_rad": np.radians(pose).tolist()})
        now = end + rng.uniform(0.15, 0.5)
    now += 0.5
    moves = [(np.array([*task["pose_rad"], 0.0, 0.0]), task["start"], task["reach"]) for task in tasks]
    course = _compose(np.radians((*_REST, 0.0, 0.0)), moves, now)
    limits = {"names": list(COORDINATES[:5]), "lo": np.radians(low).tolist(), "hi": np.radians(high).tolist()}
    return course, {"severity": options.severity, "limits_used_rad": limits, "tasks": tasks}, now


def _draw_curls(rng: np.random.Generator, options: ArmOptions) -> tuple[_Course, dict[str, Any], float]:
    """Return the curls, their entries in truth.json, and the end of the trial, s."""
    base = np.array(_BENCH) + rng.normal(0, (2, 1.5, 2.5, 1, 0))
    first = STILL + 1.2
    length = first + 2.6 * (options.repetitions + options.failed + 1) + 3
    bench = np.radians((*base, 0.0, 0.0))
    extended = bench.copy()
    extended[3] = np.radians(_EXTENDED)
    moves = [(extended, STILL, first - 0.2)]
    now, repetitions, partials = first, [], []
    plane, elevation, axial = _COMPENSATION * options.compensation * rng.choice([-1, 1], 3)
    tired = np.array([plane, abs(elevation), plane + axial, 0, 0, 0, 0])
    for index in range(options.repetitions):
        fatigue = (index / max(options.repetitions - 1, 1)) ** 1.5
        amplitude = np.radians(_CURL * rng.normal(1, 0.025) * (1 - 0.08 * fatigue))
        top = extended + tired * (0.1 + 0.9 * fatigue)
        top[3] += amplitude
        times = now + np.cumsum([0.0, rng.uniform(0.91, 1.08), rng.uniform(0.04, 0.09), rng.uniform(0.85, 1.0)])
        moves += [(top, times[0], times[1]), (extended, times[2], times[3])]
        moments = dict(zip(("start", "top", "top_end", "end"), times.tolist(), strict=True))
        repetitions.append({"index": index, **moments, "amplitude_rad": float(amplitude), "fatigue": fatigue})
        now = times[3] + rng.uniform(0.04, 0.08)
    for _ in range(options.failed):
        now += 0.55
        top = extended.copy()
        top[3] += np.radians(_ATTEMPT * rng.uniform(0.8, 1.2))
        moves += [(top, now, now + 1), (extended, now + 1, now + 2)]
        partials.append({"start": now, "end": now + 2, "amplitude_rad": float(top[3] - extended[3])})
        now += 2.0
    protocol = {
        "curl_count": options.repetitions,
        "repetitions": repetitions,
        "partials": partials,
        "compensation": options.compensation,
    }
    return _compose(bench, moves, length), protocol, now + 1.0


# --- torques about the elbow in curls

_SEGMENTS = {"forearm": FOREARM, "hand": HAND}
_DUMBBELL = Body(mass=3.59, centre=(0.0, -0.075, 0.0), inertia=(0.009, 0.0014, 0.009))
_BRACE = Body(mass=0.2, centre=(0.0, -0.11, 0.03), inertia=(0.0005, 0.0003, 0.0005), segment="forearm")


def arm_bodies(body: ArmBody) -> dict[str, Body]:
    """Return forearm and hand of a person, with inertial parameters from de Leva's table."""
    bodies: dict[str, Body] = {}
    forearm = look_up_arm("forearm", body.subject.sex)
    for name, segment in (("forearm", forearm), ("hand", look_up_arm("hand", body.subject.sex))):
        mass, length = segment.mass * body.subject.mass, body.forearm * segment.length / forearm.length
        across = mass * (segment.gyration * length) ** 2
        bodies[name] = Body(
            mass=mass,
            centre=(0.0, -segment.centre * length, 0.0),
            inertia=(across, 0.0, across),
            segment="forearm" if name == "forearm" else "hand",
        )
    return bodies


def carried_loads(condition: str) -> dict[str, Body]:
    """Return the loads that a person carries: the dumbbell of the thesis, and a brace if the device is worn."""
    return {"dumbbell": _DUMBBELL} if condition == "C" else {"dumbbell": _DUMBBELL, "brace": _BRACE}


def body_keys(body: Body) -> dict[str, Any]:
    """Return the keys and rounded values of a body in a configuration."""
    keys = body.model_dump(mode="json")
    rounded = {name: [round(each, 6) for each in keys[name]] for name in ("centre", "inertia")}
    return {"mass": round(body.mass, 5), **rounded, "segment": body.segment}


_HIGH, _ATMOSPHERE = 446_063.0, 101_325.0  # Pa, absolute: 50 psi above the atmosphere, and the atmosphere
DEVICE = DeviceFile(
    device="simulated-elbow",
    pulley_radius_m=0.03,
    area_flexion_m2=2.835e-4,
    area_extension_m2=2.552e-4,
    dead_flexion_m=0.09,
    dead_extension_m=0.09,
    stroke_m=0.08,
    full_flexion_deg=150,
    polytropic=1.2,
    coulomb_Nm=0.2,
    viscous_Nms=0.02,
    supply_Pa=700_000,
    conditions={
        "C": Condition(worn=False),
        "AC": Condition(),
        "2": Condition(flexion_Pa=_ATMOSPHERE, extension_Pa=_HIGH),
        "3": Condition(flexion_Pa=_ATMOSPHERE, extension_Pa=_ATMOSPHERE),
        "4": Condition(flexion_Pa=_HIGH, extension_Pa=_HIGH),
        "5": Condition(flexion_Pa=_HIGH, extension_Pa=_ATMOSPHERE),
    },
)
"""Description of the device; its dimensions are assumed, because the thesis does not publish them."""


def device_yaml() -> bytes:
    """Return the content of the device's YAML file."""
    keys = DEVICE.model_dump(mode="json", exclude_defaults=True)
    return "".join(f"{name}: {json.dumps(value)}\n" for name, value in keys.items()).encode()


def curl_torques(options: ArmOptions, trial: SimulatedSpaceTrial) -> Mapping[str, FloatArray]:
    """Return the torques (F,) about the elbow's hinge by name, positive in flexion, N·m: total, device and human.

    The true device differs from its description by random errors with the standard deviations of the description. The
    same person has the same device in all trials.
    """
    body: ArmBody = trial.document["body"]
    elbow = trial.origins[:, FOREARM]
    step = 1 / trial.rate

    def rate(values: FloatArray) -> FloatArray:
        return np.asarray(np.gradient(values, step, axis=0, edge_order=2))

    moment = np.zeros((len(trial.time), 3))
    for one in (*arm_bodies(body).values(), *carried_loads(options.condition).values()):
        k = _SEGMENTS[one.segment]
        rotation = trial.rotations[:, k]
        centre = trial.origins[:, k] + rotation @ np.array(one.centre)
        about = rotation @ np.diag(one.inertia) @ rotation.transpose(0, 2, 1)
        spin = (about @ trial.omega[:, k, :, None])[..., 0]
        force = one.mass * (rate(rate(centre)) + GRAVITY * Z)
        moment += np.cross(centre - elbow, force) + rate(spin)
    total = np.einsum("ti,ti->t", trial.rotations[:, UPPER_ARM] @ body.elbow_axis, moment)
    flexion, velocity = trial.angles["elbow_flexion"], trial.rates["elbow_flexion"]
    state, device = DEVICE.conditions[options.condition], np.zeros(len(trial.time))
    if state.worn:
        rng = np.random.default_rng([person_seed(options), 30])
        cylinder, setting = DEVICE.cylinder(), state.setting()
        errors = {name: float(rng.normal(0, sd)) for name, sd in DEVICE.deviations().items()}
        gauge = errors.pop("gauge")
        true = replace(cylinder, **{name: max(getattr(cylinder, name) + error, 0.0) for name, error in errors.items()})
        true = replace(true, exponent=float(np.clip(true.exponent, 1.0, 1.4)))
        flexed, extended = (
            None if pressure is None else pressure + gauge for pressure in (setting.flexion, setting.extension)
        )
        spring = true.torque(flexion, replace(setting, flexion=flexed, extension=extended))
        device = np.asarray(spring + true.friction(velocity))
    return {"tau_total": total, "tau_device": device, "tau_human": total - device}


# --- the trial

MIRROR = np.array([1.0, -1.0, 1.0])
"""Factors that mirror laboratory positions of a right arm to a left arm."""
_SEAT = 0.60  # height of IJ, as a fraction of the stature


def simulate_arm(
    seed: int = 0, preset: Preset = "default", movement: Movement = "reach", **more: Any
) -> SimulatedSpaceTrial:
    """Simulate an arm; the same arguments give the same numbers. ``more`` are further fields of :class:`ArmOptions`.

    Examples
    --------
    >>> trial = simulate_arm(1, "clean", cycles=1)
    >>> trial.positions.shape[1:], trial.segments
    ((24, 3), ('thorax', 'upper_arm', 'forearm', 'hand'))
    """
    return generate_arm(ArmOptions(seed=seed, preset=preset, movement=movement, **more))


def generate_arm(options: ArmOptions) -> SimulatedSpaceTrial:
    """Simulate an arm with the given options."""
    sizes = PRESETS[options.preset]
    scale = options.soft_tissue
    sizes = replace(sizes, soft_tissue=sizes.soft_tissue * scale, twist_loss=sizes.twist_loss * min(scale, 1.0))
    person = person_seed(options)
    of_motion, of_sway, of_cameras = (np.random.default_rng([options.seed, 10 + i]) for i in range(3))
    session = person if options.markers is None else options.markers
    of_markers, of_skin = (np.random.default_rng([session, 20 + i]) for i in range(2))
    motion, protocol = _draw_movement(of_motion, options, sizes.tremor)
    body = draw_arm(person, options.glide_mm / 1e3 if options.movement == "reach" else 0.0)
    markers = _draw_markers(of_markers, body, sizes, options.anonymous)
    time = np.arange(round(motion.duration * options.rate)) / options.rate
    q, dq, ddq, _ = motion.at(time)
    frames = len(time)

    def about(axis: FloatArray, column: int, sign: float = 1.0) -> AxisRotation:
        return axis, sign * q[:, column], sign * dq[:, column], sign * ddq[:, column]

    # attitudes of thorax, upper arm, forearm and hand; the thorax starts upright within a few degrees, in any direction
    yaw = of_sway.uniform(-np.pi, np.pi)
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    upright = np.stack([forward, Z, np.cross(forward, Z)], axis=1)
    start = upright @ so3.exp(np.radians(of_sway.normal(0, 1.5, 3)))
    axial = Y, q[:, 2] - q[:, 0], dq[:, 2] - dq[:, 0], ddq[:, 2] - ddq[:, 0]
    none = np.zeros(frames)
    carrying = X, np.full(frames, body.carrying), none, none
    joints = (
        (about(Y, 0), about(X, 1, -1.0), axial),
        (about(body.elbow_axis, 3), carrying, about(body.pronation_axis, 4)),
        (about(Z, 5), about(X, 6)),
    )
    attitudes = [constant_attitude(start, frames).rotate((about(X, 7), about(Y, 8), about(Z, 9)))]
    for each in joints:
        attitudes.append(attitudes[-1].rotate(each))
    rotations = np.stack([each.rotation for each in attitudes], axis=1)
    # their origins
    centre = body.shoulder + (1 - np.cos(q[:, 1:2])) / 2 * body.glide  # of the shoulder in the thorax
    seat = np.array([*of_sway.uniform(-0.2, 0.2, 2), _SEAT * body.subject.height])
    at = [seat + q[:, 10:13]]
    for attitude, step in zip(attitudes, (centre, body.elbow, body.wrist), strict=False):
        at.append(at[-1] + (attitude.rotation @ np.broadcast_to(step, (frames, 3))[..., None])[..., 0])
    origins = np.stack(at, axis=1)
    # Displacement by soft tissue, zero in the first frame: the skin of a segment follows only a part of its axial
    # rotation, and slides with the two angles next to it, of elevation, elbow flexion, pronation and wrist flexion.
    turn = np.stack([none, q[:, 2], q[:, 4], none], axis=1)
    lost = -markers.twist_loss * (turn - turn[0])[:, markers.segment]
    turned = np.einsum("fmij,mj->fmi", so3.exp(lost[..., None] * Y), markers.local)
    beside = q[:, (1, 3, 4, 5)]
    slide = draw_skin_motion(of_skin, markers.segment, markers.slide, beside, time, wander=of_sway, middle=beside[0])
    skin = np.asarray(turned - markers.local + (slide - slide[0]))
    girdle = (centre - centre[0])[:, None] * markers.on_glide[:, None]
    # the recording
    true = transform_points(origins, rotations, markers.segment, markers.local + skin + girdle)
    if options.side == "left":
        true = true * MIRROR
    positions, bursts = film_markers(of_cameras, markers.labels, true, options.rate, sizes)
    elbows = decompose_elbow(constant_attitude(np.eye(3), frames).rotate(joints[1]))
    angles, rates, accelerations = (
        {
            "shoulder_plane": c[:, 0],
            "shoulder_elevation": c[:, 1],
            "shoulder_axial": c[:, 2] - c[:, 0],
            **dict(zip(("elbow_flexion", "elbow_carrying", "elbow_pronation"), elbow.T, strict=True)),
            "wrist_flexion": c[:, 5],
            "wrist_deviation": c[:, 6],
        }
        for c, elbow in zip((q, dq, ddq), elbows, strict=True)
    )
    hinge, pronation = (np.stack([c[:, i] for c in (q, dq, ddq)], axis=1) for i in (3, 4))
    trial = SimulatedSpaceTrial(
        labels=markers.labels,
        names=markers.names,
        rate=options.rate,
        time=time,
        positions=positions,
        true_positions=true,
        bursts=bursts,
        segments=SEGMENTS,
        assignment=markers.segment,
        local=markers.local,
        skin=skin,
        origins=origins,
        rotations=rotations,
        omega=np.stack([each.omega for each in attitudes], axis=1),
        alpha=np.stack([each.alpha for each in attitudes], axis=1),
        angles=angles,
        rates=rates,
        accelerations=accelerations,
        arrays={"gh_in_thorax": centre, "q_hinge": hinge, "q_pron": pronation},
        document={"body": body, "markers": markers, "protocol": protocol},
        still=STILL,
    )
    if options.movement == "reach":
        return trial
    return replace(trial, arrays={**trial.arrays, **curl_torques(options, trial)})


def person_seed(options: ArmOptions) -> int:
    """Return the seed of the person: ``subject``, or the trial's seed if it is omitted."""
    return options.seed if options.subject is None else options.subject
