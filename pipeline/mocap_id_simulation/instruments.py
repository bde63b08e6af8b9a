"""Simulated force plates, encoder, wrench sensor, balance board, inertial sensors and cameras, and their faults.

The plate's own axes P are right-handed with z down. Its corners are listed in the order +x+y, -x+y, -x-y, +x-y of P.
ORIGIN points from the transducer to the centre of the working surface: M_sensor = M_surface + ORIGIN × F.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import make_interp_spline

from mocap_id.anatomy.frames import WANDER, draw_slide, draw_wander, mid_range
from mocap_id.arrays import GRAVITY, BoolArray, FloatArray
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.geometry import so3
from mocap_id.recording.imu_log import ImuLog
from mocap_id.recording.lab_plates import PlateSignals
from mocap_id_simulation.bodies import MIDDLE, MarkerSet
from mocap_id_simulation.options import FaultOptions, Sense
from mocap_id_simulation.sit_to_stand import Schedule, draw_direction, smoothstep

if TYPE_CHECKING:
    from mocap_id_simulation.forces import TrueState
    from mocap_id_simulation.scene import Scene

SIZE = (0.464, 0.508)  # m, along x and y of P
FORCE_NOISE = 1.0  # N
MOMENT_NOISE = 0.3  # N·m
FORCE_BIAS = 3.0  # N
MOMENT_BIAS = 0.3  # N·m


@dataclass(frozen=True)
class SimulatedPlate:
    """A force plate of type 2: six channels, forces and moments about the transducer."""

    sense: Sense  # whether it measures the force of the plate on the body (reaction) or the opposite (action)
    centre: FloatArray  # (3,) centre of the working surface in the laboratory, m
    yaw: float  # angle about the vertical between the laboratory's x axis and P's, rad
    origin: FloatArray  # (3,) ORIGIN in P, m
    flipped: bool  # whether the file contains -ORIGIN, like some old files
    bias: FloatArray  # (6,) constant error of forces, N, and transducer moments, N·m
    noise: float  # factor on FORCE_NOISE and MOMENT_NOISE

    @property
    def axes(self) -> FloatArray:
        """(3, 3) axes of P in the laboratory, as columns."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])

    @property
    def corners(self) -> FloatArray:
        """(4, 3) corners in the laboratory, m."""
        signs = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
        return self.centre + (signs * (SIZE[0] / 2, SIZE[1] / 2, 0.0)) @ self.axes.T


def draw_plate(
    rng: np.random.Generator, sense: Sense, *, moved: bool, flipped: bool, noise: float, bias: float
) -> SimulatedPlate:
    """Draw a plate at the laboratory's origin and along its axes; if ``moved``, it is shifted, lifted and rotated."""
    centre = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.02, 0.02)])
    yaw = rng.uniform(-np.pi / 6, np.pi / 6)
    origin = np.array([*rng.normal(0, 0.0005, 2), -rng.uniform(0.035, 0.055)])
    scale = np.array([FORCE_BIAS] * 3 + [MOMENT_BIAS] * 3)
    return SimulatedPlate(
        sense=sense,
        centre=centre if moved else np.zeros(3),
        yaw=float(yaw) if moved else 0.0,
        origin=origin,
        flipped=flipped,
        bias=rng.normal(0, 1, 6) * scale * bias,
        noise=noise,
    )


def measure_load(
    rng: np.random.Generator, plate: SimulatedPlate, force: FloatArray, moment: FloatArray, rate: float
) -> PlateSignals:
    """Return the plate's noisy channels, as stored in a file with sampling rate ``rate``, Hz.

    ``force`` and ``moment`` (K, 3) act from the plate on the body, in laboratory axes, about the centre of the
    working surface, N and N·m.
    """
    sign = 1.0 if plate.sense == "reaction" else -1.0
    f, m = sign * force @ plate.axes, sign * moment @ plate.axes
    at_sensor = np.concatenate([f, m + np.cross(plate.origin, f)], axis=1)
    scale = plate.noise * np.array([FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3)
    read: FloatArray = at_sensor + plate.bias + rng.normal(0, 1, at_sensor.shape) * scale
    in_file = -plate.origin if plate.flipped else plate.origin
    return PlateSignals(2, read, in_file, plate.corners, rate)


_ENCODER_RATE = 125.0  # Hz
_SENSOR_RATE = 500.0  # Hz
_FORCE_NOISE, _MOMENT_NOISE = 0.1, 0.002  # N, N·m: a small six-axis sensor with strain gauges
_FORCE_ZERO, _MOMENT_ZERO = 0.05, 0.001  # N, N·m: standard deviations of the zero
_GAIN = 0.003  # standard deviation of the relative error of the gain
_WIDTH, _DEPTH, _HEIGHT = 0.433, 0.238, 0.053  # m: distances between the cells, and their depth below the surface
_SIGNS = np.array([[-1, 1], [1, 1], [-1, -1], [1, -1]])  # right and top of the cells tl, tr, bl, br
_PERIOD, _JITTER = 0.011, 0.001  # s between samples
_STAMP, _DELAY = 0.01, 0.004  # s: resolution of the time stamps, and mean delay of the transmission
_STALLS, _STALL = 0.004, 0.06  # fraction of the samples followed by a pause, and the longest pause, s
_STEP_KG, _NOISE_KG, _TARE_KG, _CELL_GAIN = 0.1, 0.05, 0.15, 0.005
_CENTRE_M, _YAW = 0.02, 0.02  # m and rad: largest errors of position and direction
_DIRECTIONS = {"forwards": 0.0, "left": np.pi / 2, "backwards": np.pi, "right": -np.pi / 2}


def measure_encoder(rng: np.random.Generator, scene: Scene) -> tuple[str, dict[str, Any]]:
    """Return CSV text with position, velocity and torque of the first joint, and its errors as JSON values."""
    errors = {
        "clock_offset_s": float(rng.uniform(-0.002, 0.002)),
        "position_sd": 1e-4,  # rad
        "velocity_sd": 1e-3,  # rad/s
        "torque_sd": 0.3,  # N·m
    }
    clock_offset, *sizes = errors.values()
    time = np.arange(round(scene.motion.duration * _ENCODER_RATE)) / _ENCODER_RATE
    state = scene.at(time + clock_offset)
    exact = np.column_stack([state.q[:, 0], state.qd[:, 0], state.tau[:, 0]])
    rows = np.column_stack([time, exact + rng.normal(0, 1, exact.shape) * sizes])
    lines = [",".join(f"{value:.8f}" for value in row) for row in rows]
    note = "the row at time_s is the state at the markers' time time_s + clock_offset_s; the torque has no friction"
    text = "\n".join(["time_s,position_rad,velocity_rad_s,torque_Nm", *lines]) + "\n"
    return text, {"rate_hz": _ENCODER_RATE, **errors, "note": note}


def joint_sensor_csv(rng: np.random.Generator, scene: Scene) -> str:
    """Return CSV text with the measured wrench of the base on the moving part, about the joint in laboratory axes."""
    time = np.arange(round(scene.motion.duration * _SENSOR_RATE)) / _SENSOR_RATE
    state, link = scene.at(time), scene.body.links[1]
    x, y = link.com
    rows = planar_regressor(np.array([link.centre]), state.q, state.qd, state.qdd)[..., 4:]
    wrench = rows @ np.array([link.mass, link.mass * x, link.mass * y, link.about_origin])
    moment = wrench[:, 2] - link.centre[0] * wrench[:, 1] + link.centre[1] * wrench[:, 0]
    axes = scene.plane.axes
    exact = np.hstack([wrench[:, :2] @ axes[:2], moment[:, None] * axes[2]])
    noise = np.repeat([_FORCE_NOISE, _MOMENT_NOISE], 3)
    zero = rng.normal(0.0, 1.0, 6) * np.repeat([_FORCE_ZERO, _MOMENT_ZERO], 3)
    measured = exact * (1.0 + rng.normal(0.0, _GAIN)) + zero + rng.normal(0.0, 1.0, exact.shape) * noise
    lines = [f"{t:.4f}," + ",".join(f"{value:.5f}" for value in row) for t, row in zip(time, measured, strict=True)]
    return "\n".join(["time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm", *lines]) + "\n"


def measure_board(rng: np.random.Generator, scene: Scene, clock_offset: float) -> tuple[str, dict[str, Any]]:
    """Return CSV text with a board's time stamps, s, and cells, kg, and its position and errors as JSON values.

    On average, the row with time stamp ``time_s`` was measured at ``time_s + clock_offset`` on the markers' clock, s.
    """
    errors: dict[str, Any] = {
        "clock_offset": clock_offset,
        "top": str(rng.choice(list(_DIRECTIONS))),  # direction of the board's top, seen by the person
        # position of its centre relative to the plate's, forwards and to the left, m; error of its direction, rad
        "centre": [float(rng.uniform(-_CENTRE_M, _CENTRE_M)), float(rng.uniform(-_CENTRE_M, _CENTRE_M))],
        "yaw": float(rng.uniform(-_YAW, _YAW)),
        # reading of the cells tl, tr, bl, br without load, kg, and factor on their load
        "tare": rng.normal(0.0, _TARE_KG, 4).tolist(),
        "gain": (1.0 + rng.normal(0.0, _CELL_GAIN, 4)).tolist(),
        "cells_below_surface_m": _HEIGHT,
    }
    steps = np.maximum(rng.normal(_PERIOD, _JITTER, int(scene.motion.duration / _PERIOD) + 1), _PERIOD / 2)
    steps += np.where(rng.random(len(steps)) < _STALLS, rng.uniform(0.0, _STALL, len(steps)), 0.0)
    time = np.cumsum(steps)
    time = time[time < scene.motion.duration]
    received = np.maximum.accumulate(time + rng.exponential(_DELAY, len(time)))
    stamps = np.round(received / _STAMP) * _STAMP
    stamps -= np.mean(stamps - time) + clock_offset
    # loads of the cells from force and moment about the plate's centre, in laboratory axes
    force, moment = scene.load_on_plate(scene.at(time))
    forwards = -scene.plane.axes[0, :2]  # people face the plane's -x
    left = np.array([-forwards[1], forwards[0]])
    angle = _DIRECTIONS[errors["top"]] + errors["yaw"]
    top = np.cos(angle) * forwards + np.sin(angle) * left
    right = np.array([top[1], -top[0]])
    at = np.array([*(errors["centre"][0] * forwards + errors["centre"][1] * left), -_HEIGHT])
    about = moment - np.cross(at, force)
    pressure = np.column_stack([-about[:, 1], about[:, 0]]) / force[:, 2:]
    share = np.stack([pressure @ right / (_WIDTH / 2), pressure @ top / (_DEPTH / 2)], axis=1)
    cells = force[:, 2:] / 4 * np.prod(1.0 + _SIGNS * share[:, None], axis=2) / GRAVITY
    readings = cells * errors["gain"] + errors["tare"] + rng.normal(0.0, _NOISE_KG, cells.shape)
    rows = np.column_stack([stamps, np.round(readings / _STEP_KG) * _STEP_KG])
    lines = [",".join((f"{row[0]:.4f}", *(f"{value:.1f}" for value in row[1:]))) for row in rows]
    return "\n".join(["time_s,tl_kg,tr_kg,bl_kg,br_kg", *lines]) + "\n", errors


_IMU_RATE = 100.0  # samples per second of a sensor's own clock
IMU_SEED = 30
"""Number that, together with the seed of the trial, seeds the errors of the sensors."""
_IMU_STEPS = (0.001065, 0.00958)  # rad/s and m/s²; 16 bits of ±2000 °/s and ±16 g
_DENSITIES = (1.745e-4, 1.96e-3)  # rad/s/√Hz and m/s²/√Hz
_BIASES = (0.0105, 0.12)  # rad/s and m/s²; standard deviations
_DRIFTS = (5e-5, 1.3e-3)  # rad/s/√s and m/s²/√s
_SCALE = 0.004
_OFFSET = 0.05  # s
_PPM = 30.0
_SKIN_ROTATION = 0.03  # rad, of the skin at the ends of the motion, in any direction
_SWITCHED_ON = 0.3  # fraction of a bias that changes from one recording to the next
_FORWARDS, _ALONG, _ACROSS = 0.06, 0.6, 0.05  # m, fraction of the length, m: mean position from the segment's origin


def simulate_plane_sensors(
    seed: int, scene: Scene, state: TrueState, softness: float, person: int | None = None
) -> dict[str, tuple[ImuLog, dict[str, Any]]]:
    """Return log and truth of a sensor on each moving segment, by its name; the person must not have separate bodies.

    ``state`` is the true state at the frames. ``softness`` is a factor on the rotation of the skin, which follows the
    joints at both ends of the segment. With the seed ``person``, position and mounting are the same in all trials.
    """
    sensors = {}
    axes = scene.plane.axes.T
    for s, link in enumerate(scene.body.links[1:]):
        rng = np.random.default_rng([seed, IMU_SEED, s])
        kept = None if person is None else np.random.default_rng([person, IMU_SEED, s])
        position = np.array([-_FORWARDS, _ALONG * link.length, _ACROSS]) * (kept or rng).uniform(0.6, 1.4, 3)
        # Rotation vectors of the skin, about one size at the ends of the motion: in all trials of a person the same
        # function of the angles, with a drift of the trial.
        middle = mid_range(state.q) if kept is None else MIDDLE
        slide = draw_slide(kept or rng, s + 1, state.q, middle)
        skin = slide + WANDER * draw_wander(rng, state.time)
        skin = softness * _SKIN_ROTATION * (skin - skin.mean(axis=0) if kept is None else skin)
        segment = so3.exp(state.seg_angle[:, s, None] * np.array([0.0, 0.0, 1.0]))
        points = np.column_stack([state.joint_xy[:, s], np.full(len(segment), scene.offset)]) + segment @ position
        truth = {"position_in_segment_m": position.tolist(), "skin_turn_rad": float(np.ptp(skin[:, 2]))}
        rotations, points = axes @ segment @ so3.exp(skin), scene.plane.from_plane(points)
        sensors[link.name] = measure_motion(
            rng, state.time, rotations, points, error_factor=1.0, truth=truth, kept=kept
        )
    return sensors


def measure_motion(
    rng: np.random.Generator,
    time: FloatArray,
    rotations: FloatArray,
    positions: FloatArray,
    *,
    error_factor: float,
    truth: Mapping[str, Any],
    kept: np.random.Generator | None = None,
) -> tuple[ImuLog, dict[str, Any]]:
    """Return the log of a sensor with its own clock, mounting and errors, and their truth, to which ``truth`` is added.

    ``rotations`` (F, 3, 3) from the skin under the sensor to the laboratory, z up, and ``positions`` (F, 3) of the
    sensor, m, are at the times (F,) of the frames, s. ``error_factor`` is a factor on all errors. The generator
    ``kept``, if given, draws what is the same in all trials: mounting, scale and the larger part of the biases.
    """
    own = kept or rng
    mount = so3.exp(own.uniform(0, np.pi) * draw_direction(own))
    offset, ppm = error_factor * _OFFSET * rng.standard_normal(), error_factor * _PPM * rng.standard_normal()
    first = np.ceil((time[0] - offset) * _IMU_RATE)
    stamps = np.arange(first, (time[-1] - offset) / (1 + 1e-6 * ppm) * _IMU_RATE) / _IMU_RATE
    at = offset + stamps * (1 + 1e-6 * ppm)
    attitude = make_interp_spline(time, rotations.reshape(-1, 9), k=5)
    turn = attitude(at).reshape(-1, 3, 3)
    spin = np.swapaxes(turn, 1, 2) @ attitude(at, 1).reshape(-1, 3, 3)
    omega = np.stack([spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]], 1)
    force = make_interp_spline(time, positions, k=5)(at, 2) + np.array([0.0, 0.0, GRAVITY])
    signals: list[FloatArray] = []
    errors: dict[str, Any] = {}
    pures = {"gyro": omega / 2 @ mount, "acc": np.einsum("fji,fj->fi", turn, force) @ mount}
    for k, (name, pure) in enumerate(pures.items()):
        scale = 1 + error_factor * _SCALE * own.standard_normal(3)
        walk = np.cumsum(rng.standard_normal((len(at), 3)), axis=0) * error_factor * _DRIFTS[k] / np.sqrt(_IMU_RATE)
        bias = error_factor * _BIASES[k] * own.standard_normal(3) + walk
        if kept is not None:
            bias += error_factor * _SWITCHED_ON * _BIASES[k] * rng.standard_normal(3)
        density = error_factor * _DENSITIES[k] * rng.uniform(0.8, 1.5)
        noisy = scale * pure + bias + density * np.sqrt(_IMU_RATE / 2) * rng.standard_normal(pure.shape)
        signals.append(np.round(noisy / _IMU_STEPS[k]) * _IMU_STEPS[k] if error_factor else noisy)
        errors |= {f"{name}_bias_start": bias[0].tolist(), f"{name}_bias_end": bias[-1].tolist()}
        errors |= {f"{name}_scale": scale.tolist(), f"{name}_nd": density}
    clock = {"offset_s": offset, "ppm": ppm, "mount_R_sensor_to_segment": mount.tolist(), "n": len(at)}
    return ImuLog(stamps, signals[0], signals[1]), clock | dict(truth) | errors


BURST = (5, 200)  # frames
BURSTS_PER_SECOND = 0.6
JUMP = (0.02, 0.08)  # m
JUMP_LENGTH = (5, 100)  # frames


@dataclass(frozen=True)
class MarkerEpisode:
    """Frames of one marker with an occlusion or a jump, named as in truth.json."""

    label: str
    first_frame: int
    n_frames: int

    @property
    def frames(self) -> slice:
        """The frames."""
        return slice(self.first_frame, self.first_frame + self.n_frames)


def draw_occlusions(
    rng: np.random.Generator, labels: Sequence[str], frames: int, rate: float, often: float
) -> tuple[MarkerEpisode, ...]:
    """Draw occlusions of the markers ``labels``; ``often`` is a factor on the usual number, ``rate`` is in Hz."""
    bursts = []
    for _ in range(round(often * BURSTS_PER_SECOND * frames / rate)):
        count = min(int(np.exp(rng.uniform(*np.log(BURST)))), frames // 2)
        bursts.append(MarkerEpisode(str(rng.choice(labels)), int(rng.integers(frames - count)), count))
    return tuple(bursts)


def find_visible(labels: Sequence[str], occlusions: Sequence[MarkerEpisode], frames: int) -> BoolArray:
    """Return whether each marker is visible, (T, M)."""
    visible = np.ones((frames, len(labels)), dtype=np.bool_)
    for each in occlusions:
        visible[each.frames, labels.index(each.label)] = False
    return visible


def measure_positions(rng: np.random.Generator, positions: FloatArray, noise: float, visible: BoolArray) -> FloatArray:
    """Return positions (T, M, 3) with white noise of standard deviation ``noise``, m; NaN where not visible."""
    noisy = positions + rng.normal(0, 1, positions.shape) * noise
    return np.where(visible[..., None], noisy, np.nan)


# --- faults

GHOST = "GHOST"
"""Beginning of the label of a trajectory that belongs to no marker."""

_WOBBLE_HZ = 4.0
_X = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Displacement:
    """Displacement of the whole person from the simulated motion; rotations are about the plane's origin."""

    shift: FloatArray  # (T,) translation along the motion, m
    turn: FloatArray  # (T,) rotation about the vertical, rad
    lean: float  # rotation about the direction of the motion, rad

    def positions(self, points: FloatArray) -> FloatArray:
        """Return displaced positions (T, M, 3) in the plane frame, m."""
        turned = _rotate_about_y(points + self.shift[:, None, None] * _X, self.turn[:, None])
        return _rotate_about_x(turned, self.lean)

    def load(
        self, force: FloatArray, moment: FloatArray, weight: float, com: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return force and moment (T, 3) of the ground on the displaced person about the plane's origin, N and N·m.

        ``force`` and ``moment`` (T, 3) act on the person before the displacement; ``com`` (T, 3) is the centre of mass
        then, m. The ``weight``, N, stays vertical.
        """
        moment = moment + np.cross(self.shift[:, None] * _X, force)
        force, moment = _rotate_about_y(force, self.turn), _rotate_about_y(moment, self.turn)
        up = np.array([0.0, weight, 0.0])
        com = _rotate_about_y(com + self.shift[:, None] * _X, self.turn)
        leaned = _rotate_about_x(com, self.lean)
        return (
            _rotate_about_x(force - up, self.lean) + up,
            _rotate_about_x(moment - np.cross(com, up), self.lean) + np.cross(leaned, up),
        )


def draw_displacement(
    seed: int, faults: FaultOptions, schedule: Schedule | None, time: FloatArray
) -> Displacement | None:
    """Draw the displacement at times (T,), s; it changes only while the person sits. None if no fault displaces."""
    if not (faults.foot_slide_mm or faults.foot_moves_mm or faults.turn_deg or faults.plane_tilt_deg):
        return None
    rng = np.random.default_rng(seed)
    shift, turn = np.zeros_like(time), np.zeros_like(time)
    repetitions = () if schedule is None else schedule.repetitions
    gaps = [(before.sit_end, after.rise_start) for before, after in pairwise(repetitions)]
    at = np.zeros(len(gaps) + 1)
    if gaps and faults.foot_slide_mm:
        at[1 + int(rng.integers(len(gaps))) :] += faults.foot_slide_mm / 1e3 * rng.choice((-1, 1))
    if gaps and faults.foot_moves_mm:
        at[1:] += rng.uniform(-1, 1, len(gaps)) * faults.foot_moves_mm / 1e3
    for k, (begin, end) in enumerate(gaps):
        step = smoothstep((time - begin) / (end - begin))
        shift += (at[k + 1] - at[k]) * step
        if k == (len(gaps) - 1) // 2:
            turn += np.radians(faults.turn_deg) * step
    return Displacement(shift + at[0], turn, float(np.radians(faults.plane_tilt_deg)))


def _rotate_about_y(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors (..., 3) of the plane frame after a rotation about its y axis by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x + s * z, y, -s * x + c * z], axis=-1)


def _rotate_about_x(vectors: FloatArray, angle: float) -> FloatArray:
    """Return vectors (..., 3) of the plane frame after a rotation about its x axis by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x, c * y - s * z, s * y + c * z], axis=-1)


def draw_skin_faults(
    rng: np.random.Generator, faults: FaultOptions, markers: MarkerSet, time: FloatArray
) -> FloatArray:
    """Return the displacements (T, M, 3) by a reattached marker and by oscillating skin, in the links' frames, m."""
    added = np.zeros((len(time), len(markers.labels), 3))
    if faults.reattached_mm:
        marker = _draw_moving_marker(rng, markers)
        away = rng.normal(size=3) * (1, 1, 0.3)
        since = time >= time[0] + rng.uniform(0.3, 0.7) * np.ptp(time)
        added[since, marker] += faults.reattached_mm / 1e3 * away / np.linalg.norm(away)
    if faults.wobble_mm:
        for link in range(1, int(markers.link.max()) + 1):
            swell = 1 + 0.5 * np.sin(2 * np.pi * rng.uniform(0.1, 0.3) * time + rng.uniform(0, 6.3))
            wave = swell * np.sin(2 * np.pi * _WOBBLE_HZ * rng.uniform(0.9, 1.1) * time + rng.uniform(0, 6.3))
            direction = rng.normal(size=3)
            wobble = np.sqrt(2) * faults.wobble_mm / 1e3 * wave[:, None] * direction / np.linalg.norm(direction)
            added[:, markers.link == link] += wobble[:, None, :]
    return added


def add_camera_faults(
    rng: np.random.Generator, faults: FaultOptions, scene: Scene, points: FloatArray, rate: float
) -> tuple[tuple[str, ...], FloatArray, dict[str, Any]]:
    """Return labels, positions and truth after adding the cameras' faults to measured positions.

    Positions (T, M, 3) are in the laboratory, m, and NaN where not visible; ``rate`` is in Hz. Trajectories that belong
    to no marker come last. The truth contains the markers and the frames of each fault.
    """
    markers, truth = scene.markers, dict[str, Any]()
    points, labels, frames = points.copy(), markers.labels, len(points)
    if faults.wander_mm:
        frequency = rng.uniform(0.02, 0.5, (8, 1, *points.shape[1:]))
        phase = rng.uniform(0, 2 * np.pi, frequency.shape)
        waves = np.sin(2 * np.pi * frequency * (np.arange(frames) / rate)[:, None, None] + phase).sum(axis=0)
        points += faults.wander_mm / 1e3 * waves / 2
    if faults.frozen_s:
        marker, (first, last) = _draw_moving_marker(rng, markers), _draw_frames(rng, frames, faults.frozen_s * rate)
        seen = np.flatnonzero(np.isfinite(points[: last + 1, marker, 0]))
        points[first:last, marker] = points[seen[np.argmin(np.abs(seen - first))], marker]
        truth["frozen"] = {"label": labels[marker], "first_frame": first, "n_frames": last - first}
    if faults.mislabelled_s:
        one, other = rng.choice(np.flatnonzero(markers.link > 0), 2, replace=False)
        first, last = _draw_frames(rng, frames, faults.mislabelled_s * rate)
        points[first:last, [one, other]] = points[first:last, [other, one]]
        names = [labels[one], labels[other]]
        truth["mislabelled"] = {"labels": names, "first_frame": first, "n_frames": last - first}
    ghosts = []  # trajectories that belong to no marker
    if faults.ghost_walks:
        start, end = rng.uniform(-1.5, 1.5, 3), rng.uniform(-1.5, 1.5, 3)
        start[2], end[2] = rng.uniform(0.2, 1.8, 2)
        ghosts.append(np.linspace(start, end, frames) + rng.normal(0, 5e-4, (frames, 3)))
    if faults.ghost_reflects:
        marker, normal = _draw_moving_marker(rng, markers), rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        mirror = np.nanmean(points[:, marker], axis=0) + rng.uniform(0.1, 0.4) * normal
        ghosts.append(points[:, marker] - 2 * ((points[:, marker] - mirror) @ normal)[:, None] * normal)
    if ghosts:
        points = np.concatenate([points, np.stack(ghosts, axis=1)], axis=1)
        labels = (*labels, *(f"{GHOST}{k + 1}" for k in range(len(ghosts))))
        truth["ghosts"] = list(labels[-len(ghosts) :])
    if faults.filter_hz:
        points = _filter_visible(points, faults.filter_hz, rate)
    if faults.repeated_share:
        source = np.maximum.accumulate(np.where(rng.uniform(size=frames) < faults.repeated_share, 0, np.arange(frames)))
        points = points[source]
    points *= 1 + faults.camera_scale
    if faults.tilt_deg:
        # rotation about the plane's normal
        (x, y, z), angle = scene.plane.axes[2], np.radians(faults.tilt_deg)
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        points = points @ (np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew).T
    return labels, points, truth


def _draw_moving_marker(rng: np.random.Generator, markers: MarkerSet) -> int:
    """Return the index of a random marker that is not on the base."""
    return int(rng.choice(np.flatnonzero(markers.link > 0)))


def _draw_frames(rng: np.random.Generator, frames: int, count: float) -> tuple[int, int]:
    """Return the first frame, and the frame after the last, of up to ``count`` frames away from the trial's ends."""
    count = min(round(count), frames // 2)
    first = int(rng.integers(frames // 8, max(frames - frames // 8 - count, frames // 8 + 1)))
    return first, first + count


def _filter_visible(points: FloatArray, cut_off: float, rate: float) -> FloatArray:
    """Return the positions after a zero-phase low-pass filter; gaps are interpolated for the filter and stay NaN."""
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415  loads scipy.stats

    visible, time = np.isfinite(points), np.arange(len(points))
    out = points.copy()
    for marker in range(points.shape[1]):
        for axis in range(3):
            known = visible[:, marker, axis]
            if known.sum() > 30:
                filled = np.interp(time, time[known], points[known, marker, axis])
                out[known, marker, axis] = sosfiltfilt(butter(2, cut_off, fs=rate, output="sos"), filled)[known]
    return out
