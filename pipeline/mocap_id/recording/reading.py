"""The one way in: a recording on disk → a Recording."""

from __future__ import annotations

from pathlib import Path

from mocap_id.errors import ConfigError
from mocap_id.recording.axes import parse_axis
from mocap_id.recording.c3d_reader import read_c3d
from mocap_id.recording.channel_units import ForceUnits
from mocap_id.recording.model import Recording
from mocap_id.recording.tables import opened
from mocap_id.recording.trc_reader import read_trc

_TABLES = (".mot", ".sto")


def read(
    markers: Path,
    forces: Path | None = None,
    *,
    units: str | None = None,
    vertical: str | None = None,
    force_unit: str | None = None,
    moment_unit: str | None = None,
) -> Recording:
    """Read one trial; the files are opened for reading only.

    Parameters
    ----------
    markers : Path
        C3D file, or TRC file with the markers.
    forces : Path, optional
        MOT file with the ground's forces, beside a TRC file.
    units : str, optional
        Length unit of the markers, where the file does not declare it or declares it wrong.
    vertical : str, optional
        The file's axis that points up (``"X"``, ``"Y"``, ``"Z"``, with a minus where it points down); found from the
        force plates or the file where not given.
    force_unit, moment_unit : str, optional
        Units of the force plates' channels, where the file does not declare them or declares them wrong (``"N"``,
        ``"Nmm"``). Plates of type 4 have theirs by their calibration matrix.

    Returns
    -------
    Recording
        SI, lab axes with Z up, missing as NaN; what was repaired, left out or assumed stands in ``oddities``.

    Raises
    ------
    RecordingError
        A file is missing, unreadable, truncated, of unknown units, without markers, or contradicts itself.
    ConfigError
        ``units``, ``force_unit`` or ``moment_unit`` is no such unit, ``vertical`` is no axis, ``forces`` stands
        beside a C3D file, or a file is of a kind that the other one should be.
    """
    axis = None if vertical is None else parse_axis(vertical)
    if vertical is not None and axis is None:
        raise ConfigError(f"vertical: {vertical!r} is no axis; expected X, Y or Z, with a minus where it points down")
    plate_units = ForceUnits(force_unit, moment_unit)
    markers = Path(markers)
    _check_kinds(markers, None if forces is None else Path(forces))
    if markers.suffix.lower() == ".trc":
        return read_trc(markers, None if forces is None else Path(forces), units, axis, plate_units)
    with opened(markers) as stream:
        if stream.read(12).lower() != b"pathfiletype":
            if forces is not None:
                raise ConfigError(f"{forces}: a C3D file holds its own force plates; `forces` belongs to a TRC file")
            return read_c3d(markers, stream, units, axis, plate_units)
    return read_trc(markers, None if forces is None else Path(forces), units, axis, plate_units)


def _check_kinds(markers: Path, forces: Path | None) -> None:
    """Files that stand under each other's key, by their names, before either is misread as the other."""
    if markers.suffix.lower() in _TABLES:
        if forces is not None and forces.suffix.lower() not in _TABLES:
            raise ConfigError(
                f"{markers} stands under `markers` and {forces.name} under `forces`: exchange them, "
                f"`recording: {{markers: {forces.name}, forces: {markers.name}}}`"
            )
        raise ConfigError(
            f"{markers}: a MOT or STO file holds no markers: give the C3D or TRC file, "
            f"`recording: {{markers: trial.trc, forces: {markers.name}}}`"
        )
    if forces is not None and markers.suffix.lower() == ".trc" and forces.suffix.lower() in (".trc", ".c3d"):
        raise ConfigError(f"{forces}: `forces` is for a MOT file; a C3D file stands alone, `recording: trial.c3d`")
