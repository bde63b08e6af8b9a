"""Synthetic recordings: a C3D builder that can set every field, and plates with a known wrench."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.recording.lab_plates import PlateSignals, compute_plate_axes

CORNERS = np.array([[0.232, -0.254, 0.0], [-0.232, -0.254, 0.0], [-0.232, 0.254, 0.0], [0.232, 0.254, 0.0]])
"""Corners of a plate at the lab's origin with z down, m."""

ORIGIN = np.array([0.001, -0.002, -0.045])


def moved_corners(yaw: float = 0.4, centre: Sequence[float] = (0.5, -0.2, 0.01)) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return CORNERS @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + np.asarray(centre)


def standing_wrench(count: int, corners: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return force and moment (K, 3) about the lab origin of a load of about 700 N within the plate."""
    rng = np.random.default_rng(seed)
    force = rng.normal(size=(count, 3)) * [20, 20, 40] + [0, 0, 700]
    point = corners.mean(axis=0) + np.column_stack([rng.uniform(-0.1, 0.1, (count, 2)), np.zeros(count)])
    free = np.column_stack([np.zeros((count, 2)), rng.normal(size=count) * 5])
    return force, np.cross(point, force) + free


def signals(
    force: np.ndarray, moment: np.ndarray, corners: np.ndarray, rate: float, origin: np.ndarray = ORIGIN
) -> PlateSignals:
    """Return the channels of a type 2 plate under a wrench on the body (lab axes, about the lab origin)."""
    axes = compute_plate_axes(corners)
    f = force @ axes
    m = (moment - np.cross(corners.mean(axis=0), force)) @ axes + np.cross(origin, f)
    return PlateSignals(2, np.concatenate([f, m], axis=1), origin, corners, rate)


def body(frames: int = 60, markers: int = 5, seed: int = 1) -> np.ndarray:
    """Return marker positions (F, M, 3) above the floor, m."""
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(0.1, 1.5, size=(1, markers, 3)) + 0.05 * rng.normal(size=(frames, markers, 3)).cumsum(axis=0) / 10
    )


def integers(values: Any, processor: int = 84) -> bytes:
    """Encode 16-bit words for a processor: Intel (84), DEC (85), MIPS (86)."""
    return (np.asarray(values).astype(np.int64) & 0xFFFF).astype(">u2" if processor == 86 else "<u2").tobytes()


def reals(values: Any, processor: int = 84) -> bytes:
    """Encode 32-bit floats for a processor; DEC swaps the words and has an exponent larger by two."""
    if processor == 85:
        return (4 * np.asarray(values, float)).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1].tobytes()
    return np.asarray(values).astype(">f4" if processor == 86 else "<f4").tobytes()


def parameter(
    group: int, name: str, value: Any, kind: int | None = None, processor: int = 84
) -> tuple[int, str, bytes]:
    """Encode a C3D parameter after its offset word: int16, float or text, first index fastest."""
    if isinstance(value, (str, tuple, list)) and (isinstance(value, str) or all(isinstance(v, str) for v in value)):
        texts = [value] if isinstance(value, str) else list(value)
        width = max((len(t.encode()) for t in texts), default=0)
        shape = (width,) if isinstance(value, str) else (width, len(texts))
        raw, kind = b"".join(t.encode().ljust(width) for t in texts), -1
    else:
        array = np.asarray(value)
        kind = kind or (2 if array.dtype.kind in "iu" else 4)
        shape = array.shape
        flat = array.ravel(order="F")
        raw = flat.astype("i1").tobytes() if kind == 1 else {2: integers, 4: reals}[kind](flat, processor)
    return group, name, struct.pack("bB", kind, len(shape)) + bytes(shape) + raw + b"\0"


def build_c3d(
    points: np.ndarray,
    *,
    residuals: np.ndarray | None = None,
    analog: np.ndarray | None = None,
    parameters: Mapping[str, Any] | None = None,
    header: Mapping[str, int] | None = None,
    rate: float = 100.0,
    first: int = 1,
    scale: float = -1.0,
    drop: Sequence[str] = (),
    processor: int = 84,
) -> bytes:
    """Build a C3D file; real for a negative scale, integer otherwise.

    ``points`` (F, M, 3) in file units, ``analog`` (F * per_frame, C) raw counts, ``parameters`` overrides by
    ``"GROUP:NAME"``, ``header`` overrides by word (points, analog, first, last, per_frame).
    """
    frames, markers = points.shape[:2]
    channels = 0 if analog is None else analog.shape[1]
    per_frame = 0 if analog is None else len(analog) // frames
    values: dict[str, Any] = {
        "POINT:USED": markers,
        "POINT:FRAMES": min(frames, 65535) - (65536 if min(frames, 65535) > 32767 else 0),
        "POINT:SCALE": float(scale),
        "POINT:RATE": float(rate),
        "POINT:UNITS": "mm",
        "POINT:LABELS": [f"M{i}" for i in range(markers)],
        "ANALOG:USED": channels,
        "ANALOG:RATE": float(rate * per_frame),
        "ANALOG:GEN_SCALE": 1.0,
        "ANALOG:SCALE": np.ones(channels),
        "ANALOG:OFFSET": np.zeros(channels, int),
        **(parameters or {}),
    }
    names = list(dict.fromkeys(key.split(":")[0] for key in values))
    blocks = b""
    for number, name in enumerate(names, start=1):
        blocks += struct.pack("bb", len(name), -number) + name.encode() + integers([3], processor) + b"\0"
    for key, value in values.items():
        if key in drop:
            continue
        group, name = key.split(":")
        _, _, body_ = parameter(names.index(group) + 1, name, value, processor=processor)
        blocks += struct.pack("bb", len(name), names.index(group) + 1) + name.encode()
        blocks += integers([len(body_) + 2], processor) + body_
    blocks += b"\0\0"
    count = -(-(len(blocks) + 4) // 512)
    words = {
        "points": markers,
        "analog": channels * per_frame,
        "first": first,
        "last": min(first + frames - 1, 65535),
        "per_frame": per_frame,
        **(header or {}),
    }
    head = bytes([2, 0x50])
    head += integers([words["points"], words["analog"], words["first"], words["last"], 10], processor)
    head += reals([scale], processor) + integers([2 + count, words["per_frame"]], processor) + reals([rate], processor)
    section = (struct.pack("BBBB", 1, 0x50, count, processor) + blocks).ljust(512 * count, b"\0")
    data = _data(points, residuals, analog, scale, processor)
    return head.ljust(512, b"\0") + section + data.ljust(-(-len(data) // 512) * 512, b"\0")


def _data(
    points: np.ndarray, residuals: np.ndarray | None, analog: np.ndarray | None, scale: float, processor: int
) -> bytes:
    frames, markers = points.shape[:2]
    residuals = np.zeros((frames, markers)) if residuals is None else residuals
    stored = np.concatenate([points if scale < 0 else np.round(points / scale), residuals[..., None]], axis=2)
    rows = stored.reshape(frames, -1)
    if analog is not None:
        rows = np.concatenate([rows, analog.reshape(frames, -1)], axis=1)
    return reals(rows, processor) if scale < 0 else integers(rows, processor)


def plate_parameters(kind: int, channels: Sequence[int], origin: np.ndarray = ORIGIN, **more: Any) -> dict[str, Any]:
    """Return FORCE_PLATFORM parameters of one plate at the lab's origin, in mm."""
    return {
        "FORCE_PLATFORM:USED": 1,
        "FORCE_PLATFORM:TYPE": np.array([kind]),
        "FORCE_PLATFORM:ZERO": np.array([0, 0]),
        "FORCE_PLATFORM:CORNERS": (CORNERS.T * 1e3)[:, :, None],
        "FORCE_PLATFORM:ORIGIN": (origin * 1e3)[:, None],
        "FORCE_PLATFORM:CHANNEL": np.array(channels)[:, None],
        **{f"FORCE_PLATFORM:{name}": value for name, value in more.items()},
    }


def save(folder: Path, data: bytes, name: str = "trial.c3d") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path
