"""Simulated trials in space on disk: recording, truth, and a configuration that is ready to run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mocap_id.simulation.arm.arm import generate_arm
from mocap_id.simulation.arm.chain import generate_chain
from mocap_id.simulation.arm.curl_torque import curl_keys, device_yaml
from mocap_id.simulation.arm.options import ArmOptions, ChainOptions
from mocap_id.simulation.arm.sensors import film_skeleton, simulate_sensors
from mocap_id.simulation.arm.trial import SpatialTrial
from mocap_id.simulation.arm.truth import arm_document, arrays, chain_document
from mocap_id.simulation.inertial_sensors import csv_bytes
from mocap_id.simulation.trial_files import json_bytes, npz_bytes, points_bytes, write_trial

_TRIAL = """\
# {what}
# Made by `mocap-id simulate {kind}` with seed {seed}. The exact truth is in truth.json and truth.npz.
# Paths are relative to this file.
trial: {name}
recording: trial.c3d  # markers
space: 3d
protocol: {protocol}
"""


def write_arm(folder: Path, options: ArmOptions) -> Path:
    """Simulate an arm, write it with its exact truth, and return the path of ``trial.yaml``.

    The folder is created if necessary. It receives ``trial.c3d``, ``truth.json``, ``truth.npz``, ``trial.yaml`` and,
    depending on the options, ``kinect.csv``, ``imu_<segment>.csv`` and ``device.yaml``. The trial is named after it.

    StoreError is raised if the folder already contains a trial, or cannot be written.
    """

    def make(name: str) -> dict[str, bytes]:
        trial = generate_arm(options)
        reach = options.movement == "reach"
        what = "rounds of reaches" if reach else "curls"
        count = options.cycles if reach else options.repetitions
        entries = {"kind": "arm", "seed": options.seed, "protocol": options.movement}
        text = _yaml(name, what=f"A {options.side} arm, {count} {what}.", **entries)
        text += f"side: {options.side}\n"
        document = arm_document(options, trial)
        more: dict[str, bytes] = {}
        if options.calibration:
            text += f"calibration: {json.dumps(options.calibration, ensure_ascii=False)}\n"
        if not reach:
            keys = curl_keys(options, trial.document["body"])
            text += "curl:\n" + "".join(f"  {key}: {json.dumps(value)}\n" for key, value in keys.items())
            more |= {"device.yaml": device_yaml()} if options.condition != "C" else {}
        if options.imus:
            sensors = simulate_sensors(trial, options)
            document["imu"] = {segment: dict(sensor.truth) for segment, sensor in sensors.items()}
            more |= {f"imu_{segment}.csv": csv_bytes(sensor) for segment, sensor in sensors.items()}
            text += "imus: {" + ", ".join(f"{segment}: imu_{segment}.csv" for segment in sensors) + "}\n"
        if options.skeleton:
            skeleton = film_skeleton(trial, options)
            document["kinect"], more["kinect.csv"] = skeleton.document(), skeleton.csv()
            text += "# from the depth camera alone: recording: {skeleton: kinect.csv}\n"
        return _contents(trial, document, text) | more

    return write_trial(folder, make)


def write_chain(folder: Path, options: ChainOptions) -> Path:
    """Simulate a chain of bodies, write it with its exact truth, and return the path of ``trial.yaml``."""

    def make(name: str) -> dict[str, bytes]:
        trial = generate_chain(options)
        what = f"A chain of {len(options.kinds)} joints ({options.kinds})."
        text = _yaml(name, what=what, kind="chain", seed=options.seed, protocol="free")
        return _contents(trial, chain_document(options, trial), text)

    return write_trial(folder, make)


def _contents(trial: SpatialTrial, document: dict[str, Any], text: str) -> dict[str, bytes]:
    return {
        "trial.c3d": points_bytes(trial.labels, trial.positions, trial.rate),
        "truth.npz": npz_bytes(arrays(trial)),
        "truth.json": json_bytes(document),
        "trial.yaml": text.encode(),
    }


def _yaml(name: str, **entries: Any) -> str:
    return _TRIAL.format(name=json.dumps(name, ensure_ascii=False), **entries)  # the name may be 12 or yes
