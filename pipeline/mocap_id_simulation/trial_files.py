"""Simulated trials on disk: recording, exact truth, and a configuration that is ready to run."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from mocap_id.arrays import GRAVITY, FloatArray
from mocap_id.errors import ConfigError, StoreError
from mocap_id.recording.imu_log import format_imu_csv
from mocap_id.recording.lab_plates import PlateSignals
from mocap_id.recording.writer import write_c3d
from mocap_id.store.atomic import converting_errors, write_files
from mocap_id_simulation.forces import BodiesState, DividedBody
from mocap_id_simulation.instruments import (
    FORCE_NOISE,
    MOMENT_NOISE,
    SIZE,
    SimulatedPlate,
    joint_sensor_csv,
    measure_board,
    measure_encoder,
    simulate_plane_sensors,
)
from mocap_id_simulation.options import Kind, Options
from mocap_id_simulation.scene import Scene, SimulatedTrial, generate, random_streams
from mocap_id_simulation.sit_to_stand import JointMotion


def simulate(kind: Kind, folder: Path, options: Options, given: JointMotion | None = None) -> Path:
    """Simulate a trial, write it with its exact truth, and return the path of ``trial.yaml``.

    The folder is created if necessary. It receives ``trial.c3d``, ``truth.json``, ``truth.npz``, ``trial.yaml`` and the
    logs of further sensors, such as ``encoder.csv`` of a robot. The trial is named after it. A ``given`` motion
    replaces the usual one of this kind; the trial then has no chair.

    Raises
    ------
    ConfigError
        The kind is unknown.
    StoreError
        The folder already contains a trial, or cannot be written.
    """
    if kind not in get_args(Kind):
        raise ConfigError(f"simulate: `kind` is {kind!r}; expected one of {', '.join(get_args(Kind))}")

    def make(name: str) -> dict[str, bytes]:
        trial = generate(kind, options, given)
        truth, text = plane_document(kind, options, trial), _yaml(kind, name, options, trial.scene)
        logs: dict[str, bytes] = {}
        if kind == "robot":
            log, truth["encoder"] = measure_encoder(random_streams(options.seed)["encoder"], trial.scene)
            logs["encoder.csv"] = log.encode()
            if options.joint_sensor:
                logs["sensor.csv"] = joint_sensor_csv(random_streams(options.seed)["board"], trial.scene).encode()
        if options.board and kind == "sit-to-stand":
            rng = random_streams(options.seed)["board"]
            log, truth["board"] = measure_board(rng, trial.scene, options.clock_offset)
            logs["board.csv"] = log.encode()
        if options.imus and kind == "sit-to-stand":
            person = None if options.subject is None else options.subject.seed
            sensors = simulate_plane_sensors(options.seed, trial.scene, trial.state, options.soft_tissue, person)
            truth["imu"] = {segment: each for segment, (_, each) in sensors.items()}
            logs |= {f"imu_{segment}.csv": format_imu_csv(each) for segment, (each, _) in sensors.items()}
            text += f"imus: {flow_mapping({segment: f'imu_{segment}.csv' for segment in sensors})}\n"
        return trial_contents(c3d_bytes(options, trial), truth, plane_arrays(trial), text) | logs

    return write_trial(folder, make)


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


def trial_contents(
    recording: bytes, truth: Mapping[str, Any], values: Mapping[str, np.ndarray[Any, Any]], text: str
) -> dict[str, bytes]:
    """Return the contents of a trial's files, by name: the recording, the truth, and the ``text`` of ``trial.yaml``."""
    return {
        "trial.c3d": recording,
        "truth.npz": npz_bytes(values),
        "trial.yaml": text.encode(),
        "truth.json": json_bytes(truth),
    }


def create_folder(folder: Path) -> None:
    """Create a folder; raise StoreError if it exists and is not empty."""
    with converting_errors(folder):
        if folder.exists() and any(folder.iterdir()):
            raise StoreError(f"{folder} is not empty: choose a new folder")
        folder.mkdir(parents=True, exist_ok=True)


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


def derive_seeds(*key: int) -> tuple[int, ...]:
    """Return three seeds that follow from the numbers ``key``, such as the study's seed and the person's number."""
    return tuple(int(each) for each in np.random.SeedSequence(key).generate_state(3))


# --- the configuration


def yaml_head(what: str, command: str, seed: int, name: str) -> str:
    """Return the first lines of ``trial.yaml``, with the trial's name."""
    quoted = json.dumps(name, ensure_ascii=False)  # the folder's name may be 12 or yes
    return f"""\
# {what}
# Made by `{command}` with seed {seed}. The exact truth is in truth.json and truth.npz.
# Paths are relative to this file.
trial: {quoted}
"""


def flow_mapping(values: Mapping[str, object]) -> str:
    """Return a YAML mapping on one line; every value is written as it is."""
    return "{" + ", ".join(f"{name}: {value}" for name, value in values.items()) + "}"


def study_yaml(head: str, entries: Mapping[str, Mapping[str, object]], trials: Iterable[Mapping[str, object]]) -> str:
    """Return the text of a study: its ``head``, which ends with a key, the entries of that key, and the trials."""
    text = head + "".join(f"  {name}: {flow_mapping(keys)}\n" for name, keys in entries.items())
    return text + "trials:\n" + "".join(f"  - {flow_mapping(keys)}\n" for keys in trials)


def _yaml(kind: Kind, name: str, options: Options, scene: Scene) -> str:
    """Return the text of ``trial.yaml``."""
    recording = "trial.c3d  # markers and force plate"
    if options.board:
        recording = "{markers: trial.c3d, forces: {balance_board: board.csv}}"
    mass = scene.body.mass - options.people.held_mass_kg
    if kind == "robot":
        what = f"A robot's joint, {options.repetitions} swings."
        rest = """\
protocol: robot-joint
encoder: encoder.csv  # the robot's own record of its joint, on its own clock
"""
        if options.joint_sensor:
            position = scene.plane.from_plane(np.array([*scene.body.links[1].centre, scene.offset]))
            at = ", ".join(f"{value:.6f}" for value in position)
            rest += f"""\
external:  # a wrench sensor in the joint, which carries the moving part
  - {{file: sensor.csv, name: joint, segment: 1, at: [{at}], measures: beyond}}
"""
    elif scene.chair is None:
        what = "A person, a given movement."
        rest = f"""\
protocol: free  # a given movement that touches only the ground
subject:
  mass: {scene.body.mass:.2f}  # kg
"""
    else:
        what = f"A person, {options.repetitions} sit-to-stands, {options.strategy} strategy."
        chair = "samples with chair contact are excluded from the identification"
        if scene.seat_plate is not None:
            chair = "the chair stands on plate 2, whose force is included as measured"
        rest = f"""\
protocol: sit-to-stand  # {chair}
subject:  # for the reference model only
  height: {scene.body.description["subject"]["height_m"]:.3f}  # m
  mass: {mass:.2f}  # kg
"""
    return yaml_head(what, "mocap-id simulate", options.seed, name) + f"recording: {recording}\n" + rest


# --- the truth

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


def plane_arrays(trial: SimulatedTrial) -> dict[str, np.ndarray[Any, Any]]:
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


def plane_document(kind: Kind, options: Options, trial: SimulatedTrial) -> dict[str, Any]:
    """Return JSON values for ``truth.json``."""
    scene, body, markers, cop = trial.scene, trial.scene.body, trial.scene.markers, trial.state.cop_x
    base_names, base_values = body.base_parameters()
    low, high = body.support
    x, y, z = scene.plane.axes.tolist()
    faults, bodies = options.faults.present, trial.state.bodies
    seat = scene.seat_plate
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
        "joints": [link.joint for link in body.links[1:]],
        "segments": [
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
        ],
        "base_parameters": {"names": base_names, "values": base_values},
        "total_mass": body.mass,
        "markers": [
            {
                "label": label,
                "name": label,
                "segment": int(markers.link[i]),
                "local_xyz_m": markers.local[i].tolist(),
                "sta_amplitude_m": float(markers.softness[i]),
                "at_joint": markers.at_joint[i],
            }
            for i, label in enumerate(markers.labels)
        ],
        "assignment": dict(zip(markers.labels, markers.link.tolist(), strict=True)),
        "marker_noise_sd_mm": 1e3 * options.marker_noise,
        "jumps": [
            {**asdict(episode), "by_mm": [round(1e3 * float(component), 3) for component in shift]}
            for episode, shift in trial.jumps
        ],
        "dropouts": [asdict(burst) for burst in trial.bursts],
        "dropped_fraction": float(1 - trial.visible.mean()),
        "plane": {
            "yaw_deg": float(np.degrees(scene.plane.yaw)),
            "x_axis_lab": x,
            "y_axis_lab": y,
            "z_axis_lab": z,
            "origin_lab_mm": (1e3 * scene.plane.origin).tolist(),
            "plane_offset_m": scene.offset,
        },
        "plate": _plate(scene.plate),
        **({} if seat is None else {"seat_plate": {**_plate(seat), "chair_weight_N": scene.chair_weight}}),
        "segment_lengths_m": {link.name: link.length for link in body.links[1:]} | dict(body.scored_lengths),
        "lengths_scored": list(body.scored_lengths),
        "lengths_note": "scored lengths are from joint to joint; the distal end of a last segment is not a joint",
        **body.description,
        **scene.protocol,
        "cop_outside_foot_max_m": max(float(np.maximum(cop - high, low - cop).max()), 0.0),
        **({} if scene.divided is None or bodies is None else _people(scene.divided[0], bodies, options, scene)),
        **({"faults": {**faults, **trial.fault_truth}} if faults else {}),
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


def _people(body: DividedBody, state: BodiesState, options: Options, scene: Scene) -> dict[str, Any]:
    """Return the entry about the separate bodies of a person."""
    angle = {name: state.pose[:, i, 2] for i, name in enumerate(body.names)}
    local, parts = body.local(scene.markers), body.part_of(scene.markers)
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
        "markers": {
            label: {"body": body.names[part] if part >= 0 else "plate", "local_in_body_m": local[i].tolist()}
            for i, (label, part) in enumerate(zip(scene.markers.labels, parts, strict=True))
        },
        "ranges": {
            "hip_gap_mm": float(1e3 * np.ptp(state.gap, axis=0).max()),
            "lumbar_deg": float(np.degrees(np.ptp(angle["trunk"] - angle["pelvis"]))),
            "arm_swing_deg": float(np.degrees(np.ptp(angle["arms"] - angle["trunk"]))),
            "foot_deg": float(np.degrees(np.ptp(angle["foot"]))),
        },
    }
    return {"people": people}
