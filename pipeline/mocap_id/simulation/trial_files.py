"""Simulated trials on disk: recording, truth, and a configuration that is ready to run."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, StoreError
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.recording.writer import write_c3d
from mocap_id.simulation.inertial_sensors import csv_bytes, simulate_plane_sensors
from mocap_id.simulation.joint_motion import JointMotion
from mocap_id.simulation.log_sensors import board_csv, draw_board, draw_encoder, encoder_csv, joint_sensor_csv
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.scene import random_streams
from mocap_id.simulation.simulated_trial import SimulatedTrial, generate
from mocap_id.simulation.truth import arrays, document
from mocap_id.simulation.yaml_files import trial_yaml
from mocap_id.store.atomic import converting_errors, write_files


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
