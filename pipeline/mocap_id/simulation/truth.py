"""Truth of a simulated trial: a JSON document, and arrays at the frames' times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.simulation.body import GRAVITY, SimulatedBody
from mocap_id.simulation.cameras import Burst, Jump
from mocap_id.simulation.forces import BodiesState
from mocap_id.simulation.markers import MarkerSet
from mocap_id.simulation.multibody import DividedBody
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.plate import FORCE_NOISE, MOMENT_NOISE, SIZE, SimulatedPlate
from mocap_id.simulation.scene import Scene
from mocap_id.simulation.simulated_trial import SimulatedTrial

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
