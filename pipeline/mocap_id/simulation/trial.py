"""A simulated trial on disk: recording, truth and a configuration that is ready to run."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import numpy as np

from mocap_id.errors import ConfigError, StoreError
from mocap_id.recording.writing import write_c3d
from mocap_id.simulation.configuration import configuration
from mocap_id.simulation.encoder import draw_encoder, table
from mocap_id.simulation.generate import Simulated, generate
from mocap_id.simulation.motion import Motion
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.scene import streams
from mocap_id.simulation.truth import arrays, document
from mocap_id.store.atomic import explained, replace_together


def simulate(kind: Kind, folder: Path, options: Options, given: Motion | None = None) -> Path:
    """Make a trial with exact truth and write it.

    Parameters
    ----------
    kind : {"sit-to-stand", "robot"}
    folder : Path
        Made with its parents; gets ``trial.c3d``, ``truth.json``, ``truth.npz``, ``trial.yaml`` and, for the robot,
        ``encoder.csv``. Its name becomes the trial's.
    options : Options
    given : Motion, optional
        What the body of that kind does, in place of what it would; without a chair.

    Returns
    -------
    Path
        ``trial.yaml``.

    Raises
    ------
    ConfigError
        There is no such kind.
    StoreError
        The folder already holds a trial, or cannot be written.
    """
    if kind not in get_args(Kind):
        raise ConfigError(f"simulate: there is no kind {kind!r}; expected one of {', '.join(get_args(Kind))}")
    if (folder / "trial.c3d").exists():
        raise StoreError(f"{folder} already holds a trial: remove it or choose another folder")
    contents = _contents(kind, folder.resolve().name, options, generate(kind, options, given))
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    replace_together(folder, contents)
    return folder / "trial.yaml"


def _contents(kind: Kind, name: str, options: Options, made: Simulated) -> dict[str, bytes]:
    more: dict[str, Any] = {}
    contents = {
        "trial.c3d": recording(options, made),
        "truth.npz": packed(made),
        "trial.yaml": configuration(kind, name, options, made.scene).encode(),
    }
    if kind == "robot":
        rng = streams(options.seed)["encoder"]
        encoder = draw_encoder(rng)
        more["encoder"] = encoder.as_dict()
        contents["encoder.csv"] = table(rng, made.scene, encoder).encode()
    return contents | {"truth.json": told(kind, options, made, more)}


def told(kind: Kind, options: Options, made: Simulated, more: Mapping[str, Any] = MappingProxyType({})) -> bytes:
    """Content of ``truth.json``; ``more`` is added to it."""
    truth = document(kind, options, made) | dict(more)
    return (json.dumps(truth, indent=1, ensure_ascii=False) + "\n").encode()


def recording(options: Options, made: Simulated) -> bytes:
    """Content of the C3D file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.c3d"
        plates = (made.signals,) if made.seat_signals is None else (made.signals, made.seat_signals)
        write_c3d(path, made.scene.markers.labels, made.points, options.rate, plates=plates)
        return path.read_bytes()


def packed(made: Simulated) -> bytes:
    """Content of ``truth.npz``."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays(made))  # type: ignore[arg-type]
    return stream.getvalue()
