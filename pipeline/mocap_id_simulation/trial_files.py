"""Truth of a simulated trial: a JSON document, and arrays at the frames' times."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, StoreError
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.recording.writer import write_c3d
from mocap_id.store.atomic import converting_errors, write_files
from mocap_id_simulation.bodies import GRAVITY, REFERENCE, TOTAL, JointName, MarkerSet, SimulatedBody, Subject
from mocap_id_simulation.cameras import Burst, Jump
from mocap_id_simulation.forces import BodiesState, DividedBody
from mocap_id_simulation.instruments import (
    FORCE_NOISE,
    MOMENT_NOISE,
    SIZE,
    SimulatedPlate,
    board_csv,
    csv_bytes,
    draw_board,
    draw_encoder,
    encoder_csv,
    joint_position,
    joint_sensor_csv,
    simulate_plane_sensors,
)
from mocap_id_simulation.motion import JointMotion
from mocap_id_simulation.options import Kind, Options
from mocap_id_simulation.scene import Scene, SimulatedTrial, generate, random_streams

CONVENTIONS = """\
SI units unless a name ends in _mm, _deg or _hz. The laboratory's z is up.
Plane frame: origin at the centre of the plate's working surface, x_axis_lab horizontal along the motion, y up,
z = x × y; the body's mid-plane is at z = plane_offset_m. A person faces -x.
Angles: right-handed about z; q_j is the angle of segment j relative to segment j - 1. All angles are zero when the y
axis of every segment points up. Segment 0 is the base, fixed to the plate, and its frame is the plane frame; the origin
of every other frame is the joint that moves the segment, and its y points to the next joint.
Inertia: m, mx, my, Izz about the origin of the segment's frame; Ic about the centre of mass (cx, cy).
wrench: (Fx, Fy, tauz) of the ground on the body in the plane frame about its origin; wrench_total includes chair
and rail.
chair_force: force of the chair on the thigh at chair_point; the plate does not carry it. A seat_plate, if present,
carries it together with the weight of the chair.
tau_j: torque of segment j - 1 on segment j. cop_x = tauz / Fy of the ground's wrench.
Markers: local_xyz_m is in the segment's frame, z from the body's mid-plane; markers_true_mm is in the laboratory, with
soft tissue, without measurement noise and jumps; valid is False where an occlusion hides a marker.
Analog sample k is taken at the markers' time k / analog_rate_hz + analog_offset_s; frame i at i / point_rate_hz.
Plate: axes_lab_columns are the plate's axes in the laboratory, z down. Channels of sense "reaction" contain the force
of the plate on the body, channels of sense "action" the opposite. origin_mm points from the transducer to the centre of
the working surface; if origin_flipped_in_file is true, the file contains it with the opposite sign."""
PEOPLE_CONVENTIONS = """\
This person consists of the bodies listed here, not of the pinned chain in `segments`. `segments` describes the same
bodies with all joints at their positions in the chain: the torso is pelvis, trunk, arms and weight together, and
base_parameters and total_mass include the weight.
The foot's frame equals the plane frame while the foot is flat; the foot rotates about (toe_x_m, 0). The origin of every
other frame is the joint to the previous body; without joint displacements, its axes are those of the segment of the
chain. The frame of the weight is at the hands, in the arms. origin_in_previous_m is this origin in the previous body.
q, qd, qdd, qddd, seg_angle: of shank, thigh and trunk, as for a chain on a base at rest. joint_xy: ankle, knee and hip
centre, in foot, shank and thigh. com and wrenches: of all bodies.
truth.npz adds arrays in the plane frame at the T frames, for the B bodies in the listed order:
body_pose (T, B, 3): x and y of the origin of the body's frame, and its angle; body_velocity and body_acceleration are
its derivatives. hip_gap_m (T, 2): displacement of the pelvis's hip centre from the thigh's, along the thigh's x and y.
body_tau (T, 5): torques at tau_joints: the moment about the joint centre in the proximal body of the wrench that the
proximal body exerts on all distal bodies; tau is the first three. Forces of a chair or rail on the distal bodies are
not included in the torque.
body and local_in_body_m give the position of each marker; assignment and markers name segments of the chain."""
_MOVING = ("q", "qd", "qdd", "qddd", "seg_angle", "joint_xy", "com")
_FORCES = ("tau", "wrench", "wrench_total", "chair_force", "chair_point", "cop_x")


def arrays(trial: SimulatedTrial) -> dict[str, np.ndarray[Any, Any]]:
    """Return arrays for ``truth.npz`` by name: float32, but float64 for the time and the separate bodies.

    The bodies need full precision, because the differences of their poses are small.
    """
    bodies = trial.state.bodies
    positions = (1e3 * trial.positions).astype(np.float32)
    single = {name: getattr(trial.state, name).astype(np.float32) for name in _MOVING + _FORCES}
    values = {"t": trial.state.time, "valid": trial.visible, "markers_true_mm": positions, **single}
    if bodies is None:
        return values
    names = ("body_pose", "body_velocity", "body_acceleration", "hip_gap_m", "body_tau")
    return values | dict(zip(names, vars(bodies).values(), strict=True))


def document(kind: Kind, options: Options, trial: SimulatedTrial) -> dict[str, Any]:
    """Return JSON values for ``truth.json``."""
    scene, cop = trial.scene, trial.state.cop_x
    base_names, base_values = scene.body.base_parameters()
    low, high = scene.body.support
    outside = float(np.maximum(cop - high, low - cop).max())
    return {
        "conventions": CONVENTIONS,
        "g": GRAVITY,
        "kind": "sts" if kind == "sit-to-stand" else "robot",
        "seed": options.seed,
        "subject_seed": options.seed if options.subject is None else options.subject.seed,
        "point_rate_hz": options.rate,
        "analog_rate_hz": options.analog_rate,
        "n_frames": len(trial.state.time),
        "analog_offset_s": options.clock_offset,
        "joints": [link.joint for link in scene.body.links[1:]],
        "segments": _segments(scene.body),
        "base_parameters": {"names": base_names, "values": base_values},
        "total_mass": scene.body.mass,
        "markers": _markers(scene.markers),
        "assignment": dict(zip(scene.markers.labels, scene.markers.link.tolist(), strict=True)),
        "marker_noise_sd_mm": 1e3 * options.marker_noise,
        "jumps": [
            {**_frames(jump), "by_mm": [round(1e3 * float(component), 3) for component in jump.by]}
            for jump in trial.jumps
        ],
        "dropouts": [_frames(burst) for burst in trial.bursts],
        "dropped_fraction": float(1 - trial.visible.mean()),
        "plane": _plane(scene),
        "plate": _plate(scene.plate),
        **_seat_plate(scene),
        **_lengths(scene.body),
        **scene.body.description,
        **scene.protocol,
        "cop_outside_foot_max_m": max(outside, 0.0),
        **_people(options, trial),
        **_faults(options, trial),
    }


def _faults(options: Options, trial: SimulatedTrial) -> Mapping[str, Any]:
    present = options.faults.present
    return {"faults": {**present, **trial.fault_truth}} if present else {}


def _people(options: Options, trial: SimulatedTrial) -> Mapping[str, Any]:
    """Return the entry about the separate bodies of a person, if any."""
    scene, bodies = trial.scene, trial.state.bodies
    if scene.divided is None or bodies is None:
        return {}
    body = scene.divided.body
    people = {
        "conventions": PEOPLE_CONVENTIONS,
        "options": asdict(options.people),
        "toe_x_m": body.toe,
        "bodies": [
            {
                "index": i,
                "name": part.name,
                "joint": part.joint,
                "origin_in_previous_m": list(part.centre),
                **part.inertial_parameters,
            }
            for i, part in enumerate(body.parts)
        ],
        "tau_joints": [part.joint for part in body.parts[1:6]],
        "markers": _body_markers(body, scene.markers),
        "ranges": _ranges(body, bodies),
    }
    return {"people": people}


def _body_markers(body: DividedBody, markers: MarkerSet) -> Mapping[str, Any]:
    """Return for each label the body (or plate) that carries the marker, and the position in its frame, m."""
    local, parts = body.local(markers), body.part_of(markers)
    return {
        label: {"body": body.names[part] if part >= 0 else "plate", "local_in_body_m": local[i].tolist()}
        for i, (label, part) in enumerate(zip(markers.labels, parts, strict=True))
    }


def _ranges(body: DividedBody, state: BodiesState) -> dict[str, float]:
    """Return the ranges of the person's additional motion in this trial."""
    angle = {name: state.pose[:, i, 2] for i, name in enumerate(body.names)}
    return {
        "hip_gap_mm": float(1e3 * np.ptp(state.gap, axis=0).max()),
        "lumbar_deg": float(np.degrees(np.ptp(angle["trunk"] - angle["pelvis"]))),
        "arm_swing_deg": float(np.degrees(np.ptp(angle["arms"] - angle["trunk"]))),
        "foot_deg": float(np.degrees(np.ptp(angle["foot"]))),
    }


def _segments(body: SimulatedBody) -> list[dict[str, Any]]:
    return [
        {
            "index": i,
            "thesis_index": i + 1,
            "name": link.name,
            "joint": link.joint,
            "p_in_parent_m": list(link.centre),
            "length_m": link.length,
            **link.inertial_parameters,
        }
        for i, link in enumerate(body.links)
    ]


def _markers(markers: MarkerSet) -> list[dict[str, Any]]:
    return [
        {
            "label": label,
            "name": label,
            "segment": int(markers.link[i]),
            "local_xyz_m": markers.local[i].tolist(),
            "sta_amplitude_m": float(markers.softness[i]),
            "at_joint": markers.at_joint[i],
        }
        for i, label in enumerate(markers.labels)
    ]


def _frames(event: Burst | Jump) -> dict[str, Any]:
    return {"label": event.label, "first_frame": event.first, "n_frames": event.count}


def _plane(scene: Scene) -> dict[str, Any]:
    x, y, z = scene.plane.axes.tolist()
    return {
        "yaw_deg": float(np.degrees(scene.plane.yaw)),
        "x_axis_lab": x,
        "y_axis_lab": y,
        "z_axis_lab": z,
        "origin_lab_mm": (1e3 * scene.plane.origin).tolist(),
        "plane_offset_m": scene.offset,
    }


def _plate(plate: SimulatedPlate) -> dict[str, Any]:
    return {
        "type": 2,
        "sense": plate.sense,
        "centre_lab_mm": (1e3 * plate.centre).tolist(),
        "yaw_deg": float(np.degrees(plate.yaw)),
        "axes_lab_columns": plate.axes.tolist(),
        "corners_lab_mm": (1e3 * plate.corners).tolist(),
        "origin_mm": (1e3 * plate.origin).tolist(),
        "origin_flipped_in_file": plate.flipped,
        "size_mm": [1e3 * side for side in SIZE],
        "noise_f": plate.noise * FORCE_NOISE,
        "noise_m": plate.noise * MOMENT_NOISE,
        "bias_channels_N_Nmm": (plate.bias * np.array([1, 1, 1, 1e3, 1e3, 1e3])).tolist(),
        "cal_matrix": None,
    }


def _seat_plate(scene: Scene) -> dict[str, Any]:
    if scene.seat_plate is None:
        return {}
    return {"seat_plate": {**_plate(scene.seat_plate), "chair_weight_N": scene.chair_weight}}


def _lengths(body: SimulatedBody) -> Mapping[str, Any]:
    lengths = {link.name: link.length for link in body.links[1:]}
    return {
        "segment_lengths_m": {**lengths, **body.scored_lengths},
        "lengths_scored": list(body.scored_lengths),
        "lengths_note": "scored lengths are from joint to joint; the distal end of a last segment is not a joint",
    }


_TRIAL = """\
# {what}
# Made by `mocap-id simulate` with seed {seed}. The exact truth is in truth.json and truth.npz.
# Paths are relative to this file.
trial: {name}
recording: {recording}
"""
_WITH_PLATE = "trial.c3d  # markers and force plate"
_BOARD = "{markers: trial.c3d, forces: {balance_board: board.csv}}"
_SIT_TO_STAND = """\
protocol: sit-to-stand  # {chair}
subject:  # for the reference model only
  height: {height:.3f}  # m
  mass: {mass:.2f}  # kg
"""
_FREE = """\
protocol: free  # a given movement that touches only the ground
subject:
  mass: {mass:.2f}  # kg
"""
_ROBOT = """\
protocol: robot-joint
encoder: encoder.csv  # the robot's own record of its joint, on its own clock
"""
_JOINT_SENSOR = """\
external:  # a wrench sensor in the joint, which carries the moving part
  - {{file: sensor.csv, name: joint, segment: {segment}, at: [{at}], measures: beyond}}
"""

_STUDY = """\
# {subjects} simulated persons, {trials} trials of {repetitions} sit-to-stands each.
# Made by `mocap-id simulate cohort` with seed {seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-cohort
out: runs
defaults: {{protocol: sit-to-stand}}  # {chair}
subjects:  # m, kg; the lengths between landmarks are the true ones
"""
_SIZE = "height: {height:.3f}, mass: {mass:.2f}, sex: {sex}"
_LANDMARKS = "landmarks_m: {{shank: {shank:.4f}, thigh: {thigh:.4f}}}"
_PERSON = f"  {{name}}: {{{{{_SIZE}, {_LANDMARKS}}}}}\n"
_STUDY_TRIAL = "  - {{trial: {}, subject: {}, strategy: {}, recording: {}}}\n"

_ROBOT_STUDY = """\
# {count} simulated trials of the thesis's robot, {periods} swings of one joint each (`mocap-id validate robot`).
# Made by `mocap-id simulate robot-set` with seed {seed}. The exact truth stands beside each trial.
# Paths are relative to this file.
study: simulated-ur5
reference:  # table 5.2's: m, kg, kg·m, kg·m²; `base` is the joint's distance from the plate's centre
"""
_REFERENCE = "  {name}: {{base: {l1}, mass: {mass}, mx1: 0.0, mx2: 0.0, my2: {my}, Izz2: {inertia}}}\n"
_ROBOT_TRIAL = "  - {{file: {}/trial.yaml, joint: {}, speed: {}, orientation: {:g}}}\n"


def trial_yaml(kind: Kind, name: str, options: Options, scene: Scene) -> str:
    """Return the text of ``trial.yaml``."""
    quoted = json.dumps(name, ensure_ascii=False)  # the folder's name may be 12 or yes
    if kind == "robot":
        what, rest = f"A robot's joint, {options.repetitions} swings.", _ROBOT
        if options.joint_sensor:
            at = ", ".join(f"{value:.6f}" for value in joint_position(scene))
            rest += _JOINT_SENSOR.format(segment=1, at=at)
    elif scene.chair is None:
        what, rest = "A person, a given movement.", _FREE.format(mass=scene.body.mass)
    else:
        what = f"A person, {options.repetitions} sit-to-stands, {options.strategy} strategy."
        chair = "samples with chair contact are excluded from the identification"
        if scene.seat_plate is not None:
            chair = "the chair stands on plate 2, whose force is included as measured"
        height = scene.body.description["subject"]["height_m"]
        mass = scene.body.mass - options.people.held_mass_kg
        rest = _SIT_TO_STAND.format(height=height, mass=mass, chair=chair)
    recording = _BOARD if options.board else _WITH_PLATE
    return _TRIAL.format(what=what, seed=options.seed, name=quoted, recording=recording) + rest


def study_yaml(
    options: Options, bodies: Mapping[Subject, SimulatedBody], trials: Sequence[tuple[str, str, str, str]]
) -> str:
    """Return the text of a cohort's ``study.yaml``.

    Each of ``trials`` is (name, subject, strategy, recording); ``bodies`` contains the body of each person.
    """
    chair = (
        "the force of the chair's own plate is included as measured"
        if options.seat_plate
        else "the chair stands on no plate"
    )
    counts = {"subjects": len(bodies), "trials": len(trials), "repetitions": options.repetitions}
    text = _STUDY.format(**counts, seed=options.seed, chair=chair)
    for subject, body in bodies.items():
        size = {"name": subject.name, "height": subject.height, "mass": subject.mass, "sex": subject.sex}
        text += _PERSON.format(**size, **body.scored_lengths)
    return text + "trials:\n" + "".join(_STUDY_TRIAL.format(*trial) for trial in trials)


def robot_study_yaml(
    seed: int, periods: int, joints: Sequence[JointName], trials: Sequence[tuple[str, Options]]
) -> str:
    """Return the text of ``robot-study.yaml`` for ``trials`` (name and options) with ``periods`` swings each."""
    text = _ROBOT_STUDY.format(count=len(trials), periods=periods, seed=seed)
    for joint in joints:
        known = REFERENCE[joint]
        text += _REFERENCE.format(name=joint, l1=known.distance, mass=TOTAL, my=known.my, inertia=known.inertia)
    text += "trials:\n"
    return text + "".join(_ROBOT_TRIAL.format(name, one.joint, one.speed, one.orientation) for name, one in trials)


def simulate(kind: Kind, folder: Path, options: Options, given: JointMotion | None = None) -> Path:
    """Simulate a trial, write it with its exact truth, and return the path of ``trial.yaml``.

    Parameters
    ----------
    kind : {"sit-to-stand", "robot"}
    folder : Path
        Created if necessary; receives ``trial.c3d``, ``truth.json``, ``truth.npz``, ``trial.yaml`` and the logs of
        further sensors, such as ``encoder.csv`` of a robot. The trial is named after the folder.
    options : Options
    given : JointMotion, optional
        Motion of the body, instead of the usual one of this kind; the trial then has no chair.

    Raises
    ------
    ConfigError
        The kind is unknown.
    StoreError
        The folder already contains a trial, or cannot be written.
    """
    if kind not in get_args(Kind):
        raise ConfigError(f"simulate: `kind` is {kind!r}; expected one of {', '.join(get_args(Kind))}")
    return write_trial(folder, lambda name: _contents(kind, name, options, generate(kind, options, given)))


def write_trial(folder: Path, make: Callable[[str], Mapping[str, bytes]]) -> Path:
    """Write a new trial and return the path of ``trial.yaml``; ``make`` returns the files, given the trial's name.

    StoreError is raised if the folder already contains a trial, or cannot be written.
    """
    if (folder / "trial.c3d").exists() or (folder / "trial.yaml").exists():
        raise StoreError(f"{folder} already contains a trial: remove the trial or choose a different folder")
    contents = make(folder.resolve().name)
    existing = [folder / name for name in contents if (folder / name).exists()]
    if existing:
        raise StoreError(f"{existing[0]} exists already: remove the file or choose a different folder")
    write_files(folder, contents)
    return folder / "trial.yaml"


def create_folder(folder: Path) -> None:
    """Create a folder; raise StoreError if it exists and is not empty."""
    with converting_errors(folder):
        if folder.exists() and any(folder.iterdir()):
            raise StoreError(f"{folder} is not empty: choose a new folder")
        folder.mkdir(parents=True, exist_ok=True)


def write_study_trial(  # noqa: PLR0917
    folder: Path,
    name: str,
    file: str,
    recording: bytes,
    truth: Mapping[str, Any],
    values: Mapping[str, np.ndarray[Any, Any]],
) -> None:
    """Write a trial of a study: its recording as ``file``, and its truth in the folder ``truth/<name>``."""
    contents = {
        file: recording,
        f"truth/{name}/truth.json": json_bytes(truth),
        f"truth/{name}/truth.npz": npz_bytes(values),
    }
    write_files(folder, contents)


def _contents(kind: Kind, name: str, options: Options, trial: SimulatedTrial) -> dict[str, bytes]:
    """Return the contents of the files of a trial, by file name."""
    truth = document(kind, options, trial)
    contents = {
        "trial.c3d": c3d_bytes(options, trial),
        "truth.npz": npz_bytes(arrays(trial)),
        "trial.yaml": trial_yaml(kind, name, options, trial.scene).encode(),
    }
    if kind == "robot":
        rng = random_streams(options.seed)["encoder"]
        encoder = draw_encoder(rng)
        truth["encoder"] = encoder.as_dict()
        contents["encoder.csv"] = encoder_csv(rng, trial.scene, encoder).encode()
        if options.joint_sensor:
            contents["sensor.csv"] = joint_sensor_csv(random_streams(options.seed)["board"], trial.scene).encode()
    if options.board and kind == "sit-to-stand":
        rng = random_streams(options.seed)["board"]
        board = draw_board(rng, options.clock_offset)
        truth["board"] = board.as_dict()
        contents["board.csv"] = board_csv(rng, trial.scene, board).encode()
    if options.imus and kind == "sit-to-stand":
        person = None if options.subject is None else options.subject.seed
        sensors = simulate_plane_sensors(options.seed, trial.scene, trial.state, options.soft_tissue, person)
        truth["imu"] = {segment: sensor.truth for segment, sensor in sensors.items()}
        contents |= {f"imu_{segment}.csv": csv_bytes(sensor) for segment, sensor in sensors.items()}
        files = ", ".join(f"{segment}: imu_{segment}.csv" for segment in sensors)
        contents["trial.yaml"] += f"imus: {{{files}}}\n".encode()
    return contents | {"truth.json": json_bytes(truth)}


def c3d_bytes(options: Options, trial: SimulatedTrial) -> bytes:
    """Return the content of the C3D file of a trial."""
    factor = 1 + options.faults.rate_error
    plates = [
        replace(plate, rate=plate.rate * factor)
        for plate in (trial.signals, trial.seat_signals)
        if plate is not None and not options.board
    ]
    return points_bytes(trial.labels, trial.points, options.rate * factor, plates)


def points_bytes(labels: Sequence[str], points: FloatArray, rate: float, plates: Sequence[PlateSignals] = ()) -> bytes:
    """Return the content of a C3D file with the points (F, M, 3), m; other parameters as for :func:`write_c3d`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.c3d"
        write_c3d(path, labels, points, rate, plates=plates)
        return path.read_bytes()


def json_bytes(document: Mapping[str, Any]) -> bytes:
    """Return the content of a JSON file."""
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()


def npz_bytes(values: Mapping[str, np.ndarray[Any, Any]]) -> bytes:
    """Return the content of a compressed NumPy archive."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **values)  # type: ignore[arg-type]
    return stream.getvalue()
