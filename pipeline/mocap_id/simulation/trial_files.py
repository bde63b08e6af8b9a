"""Simulated trials on disk: recording, truth, and a configuration that is ready to run."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, StoreError
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.recording.writer import write_c3d
from mocap_id.simulation.balance_board import board_csv, draw_board
from mocap_id.simulation.encoder import draw_encoder, encoder_csv
from mocap_id.simulation.inertial_sensors import csv_bytes, sensors_in_plane
from mocap_id.simulation.joint_motion import JointMotion
from mocap_id.simulation.joint_sensor import joint_sensor_csv
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.scene import streams
from mocap_id.simulation.simulated_trial import SimulatedTrial, generate
from mocap_id.simulation.truth import arrays, document
from mocap_id.simulation.yaml_files import trial_yaml
from mocap_id.store.atomic import converting_errors, write_files


def simulate(kind: Kind, folder: Path, options: Options, given: JointMotion | None = None) -> Path:
    """Simulate a trial and write it with its exact truth.

    Parameters
    ----------
    kind : {"sit-to-stand", "robot"}
    folder : Path
        Created if necessary; receives ``trial.c3d``, ``truth.json``, ``truth.npz``, ``trial.yaml`` and, for the robot,
        ``encoder.csv``. The trial is named after the folder.
    options : Options
    given : JointMotion, optional
        Motion of the body, instead of the usual one of this kind; there is then no chair.

    Returns
    -------
    Path
        ``trial.yaml``.

    Raises
    ------
    ConfigError
        The kind is unknown.
    StoreError
        The folder already holds a trial, or cannot be written.
    """
    if kind not in get_args(Kind):
        raise ConfigError(f"simulate: there is no kind {kind!r}; expected one of {', '.join(get_args(Kind))}")
    return write_trial(folder, lambda name: _contents(kind, name, options, generate(kind, options, given)))


def write_trial(folder: Path, make: Callable[[str], Mapping[str, bytes]]) -> Path:
    """Write a new trial whose files ``make`` returns, given the trial's name.

    Returns
    -------
    Path
        ``trial.yaml``.

    Raises
    ------
    StoreError
        The folder already holds a trial, or cannot be written.
    """
    if (folder / "trial.c3d").exists():
        raise StoreError(f"{folder} already holds a trial: remove it or choose another folder")
    contents = make(folder.resolve().name)
    write_files(folder, contents)
    return folder / "trial.yaml"


def new_folder(folder: Path) -> None:
    """Create a folder; StoreError if it exists and is not empty."""
    with converting_errors(folder):
        if folder.exists() and any(folder.iterdir()):
            raise StoreError(f"{folder} is not empty: choose a new folder")
        folder.mkdir(parents=True, exist_ok=True)


def _contents(kind: Kind, name: str, options: Options, trial: SimulatedTrial) -> dict[str, bytes]:
    more: dict[str, Any] = {}
    contents = {
        "trial.c3d": c3d_bytes(options, trial),
        "truth.npz": truth_npz(trial),
        "trial.yaml": trial_yaml(kind, name, options, trial.scene).encode(),
    }
    if kind == "robot":
        rng = streams(options.seed)["encoder"]
        encoder = draw_encoder(rng)
        more["encoder"] = encoder.as_dict()
        contents["encoder.csv"] = encoder_csv(rng, trial.scene, encoder).encode()
        if options.joint_sensor:
            contents["sensor.csv"] = joint_sensor_csv(streams(options.seed)["board"], trial.scene).encode()
    if options.board and kind == "sit-to-stand":
        rng = streams(options.seed)["board"]
        board = draw_board(rng, options.clock_offset)
        more["board"] = board.as_dict()
        contents["board.csv"] = board_csv(rng, trial.scene, board).encode()
    if options.imus and kind == "sit-to-stand":
        person = None if options.subject is None else options.subject.seed
        sensors = sensors_in_plane(options.seed, trial.scene, trial.state, options.soft_tissue, person)
        more["imu"] = {segment: sensor.truth for segment, sensor in sensors.items()}
        contents |= {f"imu_{segment}.csv": csv_bytes(sensor) for segment, sensor in sensors.items()}
        files = ", ".join(f"{segment}: imu_{segment}.csv" for segment in sensors)
        contents["trial.yaml"] += f"imus: {{{files}}}\n".encode()
    return contents | {"truth.json": truth_json(kind, options, trial, more)}


def truth_json(
    kind: Kind, options: Options, trial: SimulatedTrial, more: Mapping[str, Any] = MappingProxyType({})
) -> bytes:
    """Return the content of ``truth.json``, with the entries of ``more`` added."""
    return json_bytes(document(kind, options, trial) | dict(more))


def json_bytes(document: Mapping[str, Any]) -> bytes:
    """Return the content of a JSON file."""
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()


def c3d_bytes(options: Options, trial: SimulatedTrial) -> bytes:
    """Return the content of the C3D file."""
    stated = 1 + options.faults.rate_error
    plates = [
        replace(plate, rate=plate.rate * stated)
        for plate in (trial.signals, trial.seat_signals)
        if plate is not None and not options.board
    ]
    return points_bytes(trial.labels, trial.points, options.rate * stated, plates)


def points_bytes(labels: Sequence[str], points: FloatArray, rate: float, plates: Sequence[PlateSignals] = ()) -> bytes:
    """Return the content of a C3D file with the points (F, M, 3), m; other parameters as for :func:`write_c3d`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.c3d"
        write_c3d(path, labels, points, rate, plates=plates)
        return path.read_bytes()


def truth_npz(trial: SimulatedTrial) -> bytes:
    """Return the content of ``truth.npz``."""
    return npz_bytes(arrays(trial))


def npz_bytes(values: Mapping[str, np.ndarray[Any, Any]]) -> bytes:
    """Return the content of a compressed NumPy archive."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **values)  # type: ignore[arg-type]
    return stream.getvalue()
