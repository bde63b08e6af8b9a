"""Reader of C3D files: markers, and the signals of every force plate, with saturated samples marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.recording.c3d_file import PROCESSORS, C3DFile
from mocap_id.recording.lab_plates import (
    LOADED_N,
    PlateSignals,
    compute_centre_of_pressure,
    compute_plate_axes,
    compute_surface_wrench,
    reverse_force_on_plate,
)
from mocap_id.recording.markers import (
    clean_positions,
    leave_out_objects,
    name_markers,
    resolve_length_unit,
    rotate_z_up,
    thin_frames,
)
from mocap_id.recording.model import (
    SCALES,
    Plate,
    ReadingOptions,
    Recording,
    axis_vector,
    find_force_scale,
    nearest_axis,
    parse_axis,
    strip_padding,
    to_z_up,
)

_OUTPUT_GROUPS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS", "VIRTUAL_MARKERS")
"""POINT parameters that list computed trajectories, not markers; POINT:TYPE_GROUPS may name more."""

_BELOW_M = 0.2  # if the markers are this far below a plate, its corners are in the wrong order

_RUN = 8  # a noisy channel that repeats its extreme this many times in a row is clipped
_QUANTISED = 0.2  # channels that repeat a larger fraction of their samples are coarse or at rest and are not checked
_REST = 0.1  # fraction of the larger extreme; an extreme closer to zero belongs to a channel at rest

_ON_PLATE_M, _SHARE_ON_PLATE = 0.05, 0.8  # distance beside a plate and share of samples on it that are accepted
_MAX_PLATES = 64  # no laboratory has more plates, and each plate needs memory
_MEDIAN_WIDTH = 7  # width of a running median, samples: it removes spikes, but no real load
_LOADED_N, _LOADED_NM = 20.0, 5.0  # a plate whose forces or moments vary by more is loaded, not only noisy
_HORIZONTAL = {1: (0, 1), 2: (0, 1), 3: (0, 0, 1, 1), 4: (0, 1)}
"""Axis of the plate (0 for x, 1 for y) of the first channels of each type, which measure the horizontal force."""

_TWIST = {1: 5, 2: 5, 4: 5}
"""Channel of the moment about the vertical axis of each type: no quantity of the motion plane depends on it."""

_QUANTITIES = {
    1: ("force",) * 3 + ("point",) * 2 + ("moment",),
    2: ("force",) * 3 + ("moment",) * 3,
    3: ("force",) * 8,
    4: ("",) * 6,
}
"""Quantity of each channel, by plate type. The channels of type 4 are inputs of a calibration matrix."""

_CHANNELS = {kind: len(quantities) for kind, quantities in _QUANTITIES.items()}


def read_c3d(path: Path, stream: BinaryIO, options: ReadingOptions) -> Recording:
    """Read an open C3D file; parameters and errors as for :func:`mocap_id.recording.read`."""
    file = C3DFile(path, stream)
    oddities = file.oddities
    declared, required = file.text("POINT:UNITS"), options.unit_required
    unit, metres = resolve_length_unit(path, declared, options.units, oddities, required=required)
    names = [*file.strings("SUBJECTS:NAMES"), *file.strings("SUBJECTS:LABEL_PREFIXES")]
    subjects = [name.strip() for name in names if name.strip()]
    labels = [label for name in file.parts("POINT:LABELS") for label in file.strings(name)]  # LABELS2 and so on
    labels = [*labels[: file.points], *[""] * (file.points - len(labels))]
    groups = [*_OUTPUT_GROUPS, *(name.strip().upper() for name in file.strings("POINT:TYPE_GROUPS")[::2])]
    outputs = [
        label.strip()
        for group in dict.fromkeys(groups)
        if group != "LABELS"
        for name in file.parts(f"POINT:{group}")
        for label in file.strings(name)
        if label.strip()
    ]
    naming = name_markers(labels, outputs, subjects)
    positions, counts = file.decode_frames(naming.keep, _list_plate_channels(file), metres)
    clean_positions(path, positions, unit, oddities)
    naming, positions = leave_out_objects(naming, positions)
    oddities += naming.oddities
    stem = path.stem.casefold()
    if any(len(name) > 2 and name.strip(":_-. ").casefold() in stem for name in subjects):
        oddities.append(
            "the file name contains the name of a subject from its header, and outputs show the file name: rename the "
            "file to a pseudonym"
        )
    kinds = file.words("FORCE_PLATFORM:TYPE") or []
    used = (file.words("FORCE_PLATFORM:USED") or [len(kinds)])[0]
    known = max(min(used, len(kinds), _MAX_PLATES), 0)
    stored = []
    for index, kind in enumerate(kinds[:known], start=1):
        stored.append(_FilePlate(file, metres, options.force_units, index, kind))
        stored[-1].read(counts)
    if used > known:
        problem = f"FORCE_PLATFORM:USED declares {used} plates and TYPE {len(kinds)}; {known} were read"
        stored.append(_FilePlate(file, metres, options.force_units, known + 1, 0, problem))
        stored[-1].ok = np.zeros(len(counts), dtype=np.bool_)
    del counts  # large in a long recording
    up = _find_vertical(file, stored, positions, options.vertical, oddities)
    rotate_z_up(positions, up)
    frames = file.first + np.arange(file.frames)
    time = (frames - min(file.first, 1)) / file.rate
    start, rotation, rate = float(time[0]), to_z_up(up), file.per_frame * file.rate
    plates = tuple(plate.place(rotation, start, oddities) for plate in stored)
    return Recording(
        files=(path,),
        format=f"C3D ({PROCESSORS[file.processor]}, {'real' if file.real else 'integer'})",
        labels=naming.labels,
        positions=positions,
        frames=frames.astype(np.int64),
        time=time,
        rate=file.rate,
        units=unit,
        vertical=up,
        analog_rate=rate if file.channels else None,
        plates=plates,
        oddities=tuple(oddities),
        left_out=naming.left_out,
        people=naming.people,
    )


def _find_vertical(
    file: C3DFile, stored: Sequence[_FilePlate], positions: FloatArray, override: str | None, oddities: list[str]
) -> str:
    """Return the upward axis: ``override``, else the normal of the plates, else POINT:Y_SCREEN, else Z (assumed).

    The normal counts if it is an axis, the same for all usable plates, and points towards the markers.
    """
    declared, axes = parse_axis(file.text("POINT:Y_SCREEN")), set[str | None]()
    for plate in stored:
        if plate.signals is None:
            continue
        down = compute_plate_axes(plate.signals.corners)[:, 2]
        axis = nearest_axis(-down) if np.isfinite(down).all() else None
        if axis is not None:
            height = (thin_frames(positions) - plate.signals.corners.mean(axis=0)) @ axis_vector(axis)
            if np.isfinite(height).any() and np.nanmedian(height) < -_BELOW_M:
                axis = axis.removeprefix("-") if axis.startswith("-") else f"-{axis}"
        axes.add(axis)
    normal = axes.pop() if len(axes) == 1 else None
    if override is not None:
        for axis, source in ((normal, "the force plates say"), (declared, "POINT:Y_SCREEN says")):
            if axis is not None and axis != override:
                oddities.append(f"{source} that {axis} is up, the configuration says {override}: {override} was used")
        return override
    if normal is not None:
        if declared is not None and declared != normal:
            oddities.append(f"POINT:Y_SCREEN says {declared} is up, the force plates say {normal}: {normal} was used")
        return normal
    if declared is not None:
        return declared
    oddities.append("the file does not say which axis is up: Z was assumed (if it is another, set `vertical:`)")
    return "Z"


def _list_plate_channels(file: C3DFile) -> tuple[int, ...]:
    """Return the analog channels of force plates, numbered from 0; other channels, such as EMG, are not read."""
    named = file.numbers("FORCE_PLATFORM:CHANNEL")
    numbers = set() if named is None else {int(channel) for channel in named.ravel() if np.isfinite(channel)}
    return tuple(channel for channel in range(file.channels) if channel + 1 in numbers)


class UnusablePlateError(Exception):
    """Error for a plate that cannot be decoded; the recording is read without it, and the message says why."""


@dataclass
class _FilePlate:
    """Force plate as stored in the file, with K samples, and the notes on it."""

    file: C3DFile
    metres: float  # size of POINT:UNITS, m, which is the unit of CORNERS and ORIGIN
    units: Mapping[str, str]  # configured units of force and moment
    index: int  # number in the file, counted from 1
    kind: int  # FORCE_PLATFORM:TYPE
    problem: str = ""  # reason why the plate cannot be used, or empty
    signals: PlateSignals | None = None  # None if the plate cannot be used
    ok: BoolArray = field(default_factory=lambda: np.zeros(0, bool))  # (K,) whether every channel is valid
    saturated: BoolArray | None = None  # (K,) whether a channel is saturated; None if no channel ever is
    dead: tuple[tuple[str, int], ...] = ()  # channel and plate axis (0 for x, 1 for y) of dead horizontal forces
    oddities: list[str] = field(default_factory=list)  # notes, as in ``Recording``
    assumptions: list[str] = field(default_factory=list)  # as in ``Plate``

    def read(self, stored: FloatArray) -> None:
        """Read the signals from the samples of the channels as stored; set ``problem`` if the plate cannot be used."""
        self.ok = np.zeros(len(stored), dtype=np.bool_)
        try:
            self._read_signals(stored)
        except UnusablePlateError as why:
            self.problem, self.assumptions = str(why), []
            return
        polynomial = self.file.numbers("FORCE_PLATFORM:FPCOPPOLY")
        if polynomial is not None and np.any(polynomial != 0):
            self._note(
                "the file contains a correction polynomial for the centre of pressure (Kistler, FPCOPPOLY), which was "
                "not applied: near the edges of the plate the centre of pressure may be some millimetres off"
            )
        if not self.ok.all():
            self._note(f"{int((~self.ok).sum())} analog samples are saturated or not finite")

    def _read_signals(self, stored: FloatArray) -> None:
        columns = self._find_columns()
        corners = self._read_parameter("CORNERS", (3, 4)).T * self.metres
        # The origin has negative z; the opposite vector of some old files is reversed.
        origin = np.zeros(3)
        if self.kind != 1:
            origin = self._read_parameter("ORIGIN", (3,)) * self.metres
            if origin[2] > 0:
                self._note(
                    f"ORIGIN points the wrong way (z = {origin[2]:.4f} m, expected below 0): the sign was corrected"
                )
                origin = origin * [1, 1, -1] if self.kind == 3 else -origin
        if self.kind == 3:
            origin = np.abs(origin) * [1, 1, -1]
            if not np.all(np.abs(origin[:2]) > 0):
                raise UnusablePlateError("ORIGIN has no sensor distances, which a type 3 plate needs")
        # Scaled samples (K, C), NaN if not finite
        offset, scale = (each[columns] for each in self.file.read_channel_scales())
        if not np.isfinite(scale).all():
            raise UnusablePlateError("ANALOG:SCALE is missing for some of its channels")
        read = _list_plate_channels(self.file)
        counts = stored[:, [read.index(column) for column in columns]]
        values = counts - offset
        with np.errstate(over="ignore", invalid="ignore"):
            values *= scale
        values[~np.isfinite(values)] = np.nan
        finite = np.isfinite(values).all(axis=1)
        if not finite.any():
            raise UnusablePlateError("no sample has numbers in all channels of the plate")
        bits = self.file.words("ANALOG:BITS")
        full = find_saturated(counts, offset, bits[0] if bits else None)
        if not (finite & ~full).any():
            raise UnusablePlateError("all of its samples are saturated or not finite")
        self.ok, self.saturated = np.asarray(finite & ~full), full if full.any() else None
        # Channels in N, m and N·m
        channels = self._subtract_baseline(values)
        if self.kind == 4:
            if self.units:
                self._note("its CAL_MATRIX gives N and N·mm: the units in the configuration were ignored")
            channels = self._apply_matrix(channels, scale)
        else:
            units = [unit for name in self.file.parts("ANALOG:UNITS") for unit in self.file.strings(name)]
            declared = [units[column] if column < len(units) else "" for column in columns]
            channels = channels * self._find_scales(declared)
        self.dead = self._find_dead_channels(values[self.ok], channels[self.ok], columns)
        self.signals = PlateSignals(self.kind, channels, origin, corners, self.file.per_frame * self.file.rate)

    def _note(self, oddity: str) -> None:
        self.oddities.append(f"plate {self.index}: {oddity}")

    def _find_columns(self) -> list[int]:
        """Return the analog channels of the plate, numbered from 0."""
        if self.kind not in _CHANNELS:
            raise UnusablePlateError(f"type {self.kind} is not supported (1, 2, 3 and 4 are)")
        if not self.file.channels:
            raise UnusablePlateError("the file contains no analog channels")
        kinds = self.file.words("FORCE_PLATFORM:TYPE") or []
        channel_map = self.file.numbers("FORCE_PLATFORM:CHANNEL")
        if channel_map is None or not np.isfinite(channel_map).all():
            raise UnusablePlateError("FORCE_PLATFORM:CHANNEL is missing or not numeric")
        channel_map = np.atleast_1d(channel_map)
        channel_map = channel_map.reshape(channel_map.shape[0], -1, order="F")
        needed = max(_CHANNELS.get(kind, 0) for kind in kinds)
        rows, plates = channel_map.shape
        if rows < needed:  # the columns of all plates are then shifted
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL has {rows} rows, a plate of this file needs {needed}")
        if plates < self.index:
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL describes only {plates} plates")
        channels = [int(channel) for channel in channel_map[: _CHANNELS[self.kind], self.index - 1]]
        for channel in channels:
            if not 1 <= channel <= self.file.channels:
                raise UnusablePlateError(
                    f"FORCE_PLATFORM:CHANNEL names channel {channel}, the file has {self.file.channels}"
                )
        if len(set(channels)) < len(channels):
            raise UnusablePlateError(f"FORCE_PLATFORM:CHANNEL names a channel twice: {channels}")
        for other, kind in enumerate(kinds[: self.index - 1]):
            common = sorted({int(each) for each in channel_map[: _CHANNELS.get(kind, 0), other]} & set(channels))
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
        if self.kind == 1 or len(zero) < 2 or last <= first or last > self.file.frames:
            return channels
        part = slice((first - 1) * self.file.per_frame, last * self.file.per_frame)
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
        level, excursion = float(baseline[parts].sum()), vertical - float(baseline[parts].sum())
        largest = float(excursion[np.argmax(np.abs(excursion))])
        small = abs(level) <= 0.1 * float(np.abs(vertical).max())
        if small or (level * largest < 0 and abs(largest) > 1.5 * abs(level)):  # an offset, not a load
            return np.asarray(channels - baseline)
        share = 100 * abs(level) / np.abs(vertical).max()
        self._note(
            f"the baseline frames {first} to {last} (ZERO) are loaded ({share:.0f} % of the peak): the "
            "baseline was not subtracted"
        )
        return channels

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

    def _find_scales(self, declared: Sequence[str]) -> FloatArray:
        """Return the factors (C,) that convert the channels of a plate of type 1, 2 or 3 to N, m and N·m.

        Every channel has its unit ``declared`` in ANALOG:UNITS, unless the configuration replaces it. A missing unit is
        taken from the other channels of the same quantity. If they have none either, N is assumed for forces,
        POINT:UNITS for lengths, and their product for moments. If all channels declare N, this is used for forces only,
        and the units of moments and lengths count as missing. Raises UnusablePlateError if a channel declares an
        unknown unit or a unit of another quantity.
        """
        quantities = np.array(_QUANTITIES[self.kind])
        names = [strip_padding(name) for name in declared]
        only_newtons = {find_force_scale(name) for name in names} == {1.0} and len(set(quantities)) > 1
        factors = np.ones(len(quantities))
        oddities: list[str] = []
        for quantity in dict.fromkeys(quantities.tolist()):
            at = np.flatnonzero(quantities == quantity)
            own = [names[i] for i in at]
            if (override := self.units.get(quantity)) is not None:
                scale_of = SCALES[quantity]
                other = sorted({name for name in own if name and scale_of(name) != scale_of(override)})
                if other:
                    oddities.append(
                        f"its {quantity} channels declare {', '.join(other)}, the configuration says {override}: "
                        f"{override} was used"
                    )
                own = [override] * len(own)
            elif only_newtons and quantity != "force":
                own = [""] * len(own)
            scales = [SCALES[quantity](name) for name in own]
            wrong = sorted({name for name, scale in zip(own, scales, strict=True) if name and scale is None})
            if wrong:
                remedy = (
                    f"if you know it, set `planarise: {{{quantity}_unit: …}}` in the configuration"
                    if quantity != "point"
                    else "export the file again with the units of its channels"
                )
                raise UnusablePlateError(
                    f"its {quantity} channels declare {', '.join(map(repr, wrong))}, which is not a known unit of "
                    f"{'length' if quantity == 'point' else quantity}; {remedy}"
                )
            if len(set(scales) - {None}) > 1:
                oddities.append(
                    f"its {quantity} channels declare different units ({', '.join(own)}): each was converted"
                )
            if None in scales:
                assumed = self._assume(quantity, own, scales, float(factors[0]))
                scales = [assumed if scale is None else scale for scale in scales]
            factors[at] = np.array(scales, dtype=np.float64)
        for oddity in oddities:
            self._note(oddity)
        return factors

    def _assume(self, quantity: str, own: Sequence[str], scales: Sequence[float | None], force: float) -> float:
        """Return the factor for channels without a declared unit, and keep a sentence that states the assumption."""
        known = {scale: name for scale, name in zip(scales, own, strict=True) if scale is not None}
        if len(known) > 1:
            raise UnusablePlateError(
                f"some of its {quantity} channels declare no unit, the others declare {', '.join(known.values())}; set "
                f"`planarise: {{{quantity}_unit: …}}` in the configuration"
            )
        length = {1e-3: "mm", 1e-2: "cm", 1.0: "m", 0.0254: "in"}[self.metres]
        if known:
            ((scale, name),) = known.items()
            self.assumptions.append(
                f"some of its {quantity} channels declare no unit: {name} was assumed, as for the others"
            )
            return float(scale)
        if quantity == "point":
            self.assumptions.append(f"its centre-of-pressure channels declare no unit of length: {length} was assumed")
            return self.metres
        if quantity == "moment" and force != 1.0:
            raise UnusablePlateError(
                "its moment channels declare no unit of moment, and its forces are not in N; set "
                "`planarise: {moment_unit: …}` in the configuration"
            )
        unit, scale = ("N", 1.0) if quantity == "force" else (f"N·{length}", self.metres)
        self.assumptions.append(f"its {quantity} channels declare no unit of {quantity}: {unit} was assumed")
        return scale

    def place(self, rotation: FloatArray, start: float, oddities: list[str]) -> Plate:
        """Return the plate in the lab with the wrench of the ground on the body; add notes to ``oddities``.

        ``rotation`` (3, 3) turns from the axes of the file to those of the lab; ``start`` is the first sample's time,
        s.
        """
        rate = self.file.per_frame * self.file.rate
        assumptions = tuple(f"plate {self.index}: {text}" for text in self.assumptions)
        oddities += [*self.oddities, *assumptions]
        kind, signals, problem = f"type {self.kind}", self.signals, self.problem
        if signals is not None:
            corners = signals.corners @ rotation.T
            axes = compute_plate_axes(corners)
            if not np.isfinite(axes).all():
                problem = "CORNERS do not form a rectangle"
            elif axes[2, 2] > -0.5:
                problem = (
                    f"CORNERS make its z axis point {'up' if axes[2, 2] > 0.5 else 'sideways'}; "
                    "the expected order is +x+y, -x+y, -x-y, +x-y with z down"
                )
        if signals is None or problem:
            oddities.append(f"plate {self.index} is not used: {problem}")
            missing = np.full((len(self.ok), 3), np.nan)
            ok = np.zeros(len(self.ok), bool)
            return Plate(self.index, kind, None, missing, missing.copy(), ok, rate, start, problem)
        force, moment = (part @ axes.T for part in compute_surface_wrench(signals))
        force, moment = reverse_force_on_plate(self.index, force, moment, self.ok, oddities)
        moment = moment + np.cross(corners.mean(axis=0), force)
        dead = tuple((name, axes[:, axis]) for name, axis in self.dead)
        saturated = self.saturated
        plate = Plate(self.index, kind, corners, force, moment, self.ok, rate, start, "", assumptions, saturated, dead)
        # A load beside the plate means that a unit, the origin or a corner is wrong.
        most = force[self.ok, 2].max(initial=0.0)
        good = self.ok & (force[:, 2] > max(LOADED_N, 0.1 * most))
        away = compute_centre_of_pressure(plate, plate)[good] - corners.mean(axis=0)[:2]
        inside = np.ones(len(away), bool)
        for side in (corners[0] - corners[1], corners[0] - corners[3]):
            half = np.linalg.norm(side) / 2
            inside &= np.abs(away @ side[:2]) / (2 * half) < half + _ON_PLATE_M
        if len(away) and inside.mean() < _SHARE_ON_PLATE:
            oddities.append(
                f"plate {self.index}: the centre of pressure lies off the plate in {100 * (1 - inside.mean()):.0f} % "
                "of its loaded samples: check its corners, ORIGIN and moment units"
            )
        return plate


def find_saturated(counts: FloatArray, offset: FloatArray, bits: int | None) -> BoolArray:
    """Return for each of K samples whether any of the C channels is saturated.

    ``counts`` (K, C) are the samples as stored, ``offset`` (C,) those at zero input, about half the range for unsigned
    converters, and ``bits`` is the resolution (ANALOG:BITS), None if not declared. From it follow the limits of the
    converter if the samples are integers; otherwise :func:`find_clipped` judges each channel.
    """
    flags = np.zeros(len(counts), bool)
    for stored, zero in zip(counts.T, offset, strict=True):
        column = np.where(np.isfinite(stored), stored, np.nan)
        finite = column[np.isfinite(column)]
        if finite.size == 0 or np.ptp(finite) == 0:
            continue
        if np.abs(finite - np.round(finite)).max() < 1e-3:
            # a converter uses offset binary or two's complement
            resolution = bits if bits in (12, 14, 16) else (12 if 1900 < abs(zero) < 2200 else 16)
            span = 2.0**resolution
            low, high = (0.0, span - 1) if abs(zero) > span / 4 else (-span / 2, span / 2 - 1)
            flags |= (column <= low + 0.5) | (column >= high - 0.5)
        else:
            flags |= find_clipped(column - zero)
    return flags


def find_clipped(column: FloatArray) -> BoolArray:
    """Return for each sample (K,) whether it is clipped: it equals an extreme that occurs at least 8 times in a row.

    Extremes near zero are not judged, nor is a channel that often repeats other values, because it is coarse or at
    rest. ``column`` (K,) is the signal minus its zero level; NaN if missing.
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
