"""Simulated robots in space on disk: recording, truth, and a configuration that is ready to run."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.space.base_parameters import name_parameters, structural_base
from mocap_id.geometry import se3
from mocap_id.simulation.space_robot.options import SpaceRobotOptions
from mocap_id.simulation.space_robot.trial import FRAME, MARKER_NOISE, SpaceRobotTrial, generate_space_robot
from mocap_id.simulation.trial_files import json_bytes, npz_bytes, points_bytes, write_trial

_YAML = """\
# A robot of {joints} hinges in space on a force plate{load}.
# Made by `mocap-id simulate robot-in-space` with seed {seed}. The exact truth is in truth.json and truth.npz.
# Paths are relative to this file.
trial: {name}
space: 3d
protocol: free
recording: trial.c3d  # markers and force plate
{settings}"""
_SETTINGS = """\
identify-dim:  # standard deviations of the instruments' errors
  plate_gain_sd: {gain:g}
  plate_moments_sd: {moments:g}
  plate_zero_sd_n: {force:g}  # N
  plate_zero_sd_nm: {moment:g}  # N*m
  plate_position_sd_m: {position:g}  # m
  camera_scale_sd: {lengths:g}
  camera_tilt_sd_deg: {degrees:.3g}
"""
_CONVENTIONS = (
    "Laboratory axes, Z up, SI. seg_R takes segment axes to the laboratory; seg_origin is the segment's joint, or the "
    "base's origin. Ten parameters of a segment in its own frame about its origin: m, mx, my, mz, Ixx, Iyy, Izz, Ixy, "
    "Ixz, Iyz. wrench: true force and moment of the ground about the laboratory's origin at the frames. torque: about "
    "each joint's axis. joint_axes: axis in the frame of the parent, then in the frame of the child. A plate sample "
    "with time t was measured at t + clock_offset_s. base_parameters: in frames with z along the hinge (the base: "
    "laboratory axes X, Z, -Y), with the moments of the base about its origin."
)


def simulate_space_robot(folder: Path, options: SpaceRobotOptions) -> Path:
    """Simulate a robot in space, write it with its exact truth, and return the path of ``trial.yaml``.

    The folder is created if necessary. It receives ``trial.c3d``, ``truth.json``, ``truth.npz`` and ``trial.yaml``, and
    gives the trial its name.

    Raises
    ------
    StoreError
        The folder already contains a trial, or cannot be written.
    """
    return write_trial(folder, lambda name: _contents(generate_space_robot(options), name))


def _contents(trial: SpaceRobotTrial, name: str) -> dict[str, bytes]:
    return {
        "trial.c3d": points_bytes(trial.robot.labels, trial.points, trial.options.rate, [trial.signals]),
        "truth.json": json_bytes(_truth(trial)),
        "truth.npz": npz_bytes(_arrays(trial)),
        "trial.yaml": _yaml(trial, name).encode(),
    }


def _yaml(trial: SpaceRobotTrial, name: str) -> str:
    options, sd = trial.options, trial.options.errors
    values = asdict(sd) | {"degrees": np.degrees(sd.tilt)}
    return _YAML.format(
        joints=options.joints,
        load=f", with a payload of {options.payload:g} kg" if options.payload else "",
        seed=options.seed,
        name=json.dumps(name, ensure_ascii=False),
        settings=_SETTINGS.format(**values),
    )


def _truth(trial: SpaceRobotTrial) -> dict[str, Any]:
    robot, options = trial.robot, trial.options
    structure = structural_base(robot.chain, se3.pose(robot.base[:3, :3], np.zeros(3)))
    joints = robot.chain.joints
    return {
        "kind": "robot-in-space",
        "conventions": _CONVENTIONS,
        "options": asdict(options),
        "rate_hz": options.rate,
        "static_s": 1.0,
        "marker_noise_m": MARKER_NOISE * options.noise,
        "segments": ["base", *(f"segment_{k}" for k in range(1, len(joints) + 1))],
        "joints": [f"joint_{k}" for k in range(1, len(joints) + 1)],
        "joint_kinds": [joint.kind for joint in joints],
        "joint_centres_m": [joint.centre.tolist() for joint in joints],
        "joint_axes": [[joint.first_axis.tolist(), (joint.offset.T @ joint.first_axis).tolist()] for joint in joints],
        "assignment": dict(zip(robot.labels, robot.chain.segment.tolist(), strict=True)),
        "local_xyz_m": dict(zip(robot.labels, robot.chain.local.tolist(), strict=True)),
        "clock_offset_s": trial.clock_offset,
        "instrument_errors": {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(trial.errors).items()
        },
        "parameters": dict(zip(name_parameters(len(robot.parameters)), robot.parameters.ravel().tolist(), strict=True)),
        "payload": {"segment": len(joints), "parameters": robot.payload.tolist()},
        "base_parameters": {
            "names": list(structure.names),
            "units": list(structure.units),
            "values": (structure.mapping @ robot.parameters.ravel()).tolist(),
        },
    }


def _arrays(trial: SpaceRobotTrial) -> dict[str, FloatArray]:
    to_lab, motion = FRAME.axes.T, trial.motion

    def vectors(values: FloatArray) -> FloatArray:
        return np.asarray(values @ to_lab.T)

    return {
        "t": trial.time,
        "q": trial.q,
        "dq": trial.dq,
        "ddq": trial.ddq,
        "seg_R": to_lab @ motion.rotation,
        "seg_origin": vectors(motion.origin),
        "omega": vectors(motion.omega),
        "alpha": vectors(motion.alpha),
        "joint_lab": vectors(motion.joint),
        "wrench": np.concatenate([vectors(trial.wrench[:, :3]), vectors(trial.wrench[:, 3:])], axis=1),
        "torque": trial.torque,
    }
