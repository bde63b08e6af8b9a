"""Reader of markers in a text file (TRC, or an export of QTM, Motive or Nexus), alone or with forces in a MOT file."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.channel_units import ForceUnits
from mocap_id.recording.marker_table import MarkerTable, assemble_recording
from mocap_id.recording.model import Recording
from mocap_id.recording.mot_plates import find_force_columns, read_mot_plates
from mocap_id.recording.text_tables import read_table, read_text
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
    """Read a text file with markers and its MOT file, if any; parameters as for :func:`mocap_id.recording.read`."""
    oddities: list[str] = []
    markers = parse(path, read_text(path), oddities)
    options: dict[str, Any] = {"units": units, "vertical": vertical, "unit_required": unit_required}
    if forces is None:
        return assemble_recording(path, markers, None, oddities, **options)[0]
    table = read_table(forces)
    columns = find_force_columns(forces, table)
    force = sum((np.nan_to_num(table.values[:, list(each.force)]) for each in columns), np.zeros((1, 3))).mean(axis=0)
    recording, rotation = assemble_recording(path, markers, force, oddities, **options)
    oddities += [f"{forces.name}: {note}" for note in table.notes]
    plates = read_mot_plates(forces, table, columns, oddities, rotation=rotation, units=force_units)
    _compare_spans(path, forces, markers.time, table.time, oddities)
    return replace(
        recording,
        files=(path, forces),
        format=f"{markers.format} + MOT",
        analog_rate=plates[0].rate,
        plates=plates,
        oddities=tuple(oddities),
    )


def _compare_spans(markers: Path, forces: Path, a: FloatArray, b: FloatArray, oddities: list[str]) -> None:
    """Add a note if two files, which share a clock, have different time spans; refuse files that do not overlap."""
    spans = f"{markers.name} runs from {a[0]:g} to {a[-1]:g} s, {forces.name} from {b[0]:g} to {b[-1]:g} s"
    if b[-1] < a[0] or b[0] > a[-1]:
        raise RecordingError(f"{spans}: they do not overlap, so they are of different trials or on different clocks")
    step = max((a[-1] - a[0]) / (len(a) - 1), (b[-1] - b[0]) / (len(b) - 1))
    if abs(a[0] - b[0]) > 1.5 * step or abs(a[-1] - b[-1]) > 1.5 * step:
        oddities.append(f"{spans}: forces are missing outside the common part")
