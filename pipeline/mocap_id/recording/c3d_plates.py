"""Signals of every force plate of a C3D file, in the axes of the file, with saturated samples marked."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.recording.c3d_file import C3DFile, Layout, read_channel_scales
from mocap_id.recording.plate_types import CHANNELS, PlateSignals, UnusablePlateError
from mocap_id.recording.units import ForceUnits, find_channel_scales

_RUN = 8  # a noisy channel that repeats its extreme this many times in a row is clipped
_QUANTISED = 0.2  # channels that repeat a larger fraction of their samples are coarse or at rest and are not checked
_REST = 0.1  # fraction of the larger extreme; an extreme closer to zero belongs to a channel at rest


def find_saturated(counts: FloatArray, offset: FloatArray, bits: int | None) -> BoolArray:
    """Return for each of K samples whether any of the C channels is saturated.

    ``counts`` (K, C) are the samples as stored, in most files counts of the converter. ``offset`` (C,) are the counts
    at zero input, about half the range for unsigned converters. ``bits`` is the resolution (ANALOG:BITS), None if not
    declared. If the counts are integers, the limits of the converter follow from its resolution. If they are not,
    :func:`find_clipped` judges each channel.
    """
    flags = np.zeros(len(counts), bool)
    for stored, zero in zip(counts.T, offset, strict=True):
        column = np.where(np.isfinite(stored), stored, np.nan)
        finite = column[np.isfinite(column)]
        if finite.size == 0 or np.ptp(finite) == 0:
            continue
        if np.abs(finite - np.round(finite)).max() < 1e-3:
            low, high = _find_limits(float(zero), bits)
            flags |= (column <= low + 0.5) | (column >= high - 0.5)
        else:
            flags |= find_clipped(column - zero)
    return flags


def _find_limits(offset: float, bits: int | None) -> tuple[float, float]:
    """Return the lowest and the highest count of a converter that uses offset binary or two's complement."""
    resolution = bits if bits in (12, 14, 16) else (12 if 1900 < abs(offset) < 2200 else 16)
    span = 2.0**resolution
    return (0.0, span - 1) if abs(offset) > span / 4 else (-span / 2, span / 2 - 1)


def find_clipped(column: FloatArray) -> BoolArray:
    """Return for each sample (K,) whether it is clipped: it equals an extreme that occurs at least 8 times in a row.

    Extremes near zero are not judged, nor is a channel that often repeats other values, because it is coarse or at
    rest.

    ``column`` (K,) is the signal minus its zero level; NaN if missing.
    """
    flags = np.zeros(len(column), bool)
    low, high = float(np.nanmin(column)), float(np.nanmax(column))
    between = column[(column > low) & (column < high)]
    if not between.size or np.mean(np.diff(between) == 0) > _QUANTISED:
        return flags
    for extreme in (low, high):
        if abs(extreme) < _REST * max(abs(low), abs(high)):
            continue
        at_extreme = column == extreme
        if max(run.stop - run.start for run in find_runs(at_extreme)) >= _RUN:
            flags |= at_extreme
    return flags


_MAX_PLATES = 64  # no laboratory has more plates, and each plate needs memory
_MEDIAN_WIDTH = 7  # width of a running median, samples: it removes spikes, but no real load
_LOADED_N, _LOADED_NM = 20.0, 5.0  # a plate whose forces or moments vary by more is loaded, not only noisy
_HORIZONTAL = {1: (0, 1), 2: (0, 1), 3: (0, 0, 1, 1), 4: (0, 1)}
"""Axis of the plate (0 for x, 1 for y) of the first channels of each type, which measure the horizontal force."""

_TWIST = {1: 5, 2: 5, 4: 5}
"""Channel of the moment about the vertical axis of each type: no quantity of the motion plane depends on it."""


@dataclass(frozen=True)
class StoredPlate:
    """Force plate as stored in the file, with K samples."""

    index: int  # number in the file, counted from 1
    kind: int  # FORCE_PLATFORM:TYPE
    signals: PlateSignals | None  # None if the plate cannot be used
    ok: BoolArray  # (K,) whether every channel is finite and not saturated
    problem: str  # reason why the plate cannot be used, or empty
    oddities: tuple[str, ...]  # notes, as in ``Recording``
    assumptions: tuple[str, ...] = ()  # as in ``Plate``
    saturated: BoolArray | None = None  # (K,) whether a channel is saturated; None if no channel ever is
    dead: tuple[tuple[str, int], ...] = ()  # channel and plate axis (0 for x, 1 for y) of dead horizontal forces


def list_plate_channels(file: C3DFile, layout: Layout) -> tuple[int, ...]:
    """Return the analog channels of force plates, numbered from 0; other channels, such as EMG, are not read."""
    named = file.numbers("FORCE_PLATFORM:CHANNEL")
    numbers = set() if named is None else {int(channel) for channel in named.ravel() if np.isfinite(channel)}
    return tuple(channel for channel in range(layout.channels) if channel + 1 in numbers)


def read_stored_plates(
    file: C3DFile, layout: Layout, counts: FloatArray, metres: float, units: ForceUnits
) -> list[StoredPlate]:
    """Read the signals of every plate; a plate that cannot be used has a ``problem`` instead of signals.

    ``counts`` (K, C) are the samples of the channels from :func:`list_plate_channels`, as stored. ``metres`` is the
    size of POINT:UNITS, m, which is the unit of CORNERS and ORIGIN.
    """
    kinds = tuple(file.words("FORCE_PLATFORM:TYPE") or ())
    used = (file.words("FORCE_PLATFORM:USED") or [len(kinds)])[0]
    read = min(used, len(kinds), _MAX_PLATES)
    plates = [_PlateReader(file, layout, counts, metres, units, kinds, index).read() for index in range(1, read + 1)]
    if used > read:
        problem = f"FORCE_PLATFORM:USED declares {used} plates and TYPE {len(kinds)}; {read} were read"
        plates.append(StoredPlate(read + 1, 0, None, np.zeros(len(counts), bool), problem, ()))
    return plates


@dataclass(frozen=True)
class _PlateReader:
    """Reader of one plate, which collects its oddities and assumptions."""

    file: C3DFile
    layout: Layout
    counts: FloatArray
    metres: float
    units: ForceUnits
    kinds: tuple[int, ...]
    index: int
    oddities: list[str] = field(default_factory=list)
    assumptions: list[str] = field(default_factory=list)

    @property
    def kind(self) -> int:
        return self.kinds[self.index - 1]

    def read(self) -> StoredPlate:
        try:
            columns = self._find_columns()
            corners = self._read_parameter("CORNERS", (3, 4)).T * self.metres
            origin = self._read_origin()
            values, ok, full = self._read_samples(columns)
            channels = self._convert_to_si(self._subtract_baseline(values), columns)
            dead = self._find_dead_channels(values[ok], channels[ok], columns)
        except UnusablePlateError as why:
            nothing = np.zeros(len(self.counts), bool)
            return StoredPlate(self.index, self.kind, None, nothing, str(why), tuple(self.oddities))
        polynomial = self.file.numbers("FORCE_PLATFORM:FPCOPPOLY")
        if polynomial is not None and np.any(polynomial != 0):
            self._note(
                "the file contains a correction polynomial for the centre of pressure (Kistler, FPCOPPOLY), which was "
                "not applied: near the edges of the plate the centre of pressure may be some millimetres off"
            )
        if not ok.all():
            self._note(f"{int((~ok).sum())} analog samples are saturated or not finite")
        signals = PlateSignals(self.kind, channels, origin, corners, self.layout.per_frame * self.layout.rate)
        assumed = tuple(self.assumptions)
        saturated = full if full.any() else None
        return StoredPlate(self.index, self.kind, signals, ok, "", tuple(self.oddities), assumed, saturated, dead)

    def _note(self, oddity: str) -> None:
        self.oddities.append(f"plate {self.index}: {oddity}")

    def _find_columns(self) -> list[int]:
        """Return the analog channels of the plate, numbered from 0."""
        if self.kind not in CHANNELS:
            raise UnusablePlateError(f"type {self.kind} is not supported (1, 2, 3 and 4 are)")
        if not self.layout.channels:
            raise UnusablePlateError("the file contains no analog channels")
        channel_map = self.file.numbers("FORCE_PLATFORM:CHANNEL")
        if channel_map is None or not np.isfinite(channel_map).all():
            raise UnusablePlateError("FORCE_PLATFORM:CHANNEL is missing or not numeric")
        channel_map = np.atleast_1d(channel_map)
        channel_map = channel_map.reshape(channel_map.shape[0], -1, order="F")
        needed = max(CHANNELS.get(kind, 0) for kind in self.kinds)
        rows, plates = channel_map.shape
        if rows < needed:  # the columns of all plates are then shifted
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL has {rows} rows, a plate of this file needs {needed}")
        if plates < self.index:
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL describes only {plates} plates")
        channels = [int(channel) for channel in channel_map[: CHANNELS[self.kind], self.index - 1]]
        for channel in channels:
            if not 1 <= channel <= self.layout.channels:
                raise UnusablePlateError(
                    f"FORCE_PLATFORM:CHANNEL names channel {channel}, the file has {self.layout.channels}"
                )
        if len(set(channels)) < len(channels):
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL names a channel twice: {channels}")
        for other, kind in enumerate(self.kinds[: self.index - 1]):
            common = sorted({int(each) for each in channel_map[: CHANNELS.get(kind, 0), other]} & set(channels))
            if common:
                raise UnusablePlateError(
                    f"FORCE_PLATFORM:CHANNEL names the channels {common} also for plate {other + 1}"
                )
        return [channel - 1 for channel in channels]

    def _read_parameter(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        """Return this plate's values of the FORCE_PLATFORM parameter ``name``, as an array of this ``shape``."""
        value = self.file.numbers(f"FORCE_PLATFORM:{name}")
        size = int(np.prod(shape))
        if value is None or value.size < size * self.index:
            raise UnusablePlateError(f"FORCE_PLATFORM:{name} is missing or too short")
        part = value.ravel(order="F")[size * (self.index - 1) : size * self.index]
        if not np.isfinite(part).all():
            raise UnusablePlateError(f"FORCE_PLATFORM:{name} is not finite")
        return part.reshape(shape, order="F")

    def _read_origin(self) -> FloatArray:
        """Return ORIGIN (3,) with negative z, m; 0 for type 1. The opposite vector of some old files is reversed."""
        if self.kind == 1:
            return np.zeros(3)
        origin = self._read_parameter("ORIGIN", (3,)) * self.metres
        if origin[2] > 0:
            self._note(f"ORIGIN points the wrong way (z = {origin[2]:.4f} m, expected below 0): the sign was corrected")
            origin = origin * [1, 1, -1] if self.kind == 3 else -origin
        if self.kind == 3:
            origin = np.abs(origin) * [1, 1, -1]
            if not np.all(np.abs(origin[:2]) > 0):
                raise UnusablePlateError("ORIGIN has no sensor distances, which a type 3 plate needs")
        return np.asarray(origin)

    def _read_samples(self, columns: list[int]) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Return the scaled samples (K, C), NaN if not finite, and whether each is valid (K,) and saturated (K,)."""
        offset, scale = (each[columns] for each in read_channel_scales(self.file, self.layout))
        if not np.isfinite(scale).all():
            raise UnusablePlateError("ANALOG:SCALE is missing for some of its channels")
        read = list_plate_channels(self.file, self.layout)
        counts = self.counts[:, [read.index(column) for column in columns]]
        values = counts - offset
        with np.errstate(over="ignore", invalid="ignore"):
            values *= scale
        values[~np.isfinite(values)] = np.nan
        finite = np.isfinite(values).all(axis=1)
        if not finite.any():
            raise UnusablePlateError("no sample has numbers in all channels of the plate")
        bits = self.file.words("ANALOG:BITS")
        full = find_saturated(counts, offset, bits[0] if bits else None)
        ok = np.asarray(finite & ~full)
        if not ok.any():
            raise UnusablePlateError("all of its samples are saturated or not finite")
        return values, ok, full

    def _find_dead_channels(
        self, values: FloatArray, channels: FloatArray, columns: list[int]
    ) -> tuple[tuple[str, int], ...]:
        """Return the dead channels of horizontal force: name and plate axis (0 for x, 1 for y).

        A channel is dead if it reads the same value in every sample although the plate is loaded. ``values`` and
        ``channels`` (K, C) are the valid samples as scaled by the file and in SI units. Raises UnusablePlateError if a
        channel is dead on which the vertical force or the centre of pressure depends.
        """
        constant = np.ptp(values, axis=0) == 0.0
        forces = slice(0, 8) if self.kind == 3 else slice(0, 3)
        moments = slice(3, 6) if self.kind in (2, 4) else slice(0)
        varies = [np.ptp(channels[:, part], axis=0).max(initial=0.0) for part in (forces, moments)]
        if not constant.any() or not (varies[0] > _LOADED_N or varies[1] > _LOADED_NM):
            return ()
        labels = self.file.strings("ANALOG:LABELS")

        def describe(channel: int) -> str:
            column = columns[channel]
            name = labels[column].strip() if column < len(labels) else ""
            return f"{name or 'channel'} (channel {column + 1})"

        horizontal = _HORIZONTAL[self.kind]
        needed = [k for k in map(int, np.flatnonzero(constant)) if k >= len(horizontal) and k != _TWIST.get(self.kind)]
        if needed:
            listed = ", ".join(f"{describe(k)} reads {values[0, k]:g}" for k in needed)
            raise UnusablePlateError(
                f"{listed} in every sample although the plate is loaded: the channel is dead or not connected. The "
                "vertical force or the centre of pressure would be wrong; check cable and amplifier, and export again"
            )
        alive = {axis for k, axis in enumerate(horizontal) if not constant[k]}  # of two channels, one may have the sum
        return tuple((describe(k), axis) for k, axis in enumerate(horizontal) if axis not in alive)

    def _subtract_baseline(self, channels: FloatArray) -> FloatArray:
        """Return ``channels`` (K, C), minus their mean over the baseline frames (ZERO) if these are unloaded."""
        zero = self.file.words("FORCE_PLATFORM:ZERO") or [0, 0]
        first, last = max(zero[0], 1), zero[-1]
        if self.kind == 1 or len(zero) < 2 or last <= first or last > self.layout.frames:
            return channels
        part = slice((first - 1) * self.layout.per_frame, last * self.layout.per_frame)
        finite: BoolArray = np.asarray(np.isfinite(channels).all(axis=1))
        good = channels[part][finite[part]]
        if 2 * len(good) < len(channels[part]):
            self._note(
                f"only {len(good)} of {len(channels[part])} samples of the baseline frames {first} to {last} (ZERO) "
                "are numbers: the baseline was not subtracted"
            )
            return channels
        baseline = good.mean(axis=0)
        parts = slice(4, 8) if self.kind == 3 else slice(2, 3)
        load = np.pad(channels[finite, parts].sum(axis=1), _MEDIAN_WIDTH // 2, mode="edge")
        vertical = np.median(sliding_window_view(load, _MEDIAN_WIDTH), axis=1)
        level = float(baseline[parts].sum())
        if _is_offset(level, vertical):
            return np.asarray(channels - baseline)
        share = 100 * abs(level) / np.abs(vertical).max()
        self._note(
            f"the baseline frames {first} to {last} (ZERO) are loaded ({share:.0f} % of the peak): the "
            "baseline was not subtracted"
        )
        return channels

    def _convert_to_si(self, channels: FloatArray, columns: list[int]) -> FloatArray:
        """Return the channels (K, C) in N, m and N·m."""
        if self.kind == 4:
            if self.units.configured:
                self._note("its CAL_MATRIX gives N and N·mm: the units in the configuration were ignored")
            return self._apply_matrix(channels, read_channel_scales(self.file, self.layout)[1][columns])
        units = [unit for name in self.file.parts("ANALOG:UNITS") for unit in self.file.strings(name)]
        declared = [units[column] if column < len(units) else "" for column in columns]
        factors, assumptions, oddities = find_channel_scales(self.kind, declared, self.metres, self.units)
        self.assumptions.extend(assumptions)
        for oddity in oddities:
            self._note(oddity)
        return np.asarray(channels * factors)

    def _apply_matrix(self, channels: FloatArray, scale: FloatArray) -> FloatArray:
        """Apply the 6 × 6 matrix of a type 4 plate, which gives N and N·mm, and return the channels (K, 6) in SI units.

        In some files ANALOG:SCALE already contains the diagonal of the matrix (and the matrix is in N and N·m).
        Applying the diagonal again would make the forces several times too large.
        """
        matrix = self._read_parameter("CAL_MATRIX", (6, 6))
        if np.linalg.matrix_rank(matrix) < 6:
            raise UnusablePlateError("CAL_MATRIX is singular")
        to_si = np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
        diagonal = np.diag(matrix)
        ratio = np.abs(scale) / np.maximum(np.abs(diagonal), 1e-12)
        alike = all(np.ptp(part) < 0.01 * part.mean() for part in (ratio[:3], ratio[3:]))
        if alike and np.ptp(np.abs(scale[:3])) > 0.1 * np.abs(scale[:3]).mean():
            self._note("ANALOG:SCALE already contains the diagonal of CAL_MATRIX: the diagonal was applied once")
            moments = ratio[3] / ratio[0]
            channels = channels / (np.sign(scale) * diagonal * np.repeat([1.0, moments], 3))
            to_si = np.repeat([1.0, 1e-3 * moments], 3)
        return np.asarray((channels @ matrix.T) * to_si)


def _is_offset(level: float, vertical: FloatArray) -> bool:
    """Return whether the load ``level`` of the baseline frames is an offset: it is small or has the opposite sign."""
    if abs(level) <= 0.1 * float(np.abs(vertical).max()):
        return True
    excursion = vertical - level
    largest = float(excursion[np.argmax(np.abs(excursion))])
    return level * largest < 0 and abs(largest) > 1.5 * abs(level)
