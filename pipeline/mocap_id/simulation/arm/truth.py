"""Truth of a simulated trial in space: a JSON document, and arrays at the frames' times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.simulation.arm.arm import person_seed
from mocap_id.simulation.arm.body import ArmBody
from mocap_id.simulation.arm.curl_torque import arm_bodies, body_keys, carried_loads
from mocap_id.simulation.arm.markers import ArmMarkers
from mocap_id.simulation.arm.options import PRESETS, ArmOptions, ChainOptions
from mocap_id.simulation.arm.reach_volume import reach_volume
from mocap_id.simulation.arm.trial import SpatialTrial
from mocap_id.simulation.body import GRAVITY

CONVENTIONS = """\
SI units unless a name ends in _mm, _deg or _hz. The laboratory's z is up; all vectors are in its axes unless their
names say otherwise. The file of a left arm contains the mirror image (y negated): the truth is that of the right arm.
seg_R[n, s] takes segment axes to the laboratory; seg_origin is the origin of the segment's frame.
Frames of the ISB (Wu 2005), right arm, x forward, y up, z to the right. Thorax: origin IJ, y from mid(PX, T8) to
mid(IJ, C7). Upper arm: origin GH, y from mid(EL, EM) to GH, x normal to GH, EL, EM. Forearm: origin mid(EL, EM),
y from US to it, x normal to US, RS and it. Hand: origin mid(RS, US), parallel to the forearm at zero wrist angles.
thorax from upper arm: R_y(plane) R_x(-elevation) R_y(axial); isb_shoulder contains plane, -elevation, axial. Plane 0 is
abduction, 90° forward flexion; internal rotation is positive. isb_condition = 1 / |sin elevation|.
upper arm from forearm: R_z(flexion) R_x(carrying) R_y(pronation) = R(elbow_axis, q_hinge) R_x(carry0)
R(pronation_axis, q_pron). forearm from hand: R_z(flexion) R_x(deviation).
_rate and _acc are derivatives of the angles; q_hinge and q_pron contain angle, rate and acceleration.
GH in the thorax: gh0_in_thorax_m + sc_translation_m (1 - cos elevation) / 2 along sc_direction. AC moves with it.
Markers: local_xyz_m is the position at the first frame, where soft tissue is zero; in the still start (t < static_s)
the skin only drifts. bone_xyz_m is the position of the landmark. The skin does not follow the share twist_loss of the
axial rotation of the upper arm and of the pronation.
Plain chains: joint_R is child to parent, the product of exp(s_k axis_k) over the columns of joint_axes; the origin of a
child is the centre of its joint.
curls: tau_total = tau_human + tau_device about the hinge of the elbow, positive in flexion, N m; the bodies are
forearm, hand and carried loads. The true device is drawn at random around its description in device.yaml.
reach: volume in the thorax that the end of the forearm's y axis reaches within box_rad, the ranges of plane, elevation,
axial and hinge (plane and axial where sin elevation > sin 15°)."""
Ranges: TypeAlias = Mapping[str, list[float]]
_STEEP = np.sin(np.radians(15.0))


def arrays(trial: SpatialTrial) -> dict[str, np.ndarray[Any, Any]]:
    """Return arrays for ``truth.npz``."""
    common: dict[str, np.ndarray[Any, Any]] = {
        "t": trial.time,
        "seg_R": trial.rotations,
        "seg_origin": trial.origins,
        "omega": trial.omega,
        "alpha": trial.alpha,
        "markers_true_mm": (1e3 * trial.true_positions).astype(np.float32),
    }
    return common | dict(trial.arrays) | (_isb_angles(trial) if trial.angles else {})


def _isb_angles(trial: SpatialTrial) -> dict[str, FloatArray]:
    out: dict[str, FloatArray] = {}
    for suffix, values in (("", trial.angles), ("_rate", trial.rates), ("_acc", trial.accelerations)):
        shoulder = (values["shoulder_plane"], -values["shoulder_elevation"], values["shoulder_axial"])
        out["isb_shoulder" + suffix] = np.stack(shoulder, axis=1)
        elbow = (values["elbow_flexion"], values["elbow_carrying"], values["elbow_pronation"])
        out["isb_elbow" + suffix] = np.stack(elbow, axis=1)
        out["wrist_angles" + suffix] = np.stack([values["wrist_flexion"], values["wrist_deviation"]], axis=1)
    out["isb_condition"] = 1 / np.abs(np.sin(trial.angles["shoulder_elevation"]))
    return out


def arm_document(options: ArmOptions, trial: SpatialTrial) -> dict[str, Any]:
    """Return JSON values for ``truth.json`` of an arm."""
    body: ArmBody = trial.document["body"]
    protocol = dict(trial.document["protocol"])
    if options.movement == "curl":
        bodies = {**arm_bodies(body), **carried_loads(options.condition)}
        protocol["bodies"] = {name: body_keys(one) for name, one in bodies.items()}
        protocol["repetitions"] = [each | _compensation(trial, each) for each in protocol["repetitions"]]
    ranges = _ranges(trial, np.ones(len(trial.time), dtype=np.bool_))
    gated = _ranges(trial, np.sin(trial.angles["shoulder_elevation"]) > _STEEP)
    return {
        **_common(options, trial, options.movement),
        "subject_seed": person_seed(options),
        "side": options.side,
        "subject": _subject(body),
        "markers": _arm_markers(trial, body),
        **protocol,
        "ranges_rad": ranges,
        "ranges_gated_rad": gated,
        **({"reach": _volume(body, ranges, gated)} if options.movement == "reach" else {}),
    }


def _volume(body: ArmBody, ranges: Ranges, gated: Ranges) -> dict[str, Any]:
    box = np.array([gated["plane"], ranges["elevation"], gated["axial"], ranges["hinge"]])
    volume, sd = reach_volume(body, box, float(np.mean(ranges["pronation"])))
    return {"volume_m3": volume, "mc_sd_m3": sd, "box_rad": box.tolist()}


def chain_document(options: ChainOptions, trial: SpatialTrial) -> dict[str, Any]:
    """Return JSON values for ``truth.json`` of a plain chain."""
    markers = [
        {"label": label, "name": label, "segment": int(trial.assignment[i]), "local_xyz_m": trial.local[i].tolist()}
        for i, label in enumerate(trial.labels)
    ]
    return {**_common(options, trial, "sphere"), **trial.document, "markers": markers}


def _common(options: ArmOptions | ChainOptions, trial: SpatialTrial, kind: str) -> dict[str, Any]:
    return {
        "conventions": CONVENTIONS,
        "g": GRAVITY,
        "kind": kind,
        "seed": options.seed,
        "options": asdict(options),
        "point_rate_hz": trial.rate,
        "n_frames": len(trial.time),
        "static_s": trial.still,
        "segments": list(trial.segments),
        "assignment": dict(zip(trial.labels, trial.assignment.tolist(), strict=True)),
        "marker_noise_sd_mm": 1e3 * PRESETS[options.preset].marker_noise,
        "dropouts": [{"label": b.label, "first_frame": b.first, "n_frames": b.count} for b in trial.bursts],
        "dropped_fraction": float(np.isnan(trial.positions[..., 0]).mean()),
    }


def _subject(body: ArmBody) -> dict[str, Any]:
    glide = float(np.linalg.norm(body.glide))
    return {
        "sex": body.subject.sex,
        "stature_m": body.subject.height,
        "mass_kg": body.subject.mass,
        "segment_lengths_m": {"upper_arm": body.upper_arm, "forearm": body.forearm},
        "gh0_in_thorax_m": body.shoulder.tolist(),
        "sc_translation_m": glide,
        "sc_direction": (body.glide / glide).tolist() if glide else None,
        "elbow_centre_in_upper_arm_m": body.elbow.tolist(),
        "elbow_axis_in_upper_arm": body.elbow_axis.tolist(),
        "carry0_rad": float(body.carrying),
        "pronation_axis_in_forearm": body.pronation_axis.tolist(),
        "wjc_in_forearm_m": body.wrist.tolist(),
        "landmarks_in_segment_m": {
            name: {"segment": segment, "xyz": point.tolist()} for name, (segment, point) in body.landmarks.items()
        },
    }


def _arm_markers(trial: SpatialTrial, body: ArmBody) -> list[Mapping[str, Any]]:
    markers: ArmMarkers = trial.document["markers"]
    moved = 1e3 * np.sqrt((trial.skin**2).sum(axis=2).mean(axis=0))
    return [
        {
            "label": label,
            "name": name,
            "segment": int(markers.segment[i]),
            "local_xyz_m": markers.local[i].tolist(),
            "bone_xyz_m": body.landmarks[name][1].tolist() if name in body.landmarks else None,
            "sta_amplitude_m": float(markers.slide[i]),
            "twist_loss": float(markers.twist_loss[i]),
            "sta_rms_mm": float(moved[i]),
        }
        for i, (label, name) in enumerate(zip(markers.labels, markers.names, strict=True))
    ]


def _ranges(trial: SpatialTrial, where: BoolArray) -> Ranges:
    """Return the lowest and highest value of each angle in the frames ``where`` (F,), rad."""
    values = {name.split("_")[1]: trial.angles[name] for name in trial.angles if not name.startswith("wrist")}
    values |= {"hinge": trial.arrays["q_hinge"][:, 0], "pronation": trial.arrays["q_pron"][:, 0]}
    return {name: [float(each[where].min()), float(each[where].max())] for name, each in values.items()}


def _compensation(trial: SpatialTrial, repetition: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the range of every shoulder angle within a curl, rad."""
    within = (trial.time >= repetition["start"]) & (trial.time <= repetition["end"])
    names = ("plane", "elevation", "axial")
    return {"compensation_rad": {name: float(np.ptp(trial.angles[f"shoulder_{name}"][within])) for name in names}}
