"""FORCE_PLATFORM and ANALOG parameters → the signals of every plate, in the file's own axes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.c3d_decode import calibration
from mocap_id.recording.c3d_file import C3DFile
from mocap_id.recording.c3d_layout import Layout
from mocap_id.recording.channel_units import ForceUnits, channel_scales
from mocap_id.recording.plate_types import CHANNELS, PlateSignals, UnusablePlateError
from mocap_id.recording.saturation import saturated

_MOST_PLATES = 64
"""No laboratory has more, and each takes memory."""

_SPIKE = 7
"""Samples of a running median: no load is as short as half of it, a spike is."""


@dataclass(frozen=True)
class StoredPlate:
    """A plate as the file has it.

    Parameters
    ----------
    index : int
        From 1.
    kind : int
        FORCE_PLATFORM:TYPE.
    signals : PlateSignals or None
        None where the plate cannot be used.
    ok : (K,) bool array
        Every channel is finite and away from the converter's limits.
    problem : str
        Why it cannot be used, or empty.
    oddities : tuple of str
    assumptions : tuple of str
    saturated : (K,) bool array or None
        A channel is at its limit; None where none is.
    """

    index: int
    kind: int
    signals: PlateSignals | None
    ok: BoolArray
    problem: str
    oddities: tuple[str, ...]
    assumptions: tuple[str, ...] = ()
    saturated: BoolArray | None = None


def plate_channels(file: C3DFile, layout: Layout) -> tuple[int, ...]:
    """Analog channels that the plates' parameters point to, from 0; those of muscles and the like are not read."""
    named = file.numbers("FORCE_PLATFORM:CHANNEL")
    wanted = set() if named is None else {int(channel) for channel in named.ravel() if np.isfinite(channel)}
    return tuple(channel for channel in range(layout.channels) if channel + 1 in wanted)


def stored_plates(
    file: C3DFile, layout: Layout, counts: FloatArray, metres: float, units: ForceUnits
) -> list[StoredPlate]:
    """Collect every plate's signals.

    Parameters
    ----------
    counts : (K, C) array
        Samples of the C :func:`plate_channels`, as stored.
    metres : float
        Metres per POINT unit, which CORNERS and ORIGIN share.
    """
    kinds = tuple(file.words("FORCE_PLATFORM:TYPE") or ())
    used = (file.words("FORCE_PLATFORM:USED") or [len(kinds)])[0]
    read = min(used, len(kinds), _MOST_PLATES)
    plates = [_PlateReader(file, layout, counts, metres, units, kinds, index).read() for index in range(1, read + 1)]
    if used > read:
        problem = f"FORCE_PLATFORM:USED promises {used} plates, TYPE tells of {len(kinds)}; {read} were read"
        plates.append(StoredPlate(read + 1, 0, None, np.zeros(len(counts), bool), problem, ()))
    return plates


@dataclass(frozen=True)
class _PlateReader:
    """One plate's parameters, and what is odd about them."""

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
        return self.kinds[self.index - 1] if self.index <= len(self.kinds) else 0

    def read(self) -> StoredPlate:
        try:
            columns = self._columns()
            corners = self._parameter("CORNERS", (3, 4)).T * self.metres
            origin = self._origin()
            values, ok, full = self._samples(columns)
            channels = self._in_si(self._without_baseline(values), columns)
        except UnusablePlateError as why:
            nothing = np.zeros(len(self.counts), bool)
            return StoredPlate(self.index, self.kind, None, nothing, str(why), tuple(self.oddities))
        if not ok.all():
            self._note(f"{int((~ok).sum())} analog samples are saturated or not finite")
        signals = PlateSignals(self.kind, channels, origin, corners, self.layout.per_frame * self.layout.rate)
        assumed = tuple(self.assumptions)
        full_ = full if full.any() else None
        return StoredPlate(self.index, self.kind, signals, ok, "", tuple(self.oddities), assumed, full_)

    def _note(self, oddity: str) -> None:
        self.oddities.append(f"plate {self.index}: {oddity}")

    def _columns(self) -> list[int]:
        """Analog columns of the channels, from 0."""
        if self.kind not in CHANNELS:
            raise UnusablePlateError(f"type {self.kind} is not supported (1, 2, 3 and 4 are)")
        if not self.layout.channels:
            raise UnusablePlateError("the file holds no analog channels")
        channel_map = self.file.numbers("FORCE_PLATFORM:CHANNEL")
        if channel_map is None or not np.isfinite(channel_map).all():
            raise UnusablePlateError("FORCE_PLATFORM:CHANNEL is missing or holds no numbers")
        channel_map = np.atleast_1d(channel_map)
        channel_map = channel_map.reshape(channel_map.shape[0], -1, order="F")
        needed = max(CHANNELS.get(kind, 0) for kind in self.kinds)
        rows, plates = channel_map.shape
        if rows < needed:  # then the columns of all plates are shifted
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL has {rows} rows, a plate of this file needs {needed}")
        if plates < self.index:
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL describes only {plates} plates")
        channels = [int(channel) for channel in channel_map[: CHANNELS[self.kind], self.index - 1]]
        for channel in channels:
            if not 1 <= channel <= self.layout.channels:
                raise UnusablePlateError(
                    f"FORCE_PLATFORM:CHANNEL points to channel {channel}, the file has {self.layout.channels}"
                )
        if len(set(channels)) < len(channels):
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL points to one channel twice: {channels}")
        return [channel - 1 for channel in channels]

    def _parameter(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        """This plate's part of a FORCE_PLATFORM parameter whose last dimension counts the plates."""
        value = self.file.numbers(f"FORCE_PLATFORM:{name}")
        size = int(np.prod(shape))
        if value is None or value.size < size * self.index:
            raise UnusablePlateError(f"FORCE_PLATFORM:{name} is missing or too short")
        part = value.ravel(order="F")[size * (self.index - 1) : size * self.index]
        if not np.isfinite(part).all():
            raise UnusablePlateError(f"FORCE_PLATFORM:{name} is not finite")
        return part.reshape(shape, order="F")

    def _origin(self) -> FloatArray:
        """ORIGIN in m with z negative: old files hold the reverse vector."""
        if self.kind == 1:
            return np.zeros(3)
        origin = self._parameter("ORIGIN", (3,)) * self.metres
        if origin[2] > 0:
            self._note(f"ORIGIN points the wrong way (z = {origin[2]:.4f} m, expected negative), sign repaired")
            origin = origin * [1, 1, -1] if self.kind == 3 else -origin
        if self.kind == 3:
            origin = np.abs(origin) * [1, 1, -1]
            if not np.all(np.abs(origin[:2]) > 0):
                raise UnusablePlateError("ORIGIN gives no sensor distances, which a type 3 plate needs")
        return np.asarray(origin)

    def _samples(self, columns: list[int]) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Scaled samples of the channels (NaN where not finite), which samples are valid, and which are saturated."""
        offset, scale = (each[columns] for each in calibration(self.file, self.layout))
        if not np.isfinite(scale).all():
            raise UnusablePlateError("ANALOG:SCALE does not cover its channels")
        read = plate_channels(self.file, self.layout)
        counts = self.counts[:, [read.index(column) for column in columns]]
        values = counts - offset
        with np.errstate(over="ignore", invalid="ignore"):
            values *= scale
        values[~np.isfinite(values)] = np.nan
        finite = np.isfinite(values).all(axis=1)
        if not finite.any():
            raise UnusablePlateError("in none of its samples are all of its channels numbers")
        bits = self.file.words("ANALOG:BITS")
        full = saturated(counts, offset, bits[0] if bits else None)
        ok = np.asarray(finite & ~full)
        if not ok.any():
            raise UnusablePlateError("all of its samples are saturated or not finite")
        return values, ok, full

    def _without_baseline(self, channels: FloatArray) -> FloatArray:
        """Subtract the mean over the frames that ZERO names, if the plate was unloaded then."""
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
                "are numbers: not subtracted"
            )
            return channels
        baseline = good.mean(axis=0)
        parts = slice(4, 8) if self.kind == 3 else slice(2, 3)
        load = np.pad(channels[finite, parts].sum(axis=1), _SPIKE // 2, mode="edge")
        vertical = np.median(sliding_window_view(load, _SPIKE), axis=1)
        level = float(baseline[parts].sum())
        if _is_offset(level, vertical):
            return np.asarray(channels - baseline)
        share = 100 * abs(level) / np.abs(vertical).max()
        self._note(
            f"the baseline frames {first} to {last} (ZERO) are loaded ({share:.0f} % of the peak): not subtracted"
        )
        return channels

    def _in_si(self, channels: FloatArray, columns: list[int]) -> FloatArray:
        """Calibrated channels in N, m and N·m."""
        if self.kind == 4:
            if self.units.given:
                self._note("its CAL_MATRIX gives N and N·mm: the configuration's units of force were not applied")
            return self._calibrated(channels, calibration(self.file, self.layout)[1][columns])
        units = self.file.strings("ANALOG:UNITS")
        declared = [units[column] if column < len(units) else "" for column in columns]
        found = channel_scales(self.kind, declared, self.metres, self.units)
        self.assumptions.extend(found.assumptions)
        for oddity in found.oddities:
            self._note(oddity)
        return np.asarray(channels * found.factors)

    def _calibrated(self, channels: FloatArray, scale: FloatArray) -> FloatArray:
        """Type 4: the 6 × 6 matrix turns the channels into N and N·mm; in SI.

        Some files scale the channels by the matrix's diagonal already (and hold the matrix in N and N·m); applied
        once more, forces come out several times too large.
        """
        matrix = self._parameter("CAL_MATRIX", (6, 6))
        if np.linalg.matrix_rank(matrix) < 6:
            raise UnusablePlateError("CAL_MATRIX is singular")
        to_si = np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
        diagonal = np.diag(matrix)
        ratio = np.abs(scale) / np.maximum(np.abs(diagonal), 1e-12)
        alike = all(np.ptp(part) < 0.01 * part.mean() for part in (ratio[:3], ratio[3:]))
        if alike and np.ptp(np.abs(scale[:3])) > 0.1 * np.abs(scale[:3]).mean():
            self._note("ANALOG:SCALE already holds the diagonal of CAL_MATRIX: applied once")
            moments = ratio[3] / ratio[0]
            channels = channels / (np.sign(scale) * diagonal * np.repeat([1.0, moments], 3))
            to_si = np.repeat([1.0, 1e-3 * moments], 3)
        return np.asarray((channels @ matrix.T) * to_si)


def _is_offset(level: float, vertical: FloatArray) -> bool:
    """Whether a baseline level is an offset: small, or of the other sign than the loads, which have only one."""
    if abs(level) <= 0.1 * float(np.abs(vertical).max()):
        return True
    excursion = vertical - level
    largest = float(excursion[np.argmax(np.abs(excursion))])
    return level * largest < 0 and abs(largest) > 1.5 * abs(level)
