"""Truth of a person of several bodies: the entry ``people`` of truth.json, and additional arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.simulation.forces import BodiesState
from mocap_id.simulation.markers import MarkerSet
from mocap_id.simulation.multibody import LooseBody
from mocap_id.simulation.options import PersonOptions

CONVENTIONS = """\
This person is the bodies listed here, not the pinned chain of `segments`. Those are the same bodies standing on the
chain's pins: the torso is pelvis, trunk, arms and weight together, and base_parameters and total_mass hold the weight.
The foot's frame is the plane frame as long as the foot is flat; it turns about (toe_x_m, 0). Every other frame has its
origin at the joint to the body before it and, on the pins, the axes of the segment it is part of; the weight's is at
the hands, in the arms. origin_in_previous_m is that origin on the pins.
q, qd, qdd, qddd, seg_angle: of shank, thigh and trunk, as of a chain on a base that stands still. joint_xy: ankle, knee
and hip centre, in foot, shank and thigh. com and wrenches: of all bodies.
truth.npz adds, in the plane frame at the frames' times, T of them, B bodies in the order listed:
body_pose (T, B, 3): x and y of the origin of the body's frame, and its angle; body_velocity and body_acceleration are
its derivatives. hip_gap_m (T, 2): displacement of the pelvis's hip centre from the thigh's, along the thigh's x and y.
body_tau (T, 5): torques at tau_joints, each the moment about the joint's centre in the nearer body of the wrench that
the nearer body puts on all beyond; tau is the first three.
What a chair or a rail puts on the bodies beyond a joint is no part of the torque.
body and local_in_body_m tell where each marker sits; assignment and markers still name segments of the chain."""


def bodies_arrays(state: BodiesState) -> dict[str, np.ndarray[Any, Any]]:
    """Return additional arrays for ``truth.npz``, in float64 because differences of poses need full precision."""
    return {
        "body_pose": state.pose,
        "body_velocity": state.velocity,
        "body_acceleration": state.acceleration,
        "hip_gap_m": state.gap,
        "body_tau": state.tau,
    }


def bodies_document(people: PersonOptions, body: LooseBody, markers: MarkerSet, state: BodiesState) -> dict[str, Any]:
    """Return JSON values for ``truth.json``."""
    return {
        "people": {
            "conventions": CONVENTIONS,
            "options": asdict(people),
            "toe_x_m": body.toe,
            "bodies": _parts(body),
            "tau_joints": [part.joint for part in body.parts[1:6]],
            "markers": _markers(body, markers),
            "ranges": _ranges(body, state),
        }
    }


def _parts(body: LooseBody) -> list[dict[str, Any]]:
    return [
        {
            "index": i,
            "name": part.name,
            "joint": part.joint,
            "origin_in_previous_m": list(part.centre),
            **part.inertial_parameters,
        }
        for i, part in enumerate(body.parts)
    ]


def _markers(body: LooseBody, markers: MarkerSet) -> Mapping[str, Any]:
    """Return for each label the name of the body (or plate) and the position in its frame."""
    local, parts = body.local(markers), body.part_of(markers)
    return {
        label: {"body": body.names[part] if part >= 0 else "plate", "local_in_body_m": local[i].tolist()}
        for i, (label, part) in enumerate(zip(markers.labels, parts, strict=True))
    }


def _ranges(body: LooseBody, state: BodiesState) -> dict[str, float]:
    """Return the ranges that occur in this trial."""
    angle = {name: state.pose[:, i, 2] for i, name in enumerate(body.names)}
    return {
        "hip_gap_mm": float(1e3 * np.ptp(state.gap, axis=0).max()),
        "lumbar_deg": float(np.degrees(np.ptp(angle["trunk"] - angle["pelvis"]))),
        "arm_swing_deg": float(np.degrees(np.ptp(angle["arms"] - angle["trunk"]))),
        "foot_deg": float(np.degrees(np.ptp(angle["foot"]))),
    }
