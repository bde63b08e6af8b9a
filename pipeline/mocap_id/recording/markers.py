"""Trajectories of any file → clean marker positions in metres, lab axes, missing as NaN."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.units import LENGTHS, length_scale

_FAR_M = 1000.0
"""No laboratory is that large: such coordinates are garbage."""

_SMALLEST_M, _LARGEST_M = 0.02, 100.0
"""Spread of the markers of one trial, for a units check."""


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


def clean(path: Path, positions: FloatArray, units: str, oddities: list[str]) -> FloatArray:
    """Mark as missing what cannot be a measurement, and check the size of things.

    Parameters
    ----------
    positions : (F, M, 3) array
        m; NaN where the file says that a marker was not seen.

    Raises
    ------
    RecordingError
        The trial's size contradicts its unit.
    """
    positions = positions.copy()
    seen = np.asarray(np.isfinite(positions).all(axis=2))
    if seen.any():
        _check_size(path, positions, seen, units)
    partly = np.isfinite(positions).any(axis=2) & ~seen
    far = seen & (np.abs(np.where(seen[..., None], positions, 0.0)).max(axis=2) > _FAR_M)
    zero = seen & (positions == 0).all(axis=2)
    for flags, what in (
        (partly | np.isinf(positions).any(axis=2), "are not finite"),
        (far, f"lie farther than {_FAR_M:.0f} m away"),
        (zero, "are exactly 0, 0, 0"),
    ):
        if flags.any():
            oddities.append(f"{int(flags.sum())} marker samples {what} and count as missing")
        positions[flags] = np.nan
    if not np.isfinite(positions).any():
        oddities.append(f"none of the {positions.shape[1]} markers is ever seen")
    return positions


def _check_size(path: Path, positions: FloatArray, seen: BoolArray, units: str) -> None:
    """Refuse a trial that is no larger than a fingernail, or mostly larger than a hall."""
    samples = positions[seen]
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
