"""Reader of markers in a text file (TRC, or an export of QTM, Motive or Nexus), alone or with forces in a MOT file."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.axes import nearest_axis, to_z_up
from mocap_id.recording.channel_units import ForceUnits
from mocap_id.recording.labels import name_markers
from mocap_id.recording.marker_positions import clean, resolve_length_unit, turn_z_up
from mocap_id.recording.marker_table import MarkerTable
from mocap_id.recording.model import Plate, Recording
from mocap_id.recording.mot_plates import ForceColumns, find_forces, mot_plates
from mocap_id.recording.text_tables import MotionTable, read_table, read_text
from mocap_id.recording.trc_table import parse_trc
from mocap_id.recording.vendor_tables import NEXUS_SECTIONS, parse_motive, parse_nexus, parse_qtm

Parser = Callable[[Path, str, list[str]], MarkerTable]

HEAD_BYTES = 4096
"""Bytes from the start of a file that show its format."""

_QTM = re.compile(rb"(FILE_VERSION|NO_OF_FRAMES|NO_OF_CAMERAS|NO_OF_MARKERS)\t")


def find_parser(head: bytes) -> Parser | None:
    """Return the parser of a text file with markers from its first bytes; None if it has another format."""
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip(b"\r\n")
    line = re.split(b"[\r\n]", start, maxsplit=1)[0]
    if b"pathfiletype" in line[:200].lower():
        return parse_trc
    if _QTM.match(start):
        return parse_qtm
    if line.lower().startswith(b"format version,"):
        return parse_motive
    if line.decode("latin-1").strip(",;\t ").lower() in NEXUS_SECTIONS:
        return parse_nexus
    return None


def read_text_markers(
    path: Path,
    parse: Parser,
    forces: Path | None,
    *,
    units: str | None,
    vertical: str | None,
    force_units: ForceUnits,
    unit_required: bool,
) -> Recording:
    """Read a text file with markers and its MOT file, if any; see :func:`mocap_id.recording.read`."""
    oddities: list[str] = []
    source = parse(path, read_text(path), oddities)
    unit, metres = resolve_length_unit(path, source.units, units, oddities, required=unit_required)
    naming = name_markers(source.labels, source.outputs)
    oddities += naming.oddities
    positions = source.positions[:, list(naming.keep)] * metres
    clean(path, positions, unit, oddities)
    table = None if forces is None else read_table(forces)
    columns = [] if table is None or forces is None else find_forces(forces, table)
    up = _vertical(source, table, columns, vertical, oddities)
    turn = to_z_up(up)
    turn_z_up(positions, up)
    plates: tuple[Plate, ...] = ()
    if table is not None and forces is not None:
        oddities += [f"{forces.name}: {note}" for note in table.notes]
        plates = mot_plates(forces, table, columns, oddities, turn=turn, units=force_units)
        _compare_spans(path, forces, source.time, table.time, oddities)
    return Recording(
        files=(path,) if forces is None else (path, forces),
        format=source.format if forces is None else f"{source.format} + MOT",
        labels=naming.labels,
        positions=positions,
        frames=source.frames,
        time=source.time,
        rate=source.rate,
        units=unit,
        vertical=up,
        analog_rate=plates[0].rate if plates else None,
        plates=plates,
        oddities=tuple(oddities),
    )


def _vertical(
    source: MarkerTable,
    table: MotionTable | None,
    columns: list[ForceColumns],
    override: str | None,
    oddities: list[str],
) -> str:
    """Return the upward axis: configured, or along the mean ground force, or as usual for the format."""
    found = None
    if table is not None and columns:
        total = sum((np.nan_to_num(table.values[:, list(each.force)]) for each in columns), np.zeros((1, 3)))
        axis = nearest_axis(np.mean(total, axis=0), 0.9)
        found = None if axis is None else axis.lstrip("-")
    if override is not None:
        if found is not None and found != override.lstrip("-"):
            oddities.append(
                f"the ground force acts along {found}, the configuration says {override} is up: {override} was used"
            )
        return override
    if found is not None:
        return found
    oddities.append(
        f"the files do not say which axis is up: {source.up} was assumed, as in {source.usual} (if it is another, set "
        "`vertical:`)"
    )
    return source.up


def _compare_spans(markers: Path, forces: Path, a: FloatArray, b: FloatArray, oddities: list[str]) -> None:
    """Note a different time span of two files, which share a clock; refuse files that do not overlap."""
    spans = f"{markers.name} runs from {a[0]:g} to {a[-1]:g} s, {forces.name} from {b[0]:g} to {b[-1]:g} s"
    if b[-1] < a[0] or b[0] > a[-1]:
        raise RecordingError(f"{spans}: they do not overlap, so they are of different trials or on different clocks")
    step = max((a[-1] - a[0]) / (len(a) - 1), (b[-1] - b[0]) / (len(b) - 1))
    if abs(a[0] - b[0]) > 1.5 * step or abs(a[-1] - b[-1]) > 1.5 * step:
        oddities.append(f"{spans}: forces are missing outside the common part")
