"""Simulated arms and chains on disk: recording, truth, and a configuration that is ready to run."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray, sobol
from mocap_id.geometry import so3
from mocap_id.recording.imu_log import ImuLog, format_imu_csv
from mocap_id_simulation.arm import (
    FOREARM,
    HAND,
    THORAX,
    UPPER_ARM,
    ArmBody,
    ArmMarkers,
    arm_bodies,
    body_keys,
    carried_loads,
    device_yaml,
    generate_arm,
    person_seed,
)
from mocap_id_simulation.instruments import IMU_SEED, measure_motion
from mocap_id_simulation.options import PRESETS, ArmOptions, ChainOptions
from mocap_id_simulation.sit_to_stand import X, Y
from mocap_id_simulation.space_robot import SimulatedSpaceTrial, generate_chain
from mocap_id_simulation.trial_files import flow_mapping, points_bytes, trial_contents, write_trial, yaml_head


def write_arm(folder: Path, options: ArmOptions) -> Path:
    """Simulate an arm, write it with its exact truth, and return the path of ``trial.yaml``.

    The folder is created if necessary. It receives ``trial.c3d``, ``truth.json``, ``truth.npz``, ``trial.yaml`` and,
    depending on the options, ``kinect.csv``, ``imu_<segment>.csv`` and ``device.yaml``. The trial is named after it.

    StoreError is raised if the folder already contains a trial, or cannot be written.
    """

    def make(name: str) -> dict[str, bytes]:
        trial = generate_arm(options)
        reach = options.movement == "reach"
        moves = f"{options.cycles} rounds of reaches" if reach else f"{options.repetitions} curls"
        text = yaml_head(f"A {options.side} arm, {moves}.", "mocap-id simulate arm", options.seed, name)
        text += f"{_RECORDING}protocol: {options.movement}\nside: {options.side}\n"
        truth = arm_document(options, trial)
        logs: dict[str, bytes] = {}
        if options.calibration:
            text += f"calibration: {json.dumps(options.calibration, ensure_ascii=False)}\n"
        if not reach:
            # the exact inertial parameters of all bodies
            keys: dict[str, Any] = {"condition": options.condition, "metronome_hz": 0.5}
            if options.condition != "C":
                keys["device"], logs["device.yaml"] = "device.yaml", device_yaml()
            keys["loads"] = {name: body_keys(one) for name, one in carried_loads(options.condition).items()}
            keys |= {name: body_keys(one) for name, one in arm_bodies(trial.document["body"]).items()}
            text += "curl:\n" + "".join(f"  {key}: {json.dumps(value)}\n" for key, value in keys.items())
        if options.imus:
            sensors = simulate_sensors(trial, options)
            truth["imu"] = {segment: each for segment, (_, each) in sensors.items()}
            logs |= {f"imu_{segment}.csv": format_imu_csv(each) for segment, (each, _) in sensors.items()}
            text += f"imus: {flow_mapping({segment: f'imu_{segment}.csv' for segment in sensors})}\n"
        if options.skeleton:
            logs["kinect.csv"], truth["kinect"] = film_skeleton(trial, options)
            text += "# from the depth camera alone: recording: {skeleton: kinect.csv}\n"
        recording = points_bytes(trial.labels, trial.positions, trial.rate)
        return trial_contents(recording, truth, spatial_arrays(trial), text) | logs

    return write_trial(folder, make)


def write_chain(folder: Path, options: ChainOptions) -> Path:
    """Simulate a chain of bodies, write it with its exact truth, and return the path of ``trial.yaml``."""

    def make(name: str) -> dict[str, bytes]:
        trial = generate_chain(options)
        what = f"A chain of {len(options.kinds)} joints ({options.kinds})."
        text = yaml_head(what, "mocap-id simulate chain", options.seed, name) + f"{_RECORDING}protocol: free\n"
        markers = [
            {"label": label, "name": label, "segment": int(trial.assignment[i]), "local_xyz_m": trial.local[i].tolist()}
            for i, label in enumerate(trial.labels)
        ]
        truth = {**_describe_recording(options, trial, "sphere"), **trial.document, "markers": markers}
        recording = points_bytes(trial.labels, trial.positions, trial.rate)
        return trial_contents(recording, truth, spatial_arrays(trial), text)

    return write_trial(folder, make)


_RECORDING = "recording: trial.c3d  # markers\nspace: 3d\n"


# --- the truth

_CONVENTIONS = """\
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
_STEEP = np.sin(np.radians(15.0))


def spatial_arrays(trial: SimulatedSpaceTrial) -> dict[str, np.ndarray[Any, Any]]:
    """Return arrays for ``truth.npz``."""
    out: dict[str, np.ndarray[Any, Any]] = {
        "t": trial.time,
        "seg_R": trial.rotations,
        "seg_origin": trial.origins,
        "omega": trial.omega,
        "alpha": trial.alpha,
        "markers_true_mm": (1e3 * trial.true_positions).astype(np.float32),
        **trial.arrays,
    }
    if not trial.angles:
        return out
    for suffix, values in (("", trial.angles), ("_rate", trial.rates), ("_acc", trial.accelerations)):
        shoulder = (values["shoulder_plane"], -values["shoulder_elevation"], values["shoulder_axial"])
        out["isb_shoulder" + suffix] = np.stack(shoulder, axis=1)
        elbow = (values["elbow_flexion"], values["elbow_carrying"], values["elbow_pronation"])
        out["isb_elbow" + suffix] = np.stack(elbow, axis=1)
        out["wrist_angles" + suffix] = np.stack([values["wrist_flexion"], values["wrist_deviation"]], axis=1)
    out["isb_condition"] = 1 / np.abs(np.sin(trial.angles["shoulder_elevation"]))
    return out


def arm_document(options: ArmOptions, trial: SimulatedSpaceTrial) -> dict[str, Any]:
    """Return JSON values for ``truth.json`` of an arm."""
    body: ArmBody = trial.document["body"]
    markers: ArmMarkers = trial.document["markers"]
    protocol = dict(trial.document["protocol"])
    if options.movement == "curl":
        bodies = {**arm_bodies(body), **carried_loads(options.condition)}
        protocol["bodies"] = {name: body_keys(one) for name, one in bodies.items()}
        # with the range of every shoulder angle within each curl
        repetitions = []
        for each in protocol["repetitions"]:
            within = (trial.time >= each["start"]) & (trial.time <= each["end"])
            angles = {name: trial.angles[f"shoulder_{name}"] for name in ("plane", "elevation", "axial")}
            moved = {name: float(np.ptp(angle[within])) for name, angle in angles.items()}
            repetitions.append({**each, "compensation_rad": moved})
        protocol["repetitions"] = repetitions
    ranges = _ranges(trial, np.ones(len(trial.time), dtype=np.bool_))
    gated = _ranges(trial, np.sin(trial.angles["shoulder_elevation"]) > _STEEP)
    reach = {}
    if options.movement == "reach":
        box = np.array([gated["plane"], ranges["elevation"], gated["axial"], ranges["hinge"]])
        volume, sd = reach_volume(body, box, float(np.mean(ranges["pronation"])))
        reach = {"reach": {"volume_m3": volume, "mc_sd_m3": sd, "box_rad": box.tolist()}}
    glide = float(np.linalg.norm(body.glide))
    moved = 1e3 * np.sqrt((trial.skin**2).sum(axis=2).mean(axis=0))
    return {
        **_describe_recording(options, trial, options.movement),
        "subject_seed": person_seed(options),
        "side": options.side,
        "subject": {
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
        },
        "markers": [
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
        ],
        **protocol,
        "ranges_rad": ranges,
        "ranges_gated_rad": gated,
        **reach,
    }


def _ranges(trial: SimulatedSpaceTrial, where: BoolArray) -> dict[str, list[float]]:
    """Return the lowest and highest value of each angle in the frames ``where`` (F,), rad."""
    values = {name.split("_")[1]: trial.angles[name] for name in trial.angles if not name.startswith("wrist")}
    values |= {"hinge": trial.arrays["q_hinge"][:, 0], "pronation": trial.arrays["q_pron"][:, 0]}
    return {name: [float(each[where].min()), float(each[where].max())] for name, each in values.items()}


def _describe_recording(options: ArmOptions | ChainOptions, trial: SimulatedSpaceTrial, kind: str) -> dict[str, Any]:
    """Return the entries of the truth that arms and chains share."""
    return {
        "conventions": _CONVENTIONS,
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
        "dropouts": [asdict(burst) for burst in trial.bursts],
        "dropped_fraction": float(np.isnan(trial.positions[..., 0]).mean()),
    }


# --- the volume that the wrist reaches

POINTS = 2**14  # number of points, including points beyond the largest reach
ELEVATIONS = 320
_HINGES = 500


def reach_volume(body: ArmBody, box: FloatArray, pronation: float) -> tuple[float, float]:
    """Return the volume that the wrist reaches within a box of joint angles (thesis 7.2), and its standard error, m³.

    The volume is in the thorax frame, for a constant ``pronation``, rad. The ``box`` (4, 2) has the lowest and highest
    plane, elevation, axial rotation and hinge angle, rad. For each of many evenly spread points, the angles that reach
    it are computed: the distance from the shoulder gives the hinge angle. At a given elevation, the height gives the
    axial rotation, and the direction gives the plane. A point is reached if these angles are within the box for at
    least one elevation of many.
    """
    hinge = np.linspace(box[3, 0], box[3, 1], _HINGES)
    forearm = so3.exp(X * body.carrying) @ so3.exp(body.pronation_axis * pronation)
    wrist = body.elbow + so3.exp(hinge[:, None] * body.elbow_axis) @ forearm @ np.array([0.0, -body.forearm, 0.0])
    reach = np.linalg.norm(wrist, axis=1)
    side = float(reach.max() + np.linalg.norm(body.glide))
    offsets = side * (2 * sobol(POINTS, 3, 0) - 1)
    points = body.shoulder + offsets[np.linalg.norm(offsets, axis=1) <= side]
    reached = np.zeros(len(points), dtype=np.bool_)
    order = np.argsort(reach)
    for elevation in np.linspace(box[1, 0], box[1, 1], ELEVATIONS):
        away = points[~reached] - body.shoulder - (1 - np.cos(elevation)) / 2 * body.glide
        distance = np.linalg.norm(away, axis=1)
        arm = np.stack([np.interp(distance, reach[order], each) for each in wrist[order].T], axis=1)
        near = (distance >= reach.min()) & (distance <= reach.max())
        reached[~reached] = near & _is_reached(away, arm, elevation, box)
    share = float(reached.sum() / POINTS)
    whole = (2 * side) ** 3
    return whole * share, whole * float(np.sqrt(share * (1 - share) / POINTS))


def _is_reached(away: FloatArray, arm: FloatArray, elevation: float, box: FloatArray) -> BoolArray:
    """Return whether R_y(plane) R_x(-elevation) R_y(axial) within the box rotates ``arm`` into ``away`` (N, 3)."""
    sine, cosine = np.sin(elevation), np.cos(elevation)
    forward = (away[:, 1] - cosine * arm[:, 1]) / sine
    possible = np.abs(forward) <= np.hypot(arm[:, 0], arm[:, 2])
    spread = np.arccos(np.clip(forward / np.hypot(arm[:, 0], arm[:, 2]), -1, 1))
    allowed = np.zeros(len(away), dtype=np.bool_)
    for sign in (-1, 1):
        axial = sign * spread - np.arctan2(arm[:, 0], arm[:, 2])
        across = arm[:, 0] * np.cos(axial) + arm[:, 2] * np.sin(axial)
        plane = np.arctan2(away[:, 0], away[:, 2]) - np.arctan2(across, cosine * forward - sine * arm[:, 1])
        allowed |= _is_within(axial, box[2]) & _is_within(plane, box[0])
    return np.asarray(possible & allowed)


def _is_within(angle: FloatArray, limits: FloatArray) -> BoolArray:
    return np.asarray(np.mod(angle - limits[0], 2 * np.pi) <= limits[1] - limits[0])


SKELETON_RATE = 30.0  # Hz
_TRUNK = {
    "SpineBase": (-0.030, -0.270, 0.0),
    "SpineMid": (-0.028, -0.128, 0.0),
    "SpineShoulder": (-0.029, -0.002, 0.0),
    "Neck": (-0.018, 0.031, 0.0),
    "Head": (0.010, 0.112, 0.0),
    "HipLeft": (-0.012, -0.285, -0.048),
    "HipRight": (-0.012, -0.285, 0.048),
}
"""Positions in the thorax, as fractions of the stature."""
_HAND_JOINTS = {"Hand": (0.0, -0.045, 0.0), "HandTip": (0.0, -0.095, 0.0), "Thumb": (0.0, -0.045, 0.03)}
"""Positions in the hand, as fractions of the stature."""
_INFERRED = {"Elbow": 0.02, "Wrist": 0.06, "Hand": 0.11, "HandTip": 0.07, "Thumb": 0.16}
"""Fraction of the frames in which the camera only infers the position of a joint."""
_BIAS = {"HandTip": 2.0, "Thumb": 2.5, "Hand": 1.3}
"""Factor on the constant error of a joint."""
_BIAS_SD, _NOISE_SD, _SURFACE = 0.012, 0.0075, -0.012  # m; the camera sees the near side of the body
_DEPTH_NOISE = 1.35  # noise along the line of sight, relative to that across it
_WHITE, _MEMORY = 0.12, 0.22  # fraction of the noise's variance that is white; correlation time of the rest, s
_INFERRED_SD, _JUMP_SD = 0.025, 0.06  # m
_HARD = 1.5  # factor on all errors
_LOST, _DROPPED = 0.01, 0.025  # fractions of the frames of a hand, and of the rows
_ROW_JITTER = 0.0012  # s, of the times


def film_skeleton(trial: SimulatedSpaceTrial, options: ArmOptions) -> tuple[bytes, dict[str, Any]]:
    """Return the skeleton that a depth camera sees of a person who was simulated with these options, and its truth.

    The skeleton is a CSV log with positions in the camera's axes (x to its left, y up, z away from it), m, on its own
    clock: a row was recorded at ``offset_s`` of the truth + its time. States are 2 tracked, 1 inferred, 0 missing. With
    the preset ``clean``, the offset of the clock is the only error.
    """
    rng = np.random.default_rng([options.seed, 30])
    size = {"clean": 0.0, "default": 1.0, "hard": _HARD}[options.preset]
    offset = float(rng.uniform(-0.1, 0.1))
    count = int((trial.time[-1] - 0.2) * SKELETON_RATE)
    ticks = 0.1 + np.arange(count) / SKELETON_RATE + rng.uniform(-1, 1, count) * _ROW_JITTER
    at = ticks[rng.random(count) > _DROPPED]
    # names and true positions (K, J, 3) of the joints in the laboratory
    body: ArmBody = trial.document["body"]
    mirrored = options.side == "left"
    height = body.subject.height
    arm, other = ("Left", "Right") if mirrored else ("Right", "Left")
    local = {name: (THORAX, height * np.array(share)) for name, share in _TRUNK.items()}
    local[f"Shoulder{other}"] = (THORAX, body.shoulder * [1, 1, -1])
    local |= {f"{name}{arm}": (HAND, height * np.array(share)) for name, share in _HAND_JOINTS.items()}
    points = {
        name: trial.origins[:, s] + trial.rotations[:, s] @ np.asarray(where) for name, (s, where) in local.items()
    }
    points |= {
        f"{name}{arm}": trial.origins[:, s]
        for name, s in (("Shoulder", UPPER_ARM), ("Elbow", FOREARM), ("Wrist", HAND))
    }
    if mirrored:  # the recording contains the mirror image
        points = {name: point * [1, -1, 1] for name, point in points.items()}
        swapped = {"HipLeft": "HipRight", "HipRight": "HipLeft"}
        points = {swapped.get(name, name): point for name, point in points.items()}
    sampled = [np.column_stack([np.interp(at, trial.time, c) for c in point.T]) for point in points.values()]
    joints, lab = tuple(points), np.stack(sampled, axis=1)
    # the camera looks at the person from the front, tilted by some degrees
    forward = trial.rotations[0, THORAX, :, 0] * np.array([1.0, 1.0, 0.0])
    away = -forward / np.linalg.norm(forward)
    away = so3.exp(np.array([0.0, 0.0, rng.uniform(-0.3, 0.3)])) @ away
    up = np.array([0.0, 0.0, 1.0])
    left = np.cross(up, away)
    rotation = np.stack([left, up, away], axis=1) @ so3.exp(np.array([rng.uniform(-0.02, 0.12), 0.0, 0.0]))
    position = trial.origins[0, THORAX] - rng.uniform(2.0, 2.5) * away - [0.0, 0.0, rng.uniform(0.0, 0.3)]
    seen = (lab - position) @ rotation
    states = np.full(seen.shape[:2], 2, dtype=np.int64)
    if size:
        kinds = [joint.removesuffix("Right").removesuffix("Left") for joint in joints]
        bias = rng.normal(0, _BIAS_SD, (len(joints), 3)) * np.array([_BIAS.get(kind, 1.0) for kind in kinds])[:, None]
        bias[:, 2] += _SURFACE
        # autocorrelated noise
        fades = float(np.exp(-1 / (SKELETON_RATE * _MEMORY)))
        steps = rng.normal(0, 1, seen.shape)
        slow = np.empty_like(steps)
        slow[0] = steps[0]
        for k in range(1, len(at)):
            slow[k] = fades * slow[k - 1] + np.sqrt(1 - fades**2) * steps[k]
        total = np.sqrt(1 - _WHITE) * slow + np.sqrt(_WHITE) * rng.normal(0, 1, steps.shape)
        seen = seen + size * (bias + _NOISE_SD * total * [1.0, 1.0, _DEPTH_NOISE])
        for k, kind in enumerate(kinds):
            _infer(rng, seen[:, k], states[:, k], size * _INFERRED.get(kind, 0.0), is_hand=kind == "Hand")
    names = [f"{joint}_{part}" for joint in joints for part in ("x", "y", "z", "state")]
    lines = [",".join(["time_s", *names])]
    for t, row, state in zip((at - offset).tolist(), seen, states.tolist(), strict=True):
        cells = [f"{t:.4f}"]
        for point, s in zip(row.tolist(), state, strict=True):
            cells += ["", "", ""] if s == 0 else [f"{value:.5f}" for value in point]
            cells.append(str(s))
        lines.append(",".join(cells))
    truth = {
        "offset_s": offset,
        "camera_R_to_lab": rotation.tolist(),
        "camera_p_lab_m": position.tolist(),
        "joints": list(joints),
    }
    return ("\n".join(lines) + "\n").encode(), truth


def _infer(rng: np.random.Generator, points: FloatArray, state: IntArray, share: float, *, is_hand: bool) -> None:
    """Add inferred intervals and jumps to a joint's ``points`` and ``state``, in place; remove samples of a hand."""
    count = len(points)
    for _ in range(rng.poisson(share * count / 10)):
        start, length = int(rng.integers(count)), int(rng.integers(3, 18))
        state[start : start + length] = 1
        points[start : start + length] += rng.normal(0, _INFERRED_SD, 3)
    inferred: BoolArray = state == 1
    points[inferred] += rng.normal(0, _INFERRED_SD / 2, (int(inferred.sum()), 3))
    jumps = np.flatnonzero(rng.random(count) < (0.004 if share else 0.0))
    points[jumps] += rng.normal(0, _JUMP_SD, (len(jumps), 3))
    if is_hand and share:
        state[rng.random(count) < _LOST] = 0


_ERROR_FACTOR = {"clean": 0.0, "default": 1.0, "hard": 2.0}
_POSITION = {"thorax": (0.04, -0.06, 0.0), "upper_arm": (0.0, -0.19, 0.05), "forearm": (-0.01, -0.21, 0.03)}
_ON_HAND = (-0.03, -0.06, 0.0)
_LOSS = {"upper_arm": 0.25, "forearm": 0.12}  # fraction of the axial rotation that the skin does not follow


def simulate_sensors(trial: SimulatedSpaceTrial, options: ArmOptions) -> dict[str, tuple[ImuLog, dict[str, Any]]]:
    """Return log and truth of a sensor on each segment of an arm that was generated with these options, by its name.

    The preset scales the errors of the sensors. The preset and the factor of soft tissue scale the rotation of the skin
    under the sensors.

    Examples
    --------
    >>> from mocap_id_simulation.arm import generate_arm
    >>> options = ArmOptions(seed=1, preset="clean", cycles=1)
    >>> sorted(simulate_sensors(generate_arm(options), options))
    ['forearm', 'hand', 'thorax', 'upper_arm']
    """
    upper_arm = np.unwrap(np.asarray(trial.angles["shoulder_axial"] + trial.angles["shoulder_plane"]))
    axial = {"upper_arm": upper_arm, "forearm": trial.arrays["q_pron"][:, 0]}
    factor = _ERROR_FACTOR[options.preset]
    loss = min(options.soft_tissue, 1.0) * PRESETS[options.preset].twist_loss
    sensors = {}
    for s, name in enumerate(trial.segments):
        rng = np.random.default_rng([options.seed, IMU_SEED, s])
        share = loss * _LOSS.get(name, 0.0)
        angle = axial.get(name, np.zeros(len(trial.time)))
        position = np.array(_POSITION.get(name, _ON_HAND)) * np.where(np.arange(3) == 1, rng.uniform(0.9, 1.1), 1.0)
        rotations = trial.rotations[:, s] @ so3.exp(-share * (angle - angle[0])[:, None] * Y)
        points = trial.origins[:, s] + np.einsum("fij,j->fi", rotations, position)
        truth = {"position_in_segment_m": position.tolist(), "twist_loss": share}
        sensors[name] = measure_motion(rng, trial.time, rotations, points, error_factor=factor, truth=truth)
    if options.side == "right":
        return sensors
    turn, pull = np.array([-1.0, -1.0, 1.0]), np.array([1.0, 1.0, -1.0])  # the mirrored sensor on a left arm
    return {
        name: (replace(each, gyro=each.gyro * turn, acc=each.acc * pull), truth)
        for name, (each, truth) in sensors.items()
    }
