"""Marker positions in metres and lab axes, with impossible samples removed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.axes import to_z_up
from mocap_id.recording.units import LENGTHS, check_length_unit, find_length_scale, strip_padding

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
