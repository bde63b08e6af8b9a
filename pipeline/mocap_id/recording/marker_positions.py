"""Marker positions in metres and lab axes, without impossible samples; conversion of tables of markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import RecordingError
from mocap_id.recording.clock import fit_even_clock
from mocap_id.recording.labels import leave_out_objects, name_markers
from mocap_id.recording.model import Recording, choose_vertical, to_z_up
from mocap_id.recording.units import LENGTHS, ForceUnits, check_length_unit, find_length_scale, strip_padding

_MAX_DISTANCE_M = 1000.0  # larger than any laboratory: such coordinates are invalid
_MIN_SPREAD_M, _MAX_SPREAD_M = 0.02, 100.0  # accepted spread of the markers of a trial, to check the unit
_MILLIMETRE = 1e-3
_APART_M = 1.0  # least distance of a code for missing samples from all real samples
_REPEATED = 10  # least number of samples at a code that is near real samples
_BLOCK = 1000  # number of frames to process at a time, which limits the memory needed


def resolve_length_unit(
    path: Path, declared: str, override: str | None, oddities: list[str], *, required: bool = True
) -> tuple[str, float]:
    """Return the length unit to use and its size in metres.

    ``declared`` is the unit in the file, possibly empty; ``override`` is the unit in the configuration, which has
    priority. If no unit is known and ``required`` is false, the unit is empty and lengths are read as millimetres. If
    ``required`` is true, RecordingError is raised. Raises ConfigError if ``override`` is not a unit of length.
    Contradictions are noted in ``oddities``.
    """
    name = strip_padding(declared)
    if override is not None:
        scale = check_length_unit(override)
        if find_length_scale(name) not in (None, scale):
            oddities.append(f"the file declares lengths in {name!r}, the configuration {override}: {override} was used")
        return override, scale
    own_scale = find_length_scale(name)
    if own_scale is None:
        found = f"the length unit {name!r}, which is ambiguous or unknown" if name else "no length unit"
        if not required:
            oddities.append(f"the file declares {found}: a run needs it, `planarise: {{units: mm}}` (or m, cm)")
            return "", _MILLIMETRE
        raise RecordingError(f"{path}: the file declares {found}; set `planarise: {{units: mm}}` (or m, cm)")
    if name.lower() not in LENGTHS:
        oddities.append(f"the length unit {name!r} is truncated: read as {'metres' if own_scale == 1 else name}")
    return name, own_scale


def thin_frames(positions: FloatArray) -> FloatArray:
    """Return 1000 to 2000 evenly spaced frames of positions (F, M, 3), or all frames if there are fewer."""
    return positions[:: max(1, len(positions) // _BLOCK)]


def rotate_z_up(positions: FloatArray, up: str) -> None:
    """Rotate positions (F, M, 3) in place, so that the file's axis ``up`` becomes Z."""
    rotation = to_z_up(up)
    for at in range(0, len(positions) if up != "Z" else 0, _BLOCK):
        positions[at : at + _BLOCK] = positions[at : at + _BLOCK] @ rotation.T


def clean_positions(path: Path, positions: FloatArray, units: str, oddities: list[str]) -> None:
    """Set impossible samples of positions (F, M, 3), m, to NaN in place, and check the space that the markers occupy.

    ``units`` is the length unit of the file; if it is empty, the size of this space is not checked, and a note gives it
    in mm, cm and m. All changes are noted in ``oddities``. Raises RecordingError if the size contradicts the unit.
    """
    _remove_codes(positions, oddities)
    _check_size(path, positions, units, oddities)
    parts = [positions[at : at + _BLOCK] for at in range(0, len(positions), _BLOCK)]
    marked = np.array([_mark_missing(part) for part in parts]).reshape(-1, 4).sum(axis=0)
    for count, what in zip(
        marked,
        ("are not finite", f"are farther than {_MAX_DISTANCE_M:.0f} m away", "are exactly 0, 0, 0"),
        strict=False,
    ):
        if count:
            oddities.append(f"{count} marker samples {what} and were set to missing")
    if not marked[3]:
        oddities.append(f"none of the {positions.shape[1]} markers is ever visible")


def _remove_codes(positions: FloatArray, oddities: list[str]) -> None:
    """Set samples that a number such as 9999 or −16512 marks as missing to NaN, in place.

    Such samples are exactly alike, and farther than a metre from all others. They are on several markers, or between
    other samples of one marker, or their three coordinates are the same number. A code may also be near real samples,
    such as 999.9 mm: its three coordinates are the same number, and at least ten samples of several markers have it.
    """
    flat = positions.reshape(-1, 3)
    if not len(flat):
        return
    extremes = [(axis, reduce.reduce(flat, axis=0)) for reduce in (np.fmin, np.fmax) for axis in range(3)]
    while extremes:
        axis, values = extremes.pop()
        chosen = positions[..., axis] == values[axis]
        alike, markers = positions[chosen], chosen.any(axis=0)
        if (
            len(alike) <= 1
            or not np.abs(values[axis]) <= _MAX_DISTANCE_M
            or not alike[0].any()
            or (alike != alike[0]).any()
        ):
            continue
        apart = True
        for at in range(0, len(positions), _BLOCK):  # a recording may be large
            distance = np.abs(positions[at : at + _BLOCK, :, axis] - values[axis])
            apart &= not (distance[~chosen[at : at + _BLOCK]] <= _APART_M).any()
        between = markers.sum() == 1 and (np.isfinite(positions[:, markers, axis]) & ~chosen[:, markers]).any()
        if apart and (markers.sum() > 1 or between or np.ptp(np.abs(alike[0])) == 0):
            positions[chosen] = np.nan
            code = ", ".join(f"{number:.6g}" for number in alike[0])
            oddities.append(
                f"{len(alike)} marker samples are at ({code}) m, far from all others: this number marks missing "
                "samples, and they were set to missing"
            )
            extremes = [(axis, reduce.reduce(flat, axis=0)) for reduce in (np.fmin, np.fmax) for axis in range(3)]
    found = []
    for at in range(0, len(positions), _BLOCK):
        x, y, z = np.moveaxis(np.abs(positions[at : at + _BLOCK]), 2, 0)
        frame, marker = np.nonzero((x == y) & (x == z) & (x > 0) & (x <= _MAX_DISTANCE_M))
        found.append(np.column_stack([frame + at, marker]))
    same = np.concatenate(found)
    numbers, which, counts = np.unique(
        positions[same[:, 0], same[:, 1]], axis=0, return_inverse=True, return_counts=True
    )
    for k in np.flatnonzero(counts >= _REPEATED):
        frame, marker = same[which == k].T
        if len(np.unique(marker)) > 1:
            positions[frame, marker] = np.nan
            code = ", ".join(f"{number:.6g}" for number in numbers[k])
            oddities.append(
                f"{len(frame)} samples of {len(np.unique(marker))} markers are exactly at ({code}) m: this number "
                "marks missing samples, and they were set to missing"
            )


def _mark_missing(positions: FloatArray) -> tuple[int, int, int, int]:
    """Set invalid samples to NaN in place; return the numbers of non-finite, too far, zero and valid samples."""
    x, y, z = np.abs(np.moveaxis(positions, 2, 0))
    largest = np.maximum(np.maximum(x, y), z)  # NaN if any coordinate is
    broken = ~np.isfinite(largest) & ~(np.isnan(x) & np.isnan(y) & np.isnan(z))
    far, zero = ~broken & (largest > _MAX_DISTANCE_M), largest == 0
    for flags in (broken, far, zero):
        if flags.any():
            positions[flags] = np.nan
    return int(broken.sum()), int(far.sum()), int(zero.sum()), int((largest <= _MAX_DISTANCE_M).sum() - zero.sum())


def _check_size(path: Path, positions: FloatArray, units: str, oddities: list[str]) -> None:
    """Raise RecordingError if all samples are within 2 cm, or the middle half of them spreads over more than 100 m."""
    frames = thin_frames(positions)
    visible = np.isfinite(frames).all(axis=2)
    if not visible.any():
        return
    samples = frames[visible]
    spread = float(np.linalg.norm(np.ptp(np.percentile(samples, [25, 75], axis=0), axis=0)))
    extent = float(np.linalg.norm(np.ptp(samples, axis=0)))
    several = int(visible.any(axis=0).sum()) >= 3
    if not units:
        written = spread / _MILLIMETRE
        choices = ", ".join(f"{name} gives {written * LENGTHS[name]:.3g} m" for name in ("mm", "cm", "m"))
        oddities.append(f"half of the marker samples spread over {written:.4g} in the unit of the file: {choices}")
        return
    if spread > _MAX_SPREAD_M or (several and 0 < extent < _MIN_SPREAD_M):
        size = spread if spread > _MAX_SPREAD_M else extent
        raw = size / (find_length_scale(units) or 1.0)
        sizes = {name: raw * LENGTHS[name] for name in ("mm", "cm", "m")}
        fits = ", ".join(
            f"{name} gives {at:.3g} m" for name, at in sizes.items() if _MIN_SPREAD_M <= at <= _MAX_SPREAD_M
        )
        raise RecordingError(
            f"{path}: the markers spread over {size:.3g} m when read in {units!r}, expected {_MIN_SPREAD_M} to "
            f"{_MAX_SPREAD_M:.0f} m; the unit is wrong, set `planarise: {{units: …}}`" + (f": {fits}" if fits else "")
        )


_MAX_FRAME_NUMBER = 1e15  # larger floats are not exact integers
_MAX_RATE_ERROR = 0.02  # a larger difference is not rounding (59.94 written as 60)


@dataclass(frozen=True)
class MarkerTable:
    """Marker trajectories in the units and axes of the file: F frames of M markers."""

    format: str  # name of the format, such as ``"TRC"`` or ``"Motive CSV"``
    labels: Sequence[str]  # M marker names as in the file
    frames: IntArray  # (F,) frame numbers in the file
    time: FloatArray  # (F,) times with a constant step, s
    positions: FloatArray  # (F, M, 3) in the unit of the file; NaN if missing
    rate: float  # frames per second
    units: str  # length unit that the file or its format declares, possibly empty
    up: str  # upward axis that is usual for the format
    outputs: Sequence[str] = ()  # labels that the file declares as computed, not measured


@dataclass(frozen=True)
class ReadingOptions:
    """Checked options of :func:`mocap_id.recording.read`."""

    units: str | None
    vertical: str | None
    force_units: ForceUnits
    unit_required: bool


def assemble_recording(
    path: Path, table: MarkerTable, force: FloatArray | None, options: ReadingOptions, oddities: list[str]
) -> tuple[Recording, FloatArray]:
    """Return a table as a recording without plates, and the rotation (3, 3) from the axes of the file to Z up.

    ``force`` (3,) is the mean ground force in the axes of the file; it is None if there are no plates. Notes are added
    to ``oddities``.
    """
    required = options.unit_required
    unit, metres = resolve_length_unit(path, table.units, options.units, oddities, required=required)
    naming = name_markers(table.labels, table.outputs)
    positions = table.positions[:, list(naming.keep)] * metres
    clean_positions(path, positions, unit, oddities)
    naming, positions = leave_out_objects(naming, positions)
    oddities += naming.oddities
    up = choose_vertical(force, options.vertical, table.up, oddities)
    rotate_z_up(positions, up)
    recording = Recording(
        files=(path,),
        format=table.format,
        labels=naming.labels,
        positions=positions,
        frames=table.frames,
        time=table.time,
        rate=table.rate,
        units=unit,
        vertical=up,
        analog_rate=None,
        plates=(),
        oddities=tuple(oddities),
        left_out=naming.left_out,
        people=naming.people,
    )
    return recording, to_z_up(up)


def fit_clock(path: Path, declared: str, time: FloatArray, oddities: list[str], name: str) -> tuple[FloatArray, float]:
    """Return evenly spaced times (F,) fitted to a time column (F,), s, and the frame rate, Hz.

    ``declared`` is the rate in the header, possibly not a number; ``name`` is its name in the header. Differences are
    noted in ``oddities``. Raises RecordingError if the times do not increase, are uneven or not in seconds, if the
    declared rate is not positive, or if the two rates differ by more than 2 %.
    """
    stated = parse_rate(path, declared, name)
    clock = fit_even_clock(path, time, stated, name="the Time column")
    if stated is not None and abs(clock.rate / stated - 1) > _MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}: {name} is {declared} Hz, the Time column has {clock.rate:.6g} Hz; times must be in seconds: "
            "export it again, or correct the wrong one"
        )
    if stated is not None and clock.rate != stated:
        oddities.append(
            f"{name} is {declared} Hz, the Time column has {clock.rate:.6g} Hz: {clock.rate:.6g} Hz was used"
        )
    if clock.rounding_note:
        oddities.append(f"{path.name}: {clock.rounding_note}")
    return clock.times(len(time)), clock.rate


def parse_rate(path: Path, declared: str, name: str) -> float | None:
    """Return the rate in a header, Hz; None if it is not a number, RecordingError if it is not positive."""
    try:
        stated = float(declared)
    except ValueError:
        return None
    if not 0 < stated < np.inf:
        raise RecordingError(f"{path}: {name} is {declared[:40]} Hz, expected a positive number; export it again")
    return stated


def check_frame_numbers(path: Path, column: FloatArray, *, consecutive: bool) -> IntArray:
    """Return frame numbers (F,) as integers.

    Raises RecordingError if a number is missing or too large, or if the numbers must be consecutive and are not.
    """
    bad = ~np.isfinite(column) | (np.abs(column) >= _MAX_FRAME_NUMBER)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise RecordingError(f"{path}: row {row + 1} of the frames has no frame number or time; export it again")
    frames = column.astype(np.int64)
    steps = np.diff(frames) != 1
    if consecutive and (steps.any() or (frames != column).any()):
        row = int(np.argmax(steps)) if steps.any() else 0
        raise RecordingError(
            f"{path}: frame {frames[row]} is followed by frame {frames[min(row + 1, len(frames) - 1)]}: frames are "
            "missing; export every frame, with missing markers blank"
        )
    return frames
