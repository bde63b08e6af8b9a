"""Reader of recordings in any supported format."""

from __future__ import annotations

from pathlib import Path

from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.axes import check_axis
from mocap_id.recording.c3d_reader import read_c3d
from mocap_id.recording.channel_units import ForceUnits
from mocap_id.recording.ktk_file import MAGIC, read_ktk
from mocap_id.recording.model import Recording
from mocap_id.recording.text_reader import HEAD_BYTES, Parser, find_parser, read_text_markers
from mocap_id.recording.text_tables import open_recording
from mocap_id.recording.trc_table import parse_trc

_TABLES = (".mot", ".sto")
_TEXTS = (".tsv", ".csv", ".txt")


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
        ``units`` is empty: the recording shows what the file contains, but nothing can be computed from it.

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
    plate_units = ForceUnits(force_unit, moment_unit)
    markers, forces = Path(markers), None if forces is None else Path(forces)
    _check_kinds(markers, forces)
    with open_recording(markers) as stream:
        start = stream.read(HEAD_BYTES)
        parse = None if start.startswith(MAGIC) else _choose_parser(markers, start)
        if parse is None:
            if forces is not None:
                raise ConfigError(f"{forces}: {markers} contains its own force plates; `forces` belongs to a TRC file")
            read_binary = read_ktk if start.startswith(MAGIC) else read_c3d
            return read_binary(markers, stream, units, axis, plate_units, unit_required=unit_required)
    return read_text_markers(
        markers, parse, forces, units=units, vertical=axis, force_units=plate_units, unit_required=unit_required
    )


def is_marker_text(path: Path) -> bool:
    """Return whether a text file contains markers in a supported format; RecordingError if it cannot be read."""
    with open_recording(path) as stream:
        return find_parser(stream.read(HEAD_BYTES)) is not None


def _choose_parser(path: Path, start: bytes) -> Parser | None:
    """Return the parser of a text file from its first bytes; None for a C3D file."""
    parse = find_parser(start)
    if parse is None and path.suffix.lower() == ".trc":
        return parse_trc  # its error says what is wrong
    if parse is None and path.suffix.lower() in _TEXTS:
        raise RecordingError(
            f"{path}: neither a QTM TSV, Motive CSV nor Nexus CSV export with its header; export it again with the "
            "header, or as C3D or TRC. The skeleton log of a depth camera goes into `recording: {skeleton: FILE}`"
        )
    return parse


def _check_kinds(markers: Path, forces: Path | None) -> None:
    """Raise ConfigError if the file names show that a file is under the wrong key."""
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
