"""Reader of recordings in any supported format."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, find_runs
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.c3d_reader import read_c3d
from mocap_id.recording.ktk_file import MAGIC, read_ktk
from mocap_id.recording.marker_tables import (
    NEXUS_SECTIONS,
    MarkerTable,
    parse_motive,
    parse_nexus,
    parse_qtm,
    parse_trc,
)
from mocap_id.recording.markers import assemble_recording, thin_frames
from mocap_id.recording.model import SCALES, Plate, ReadingOptions, Recording, check_axis, nearest_axis, to_z_up
from mocap_id.recording.sample_checks import HeldSamples, find_held, list_held
from mocap_id.recording.sensor_logs import find_force_columns, read_mot_plates
from mocap_id.recording.text_tables import check_encoding, open_recording, read_table, read_text

_TABLES = (".mot", ".sto")
_TEXTS = (".tsv", ".csv", ".txt")


Parser = Callable[[Path, str, list[str]], MarkerTable]

_WITH_PRESSURE = ("mot", "type 1")  # plates whose moment is not linear in their channels
_UNLOADED_N = 20.0
_UPRIGHT = 1.3  # least ratio of height and width of the markers of a person who stands and sits
_MANY_MARKERS = 6  # least number of markers that show how a person stands
_BESIDE_M = 0.4  # distance of the middle of the markers from the centre of pressure that no such person has

_HEAD_BYTES = 4096
"""Number of bytes at the start of a file from which its format is recognised."""

_QTM = re.compile(rb"(FILE_VERSION|NO_OF_FRAMES|NO_OF_CAMERAS|NO_OF_MARKERS)\t")


def read(
    markers: Path | str,
    forces: Path | str | None = None,
    *,
    units: str | None = None,
    vertical: str | None = None,
    force_unit: str | None = None,
    moment_unit: str | None = None,
    unit_required: bool = True,
) -> Recording:
    """Read one trial. The files are opened read-only.

    Parameters
    ----------
    markers : Path
        C3D, TRC, a text export of QTM (TSV), Motive or Nexus (CSV), or ``.ktk.zip`` of Kinetics Toolkit.
    forces : Path, optional
        MOT file with the ground forces; not with a C3D file.
    units : str, optional
        Length unit of the markers, if the unit in the file is missing or wrong.
    vertical : str, optional
        Axis of the file that points up (``"X"``, ``"Y"``, ``"Z"``; with a minus if it points down). If omitted, it is
        determined from the force plates or the file.
    force_unit, moment_unit : str, optional
        Units of the force-plate channels (such as ``"N"``, ``"Nmm"``), if the units in the file are missing or wrong.
        They do not apply to plates of type 4, whose calibration matrix defines the units.
    unit_required : bool
        Whether a file without a length unit is refused. If it is not refused, its lengths are read as millimetres and
        ``units`` is empty: the recording contains what is in the file, but nothing can be computed from it.

    Returns
    -------
    Recording
        SI units, lab axes with Z up, NaN if missing. ``oddities`` lists repairs, omissions and assumptions.

    Raises
    ------
    RecordingError
        A file is missing, unreadable, truncated, without units or markers, or contradicts itself.
    ConfigError
        A unit or an axis is unknown, or the two files are exchanged or of the wrong format.
    """
    axis = None if vertical is None else check_axis(vertical)
    force_units = {what: unit for what, unit in (("force", force_unit), ("moment", moment_unit)) if unit is not None}
    for what, unit in force_units.items():
        if SCALES[what](unit) is None:
            known = "N, kN, mN or lbf" if what == "force" else "Nm, Nmm or ft.lbf"
            raise ConfigError(f"{what}_unit: {unit!r} is not a unit of {what}; expected a unit such as {known}")
    options = ReadingOptions(units, axis, force_units, unit_required)
    markers, forces = Path(markers), None if forces is None else Path(forces)
    # The endings of the file names show whether a file is under the wrong key.
    if markers.suffix.lower() in _TABLES:
        if forces is not None and forces.suffix.lower() not in _TABLES:
            raise ConfigError(
                f"{markers} is under `markers` and {forces.name} under `forces`: exchange them, "
                f"`recording: {{markers: {forces.name}, forces: {markers.name}}}`"
            )
        raise ConfigError(
            f"{markers}: a MOT or STO file contains no markers: give the C3D or TRC file, "
            f"`recording: {{markers: trial.trc, forces: {markers.name}}}`"
        )
    if forces is not None and markers.suffix.lower() == ".trc" and forces.suffix.lower() in (".trc", ".c3d"):
        raise ConfigError(f"{forces}: `forces` must be a MOT file; give a C3D file alone, `recording: trial.c3d`")
    with open_recording(markers) as stream:
        start = stream.read(_HEAD_BYTES)
        if start.startswith((b"\xff\xfe", b"\xfe\xff")):  # no binary format starts so
            check_encoding(markers, start)
        parse, suffix = None, markers.suffix.lower()
        if not start.startswith(MAGIC):
            parse = _find_parser(start)
            if parse is None and suffix == ".trc":
                parse = parse_trc  # its error says what is wrong
            elif parse is None and suffix in _TEXTS:
                check_encoding(markers, start)
                if _find_parser(start.replace(b";", b",")) is not None:
                    raise RecordingError(
                        f"{markers}: its cells are separated by semicolons (;): export it with commas and with "
                        "decimal points"
                    )
                raise RecordingError(
                    f"{markers}: neither a QTM TSV, Motive CSV nor Nexus CSV export with its header; export it again "
                    "with the header, or as C3D or TRC. The skeleton log of a depth camera goes into `recording: "
                    "{skeleton: FILE}`"
                )
        if parse is None:
            if forces is not None:
                raise ConfigError(
                    f"{forces}: `forces` is only for markers in a text file such as TRC, but {markers} is a binary "
                    "file with its own force plates; remove `forces`"
                )
            read_binary = read_ktk if start.startswith(MAGIC) else read_c3d
            return _leave_out_held(read_binary(markers, stream, options))
    return _leave_out_held(_read_text_markers(markers, parse, forces, options))


def _leave_out_held(recording: Recording) -> Recording:
    """Return the recording without repeated or interpolated samples of markers and plates.

    Frames that are repeated as a whole are left to the search for repeated frames, and a single marker that stands
    still to the search for bad samples, which a segment whose markers all stand still would mislead. A plate without
    load may repeat its samples, because software sets them to zero.
    """
    held: list[HeldSamples] = []
    seen, same = (np.zeros(len(recording.time), dtype=np.int64) for _ in range(2))
    for points in np.moveaxis(recording.positions, 1, 0):
        step = np.abs(np.diff(points, axis=0)).max(axis=1)
        seen[1:] += np.isfinite(step)
        same[1:] += step == 0.0
    several = (same >= 2) & (2 * same <= seen)
    for number, label in enumerate(recording.labels):
        repeated, straight = find_held(recording.positions[:, number], recording.rate)
        for run in find_runs(repeated):
            repeated[run] = 2 * np.count_nonzero(several[run]) > run.stop - run.start
        held += list_held(f"marker {label}", recording.time, repeated, straight)
        recording.positions[repeated | straight, number] = np.nan
    plates = []
    for plate in recording.plates:
        wrench = plate.force if plate.kind in _WITH_PRESSURE else np.hstack([plate.force, plate.moment])
        loaded = np.linalg.norm(np.nan_to_num(plate.force), axis=1) > _UNLOADED_N
        rows = [each & loaded for each in find_held(np.where(plate.ok[:, None], wrench, np.nan), plate.rate)]
        held += list_held(f"plate {plate.index}", plate.start + np.arange(len(plate.ok)) / plate.rate, *rows)
        plates.append(replace(plate, ok=plate.ok & ~rows[0] & ~rows[1]))
    return replace(recording, plates=tuple(plates), held=tuple(held)) if held else recording


def is_marker_text(path: Path) -> bool:
    """Return whether a text file contains markers in a supported format; RecordingError if it cannot be read."""
    with open_recording(path) as stream:
        return _find_parser(stream.read(_HEAD_BYTES)) is not None


def _find_parser(head: bytes) -> Parser | None:
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


def _read_text_markers(path: Path, parse: Parser, forces: Path | None, options: ReadingOptions) -> Recording:
    """Read a text file with markers and its MOT file, if any."""
    oddities: list[str] = []
    markers = parse(path, read_text(path), oddities)
    if forces is None:
        return assemble_recording(path, markers, None, options, oddities)[0]
    table = read_table(forces)
    columns = find_force_columns(forces, table)
    force = sum((np.nan_to_num(table.values[:, each["force"]]) for each in columns.values()), np.zeros((1, 3))).mean(
        axis=0
    )
    recording, rotation = assemble_recording(path, markers, force, options, oddities)
    oddities += [f"{forces.name}: {note}" for note in table.notes]
    plates = read_mot_plates(forces, table, columns, oddities, rotation=rotation, units=options.force_units)
    a, b = markers.time, table.time
    spans = f"{path.name} runs from {a[0]:g} to {a[-1]:g} s, {forces.name} from {b[0]:g} to {b[-1]:g} s"
    if b[-1] < a[0] or b[0] > a[-1]:
        raise RecordingError(f"{spans}: they do not overlap: they belong to different trials or have different clocks")
    step = max((a[-1] - a[0]) / (len(a) - 1), (b[-1] - b[0]) / (len(b) - 1))
    if abs(a[0] - b[0]) > 1.5 * step or abs(a[-1] - b[-1]) > 1.5 * step:
        oddities.append(f"{spans}: forces are missing outside the common part")
    _compare_axes(recording, plates, force, forces)
    return replace(
        recording,
        files=(path, forces),
        format=f"{markers.format} + MOT",
        analog_rate=plates[0].rate,
        plates=plates,
        oddities=tuple(oddities),
    )


def _compare_axes(recording: Recording, plates: Sequence[Plate], force: FloatArray, forces: Path) -> None:
    """Raise RecordingError if the markers stand along another axis than that of the mean ground force (3,).

    They are then not above the centre of pressure, but far beside it along the direction in which they extend most.
    """
    samples, wrench = len(plates[0].ok), np.zeros((2, len(plates[0].ok), 3))
    for plate in plates:
        if plate.usable and len(plate.ok) == samples:
            wrench += np.where(plate.ok[:, None], [plate.force, plate.moment], 0.0)
    loaded = wrench[0, :, 2] > 0.5 * np.percentile(wrench[0, :, 2], 95)
    seen = np.isfinite(recording.positions).all(axis=2).sum(axis=1) >= _MANY_MARKERS
    if not (loaded & (wrench[0, :, 2] > _UNLOADED_N)).any() or not seen.any():
        return
    under = np.median(wrench[1][loaded][:, [1, 0]] * [-1, 1] / wrench[0][loaded][:, 2:], axis=0)
    frames = thin_frames(recording.positions[seen])
    extents = np.median(np.nanmax(frames, axis=1) - np.nanmin(frames, axis=1), axis=0)
    beside = np.abs(np.nanmedian(frames, axis=(0, 1))[:2] - under)
    longest = int(np.argmax(extents))
    if longest < 2 and extents[longest] > _UPRIGHT * extents[2] and beside[longest] > _BESIDE_M:
        up, along = (nearest_axis(vector, 0.0) for vector in (force, to_z_up(recording.vertical).T[:, longest]))
        raise RecordingError(
            f"the ground force in {forces.name} acts along {str(up).lstrip('-')}, but the markers in "
            f"{recording.files[0].name} stand along {str(along).lstrip('-')}, {beside[longest]:.1f} m beside the "
            "force: the two files have different axes. Export both with the same axis up"
        )
