"""Trajectories of any file → clean marker positions in metres, lab axes, missing as NaN."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.axes import to_z_up
from mocap_id.recording.units import LENGTHS, length_scale

_FAR_M = 1000.0
"""No laboratory is that large: such coordinates are garbage."""

_SMALLEST_M, _LARGEST_M = 0.02, 100.0
"""Spread of the markers of one trial, for a units check."""

_STRETCH = 1000
"""Frames that are cleaned at once: what that needs beside the positions stays small."""


def metres_per_unit(path: Path, declared: str, override: str | None, oddities: list[str]) -> tuple[str, float]:
    """The length unit that holds and its size in metres.

    Parameters
    ----------
    declared : str
        As in the file, possibly empty.
    override : str or None
        The configuration's ``units:``, which wins.

    Raises
    ------
    RecordingError
        The unit is missing, unknown or ambiguous.
    ConfigError
        ``override`` is no unit of length.
    """
    name = declared.strip().strip("\x00").strip()
    if override is not None:
        scale = length_scale(override)
        if scale is None:
            raise ConfigError(f"units: {override!r} is no unit of length; expected one of {', '.join(LENGTHS)}")
        if length_scale(name) not in (None, scale):
            oddities.append(f"the file declares lengths in {name!r}, the configuration says {override}: that was taken")
        return override, scale
    scale = length_scale(name)
    if scale is None:
        found = f"unit {name!r}, which is not unambiguous" if name else "no length unit"
        raise RecordingError(f"{path}: the file declares {found}; say `planarise: {{units: mm}}` (or m, cm)")
    if name.lower() not in LENGTHS:
        oddities.append(f"the length unit {name!r} is cut short: read as {'metres' if scale == 1 else name}")
    return name, scale


def thinned(positions: FloatArray) -> FloatArray:
    """About a thousand frames, evenly chosen: enough to tell how large a trial is and on which side of a plate."""
    return positions[:: max(1, len(positions) // _STRETCH)]


def turn_up(positions: FloatArray, up: str) -> None:
    """Turn positions (F, M, 3), in place, so that the file's axis ``up`` becomes Z."""
    turn = to_z_up(up)
    for at in range(0, len(positions) if up != "Z" else 0, _STRETCH):
        positions[at : at + _STRETCH] = positions[at : at + _STRETCH] @ turn.T


def clean(path: Path, positions: FloatArray, units: str, oddities: list[str]) -> None:
    """Mark as missing, in place, what cannot be a measurement, and check the size of things.

    Parameters
    ----------
    positions : (F, M, 3) array
        m; NaN where the file says that a marker was not seen.

    Raises
    ------
    RecordingError
        The trial's size contradicts its unit.
    """
    _check_size(path, positions, units)
    parts = [positions[at : at + _STRETCH] for at in range(0, len(positions), _STRETCH)]
    marked = np.array([_marked(part) for part in parts]).reshape(-1, 4).sum(axis=0)
    for count, what in zip(
        marked, ("are not finite", f"lie farther than {_FAR_M:.0f} m away", "are exactly 0, 0, 0"), strict=False
    ):
        if count:
            oddities.append(f"{count} marker samples {what} and count as missing")
    if not marked[3]:
        oddities.append(f"none of the {positions.shape[1]} markers is ever seen")


def _marked(positions: FloatArray) -> tuple[int, int, int, int]:
    """Set to NaN what is partly NaN or endless, too far or exactly zero; how many samples of each, and of the rest."""
    x, y, z = np.abs(np.moveaxis(positions, 2, 0))
    largest = np.maximum(np.maximum(x, y), z)  # NaN where any coordinate is
    broken = ~np.isfinite(largest) & ~(np.isnan(x) & np.isnan(y) & np.isnan(z))
    far, zero = ~broken & (largest > _FAR_M), largest == 0
    for flags in (broken, far, zero):
        if flags.any():
            positions[flags] = np.nan
    return int(broken.sum()), int(far.sum()), int(zero.sum()), int((largest <= _FAR_M).sum() - zero.sum())


def _check_size(path: Path, positions: FloatArray, units: str) -> None:
    """Refuse a trial that is no larger than a fingernail, or mostly larger than a hall."""
    frames = thinned(positions)
    seen = np.isfinite(frames).all(axis=2)
    if not seen.any():
        return
    samples = frames[seen]
    spread = float(np.linalg.norm(np.ptp(np.percentile(samples, [25, 75], axis=0), axis=0)))
    extent = float(np.linalg.norm(np.ptp(samples, axis=0)))
    several = int(seen.any(axis=0).sum()) >= 3
    if spread > _LARGEST_M or (several and 0 < extent < _SMALLEST_M):
        size = spread if spread > _LARGEST_M else extent
        raw = size / (length_scale(units) or 1.0)
        sizes = {name: raw * LENGTHS[name] for name in ("mm", "cm", "m")}
        fits = ", ".join(f"{name} makes it {at:.3g} m" for name, at in sizes.items() if _SMALLEST_M <= at <= _LARGEST_M)
        raise RecordingError(
            f"{path}: the markers spread over {size:.3g} m when read in {units!r}, expected {_SMALLEST_M} to "
            f"{_LARGEST_M:.0f} m; the unit is wrong, say `planarise: {{units: …}}`" + (f": {fits}" if fits else "")
        )
