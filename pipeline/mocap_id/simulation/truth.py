"""Truth of a simulated trial: a JSON document, and arrays at the frames' times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.simulation.body import GRAVITY, SimulatedBody
from mocap_id.simulation.cameras import Jump
from mocap_id.simulation.markers import MarkerSet
from mocap_id.simulation.multibody_truth import bodies_arrays, bodies_document
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.plate import FORCE_NOISE, MOMENT_NOISE, SIZE, SimulatedPlate
from mocap_id.simulation.scene import Scene
from mocap_id.simulation.simulated_trial import SimulatedTrial

CONVENTIONS = """\
SI units unless a name ends in _mm, _deg or _hz. The laboratory's z is up.
Plane frame: origin at the centre of the plate's working surface, x_axis_lab horizontal along the motion, y up,
z = x × y; the body's mid-plane lies at z = plane_offset_m. A person faces -x.
Angles: right-handed about z; q_j is the angle of segment j from segment j - 1, all zero when every segment's y points
straight up. Segment 0 is the base, fixed to the plate, and its frame is the plane frame; the others have their origin
at the joint that moves them and y towards the next one.
Inertia: m, mx, my, Izz about the segment frame's origin; Ic about the centre of mass (cx, cy).
wrench: (Fx, Fy, tauz) of the ground on the body in the plane frame about its origin; wrench_total adds the chair's.
chair_force: of the chair on the thigh, acting at chair_point; the plate does not carry it. Where there is a
seat_plate, that one does, and the chair's own weight with it.
tau_j: torque of segment j - 1 on segment j. cop_x = tauz / Fy of the ground's wrench.
Markers: local_xyz_m in the segment's frame, z from the body's mid-plane; markers_true_mm in the laboratory, without
measurement noise and jumps, soft tissue included; valid is False where an occlusion hides one.
Analog sample k is taken at the markers' time k / analog_rate_hz + analog_offset_s; frame i at i / point_rate_hz.
Plate: axes_lab_columns are the plate's axes in the laboratory, z down; channels of sense "reaction" hold the plate's
force on the body, "action" the opposite; origin_mm goes from the transducer to the centre of the working surface and
stands negated in the file where origin_flipped_in_file says so."""


_MOVING = ("q", "qd", "qdd", "qddd", "seg_angle", "joint_xy", "com")
_FORCES = ("tau", "wrench", "wrench_total", "chair_force", "chair_point", "cop_x")


def arrays(trial: SimulatedTrial) -> dict[str, np.ndarray[Any, Any]]:
    """Return arrays for ``truth.npz``, in float32 except for the time and the separate bodies."""
    positions = (1e3 * trial.positions).astype(np.float32)
    single = {name: getattr(trial.state, name).astype(np.float32) for name in _MOVING + _FORCES}
    more = {} if trial.state.bodies is None else bodies_arrays(trial.state.bodies)
    return {"t": trial.state.time, "valid": trial.visible, "markers_true_mm": positions, **single, **more}


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
        "jumps": [_jump(jump) for jump in trial.jumps],
        "dropouts": [{"label": b.label, "first_frame": b.first, "n_frames": b.count} for b in trial.bursts],
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
    scene, bodies = trial.scene, trial.state.bodies
    if scene.loose is None or bodies is None:
        return {}
    return bodies_document(options.people, scene.loose.body, scene.markers, bodies)


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


def _jump(jump: Jump) -> dict[str, Any]:
    return {
        "label": jump.label,
        "first_frame": jump.first,
        "n_frames": jump.count,
        "by_mm": [round(1e3 * float(component), 3) for component in jump.by],
    }


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
    every = {link.name: link.length for link in body.links[1:]}
    return {
        "segment_lengths_m": {**every, **body.scored_lengths},
        "lengths_scored": list(body.scored_lengths),
        "lengths_note": "scored lengths run from joint to joint; a last segment's far end is not a joint",
    }
