"""Reader of C3D files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording.c3d_file import PROCESSORS, C3DFile, decode_frames, find_layout, open_c3d
from mocap_id.recording.c3d_plates import StoredPlate, list_plate_channels, read_stored_plates
from mocap_id.recording.lab_plates import place_plate
from mocap_id.recording.labels import leave_out_objects, name_markers
from mocap_id.recording.marker_positions import (
    ReadingOptions,
    clean_positions,
    resolve_length_unit,
    rotate_z_up,
    thin_frames,
)
from mocap_id.recording.model import Recording, axis_vector, nearest_axis, parse_axis, to_z_up
from mocap_id.recording.plate_types import compute_plate_axes

_OUTPUT_GROUPS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS", "VIRTUAL_MARKERS")
"""POINT parameters that list computed trajectories, not markers; POINT:TYPE_GROUPS may name more."""

_BELOW_M = 0.2  # if the markers are this far below a plate, its corners are in the wrong order


def read_c3d(path: Path, stream: BinaryIO, options: ReadingOptions) -> Recording:
    """Read an open C3D file; parameters and errors as for :func:`mocap_id.recording.read`."""
    file = open_c3d(path, stream)
    layout = find_layout(file)
    oddities = list(layout.oddities)
    declared, required = file.text("POINT:UNITS"), options.unit_required
    unit, metres = resolve_length_unit(path, declared, options.units, oddities, required=required)
    names = [*file.strings("SUBJECTS:NAMES"), *file.strings("SUBJECTS:LABEL_PREFIXES")]
    subjects = [name.strip() for name in names if name.strip()]
    labels = [label for name in file.parts("POINT:LABELS") for label in file.strings(name)]  # LABELS2 and so on
    labels = [*labels[: layout.points], *[""] * (layout.points - len(labels))]
    naming = name_markers(labels, _read_outputs(file), subjects)
    positions, counts = decode_frames(file, layout, naming.keep, list_plate_channels(file, layout), metres)
    clean_positions(path, positions, unit, oddities)
    naming, positions = leave_out_objects(naming, positions)
    oddities += naming.oddities
    stem = path.stem.casefold()
    if any(len(name) > 2 and name.strip(":_-. ").casefold() in stem for name in subjects):
        oddities.append(
            "the file name contains the name of a subject from its header, and outputs show the file name: rename the "
            "file to a pseudonym"
        )
    stored = read_stored_plates(file, layout, counts, metres, options.force_units)
    del counts  # large in a long recording
    up = _find_vertical(file, stored, positions, options.vertical, oddities)
    rotate_z_up(positions, up)
    frames = layout.first + np.arange(layout.frames)
    time = (frames - min(layout.first, 1)) / layout.rate
    start, rotation = float(time[0]), to_z_up(up)
    plates = tuple(place_plate(plate, rotation, start, layout.per_frame * layout.rate, oddities) for plate in stored)
    return Recording(
        files=(path,),
        format=f"C3D ({PROCESSORS[file.processor]}, {'real' if layout.real else 'integer'})",
        labels=naming.labels,
        positions=positions,
        frames=frames.astype(np.int64),
        time=time,
        rate=layout.rate,
        units=unit,
        vertical=up,
        analog_rate=layout.per_frame * layout.rate if layout.channels else None,
        plates=plates,
        oddities=tuple(oddities),
        left_out=naming.left_out,
        people=naming.people,
    )


def _read_outputs(file: C3DFile) -> list[str]:
    """Return the labels of points that the file declares as computed, not measured."""
    types = file.strings("POINT:TYPE_GROUPS")
    groups = [*_OUTPUT_GROUPS, *(name.strip().upper() for name in types[::2])]
    labels = [
        label.strip()
        for group in dict.fromkeys(groups)
        if group != "LABELS"
        for name in file.parts(f"POINT:{group}")
        for label in file.strings(name)
    ]
    return [label for label in labels if label]


def _find_vertical(
    file: C3DFile, stored: Sequence[StoredPlate], positions: FloatArray, override: str | None, oddities: list[str]
) -> str:
    """Return the upward axis: ``override``, else the normal of the plates, else POINT:Y_SCREEN, else Z (assumed)."""
    declared = parse_axis(file.text("POINT:Y_SCREEN"))
    normal = _find_plates_normal(stored, positions)
    if override is not None:
        for axis, source in ((normal, "the force plates say"), (declared, "POINT:Y_SCREEN says")):
            if axis is not None and axis != override:
                oddities.append(f"{source} that {axis} is up, the configuration says {override}: {override} was used")
        return override
    if normal is not None:
        if declared is not None and declared != normal:
            oddities.append(f"POINT:Y_SCREEN says {declared} is up, the force plates say {normal}: {normal} was used")
        return normal
    if declared is not None:
        return declared
    oddities.append("the file does not say which axis is up: Z was assumed (if it is another, set `vertical:`)")
    return "Z"


def _find_plates_normal(stored: Sequence[StoredPlate], positions: FloatArray) -> str | None:
    """Return the axis normal to all usable plates that points towards the markers; None if there is none."""
    axes = set()
    for plate in stored:
        if plate.signals is None:
            continue
        down = compute_plate_axes(plate.signals.corners)[:, 2]
        axis = nearest_axis(-down) if np.isfinite(down).all() else None
        if axis is None:
            return None
        height = (thin_frames(positions) - plate.signals.corners.mean(axis=0)) @ axis_vector(axis)
        below = bool(np.isfinite(height).any()) and np.nanmedian(height) < -_BELOW_M
        axes.add(axis if not below else axis.removeprefix("-") if axis.startswith("-") else f"-{axis}")
    return axes.pop() if len(axes) == 1 else None
