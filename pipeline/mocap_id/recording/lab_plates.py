"""Force plates: wrench from the channels of types 1 to 4, its sign, and resampling to the times of the markers.

Sign convention: the wrench is that of the ground on the body, about the lab origin. The vertical force under a standing
person is positive. A file with the opposite sign (force of the body on the plate) is recognised and reversed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.model import Plate

LOADED_N = 20.0
"""Below this vertical force, neither the sign nor the centre of pressure of a plate is meaningful."""

_ROUNDING = 1e-6  # relative tolerance of times that a file stores in single precision
_FASTER = 1.001  # ratio of plate rate to marker rate above which samples are averaged
_THINNED_HZ = 60.0  # lowest frame rate of thinned recordings
_SPIKE = 5.0  # largest weight of a sample for the sign, in median loads


@dataclass(frozen=True)
class PlateSignals:
    """Channels of one plate of type 1 to 4 and its geometry, SI units; its frame is right-handed with z down."""

    kind: int  # FORCE_PLATFORM:TYPE
    # (K, C). Type 1: Fx Fy Fz (N), CoPx CoPy (m), Tz (N·m). Types 2 and 4: Fx Fy Fz (N), Mx My Mz (N·m), after
    # calibration. Type 3: Fx12 Fx34 Fy14 Fy23 Fz1 Fz2 Fz3 Fz4 (N).
    channels: FloatArray
    # (3,) in the plate frame, m. Types 2 and 4: from the transducer to the centre of the working surface (z negative).
    # Type 3: half the distances between sensors along x and y, and z as for type 2. Type 1: zero.
    origin: FloatArray
    corners: FloatArray  # (4, 3) in the lab, in the order +x+y, -x+y, -x-y, +x-y, m
    rate: float  # samples per second


def compute_surface_wrench(plate: PlateSignals) -> tuple[FloatArray, FloatArray]:
    """Return force (K, 3), N, and moment (K, 3) about the centre of the working surface, N·m, in the plate frame."""
    if plate.kind == 1:
        force = plate.channels[:, :3]
        point = np.column_stack([plate.channels[:, 3:5], np.zeros(len(force))])
        moment = np.cross(point, force)
        moment[:, 2] += plate.channels[:, 5]
        return force, moment
    if plate.kind == 3:
        # The three-component sensors 1 (+x+y), 2 (-x+y), 3 (-x-y) and 4 (+x-y) are at ±a along x and ±b along y. The
        # moment is about the point between them, in their plane.
        x12, x34, y14, y23, z1, z2, z3, z4 = plate.channels.T
        a, b = plate.origin[0], plate.origin[1]
        force = np.column_stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4])
        mx, my, mz = b * (z1 + z2 - z3 - z4), a * (-z1 + z2 + z3 - z4), b * (-x12 + x34) + a * (y14 - y23)
        moment, arm = np.column_stack([mx, my, mz]), np.array([0.0, 0.0, plate.origin[2]])
    else:
        force, moment, arm = plate.channels[:, :3], plate.channels[:, 3:6], plate.origin
    return force, moment - np.cross(arm, force)


def compute_plate_axes(corners: FloatArray) -> FloatArray:
    """Return the plate's axes in the lab as columns, (3, 3); NaN if the corners do not form a rectangle.

    x points from corners 2 and 3 to corners 1 and 4, y from corners 3 and 4 to corners 1 and 2, and z = x × y.
    """
    x = corners[0] - corners[1] + corners[3] - corners[2]
    y = corners[0] - corners[3] + corners[1] - corners[2]
    z = np.cross(x, y)
    lengths = np.array([np.linalg.norm(v) for v in (x, y, z)])
    if not np.all(lengths > 1e-6) or abs(x @ y) > 0.2 * lengths[0] * lengths[1]:
        return np.full((3, 3), np.nan)
    ex, ez = x / lengths[0], z / lengths[2]
    return np.column_stack([ex, np.cross(ez, ex), ez])


@dataclass(frozen=True)
class PlateSamples:
    """Wrench of a plate at F given times, as in :class:`mocap_id.recording.Plate`."""

    force: FloatArray  # (F, 3) N; NaN where ``ok`` is False
    moment: FloatArray  # (F, 3) about the lab origin, N·m; NaN where ``ok`` is False
    ok: BoolArray  # (F,) whether every analog sample of the average is valid


def decimate(plate: Plate, times: FloatArray, rate: float) -> PlateSamples:
    """Return the wrench of a plate averaged over one marker interval T, centred on every marker time t.

    ``times`` (F,) are marker times on the clock of the plate, s; ``rate`` is in marker frames per second. The mean of
    the piecewise linear signal over [t - T/2, t + T/2] is symmetric about t for every ratio of the rates, so there is
    no lag; averaging blocks of samples could shift the wrench by half a block. At the ends of the signal the interval
    shrinks symmetrically. Plates that are not sampled faster than the markers are interpolated. Samples outside the
    plate's time are NaN.
    """
    samples = np.where(plate.ok[:, None], np.concatenate([plate.force, plate.moment], axis=1), 0.0)
    last = len(samples) - 1
    at = (times - plate.start) * plate.rate  # in samples
    inside = (at >= -_ROUNDING * max(last, 1)) & (at <= last * (1 + _ROUNDING) + _ROUNDING)
    if last < 1:
        empty = np.full((len(times), 3), np.nan)
        return PlateSamples(empty, empty.copy(), np.zeros(len(times), bool))
    centre = np.clip(at, 0, last)
    ratio = plate.rate / rate
    half = np.minimum(ratio / 2 if ratio > _FASTER else 0.0, np.minimum(centre, last - centre))
    low = np.minimum(centre.astype(np.int64), last - 1)
    part = (centre - low)[:, None]
    single = samples[low] * (1 - part) + samples[low + 1] * part
    integral = np.zeros_like(samples)
    np.cumsum((samples[1:] + samples[:-1]) / 2, axis=0, out=integral[1:])

    def primitive(at: FloatArray) -> FloatArray:
        low = np.minimum(at.astype(np.int64), last - 1)
        part = (at - low)[:, None]
        return np.asarray(integral[low] + samples[low] * part + (samples[low + 1] - samples[low]) * part**2 / 2)

    average = (primitive(centre + half) - primitive(centre - half)) / np.maximum(2 * half, 1e-12)[:, None]
    mean = np.where((half > 1e-9)[:, None], average, single)
    # An average is invalid if one of its samples is.
    count = np.concatenate([[0], np.cumsum(~plate.ok)])
    first = np.floor(centre - half + _ROUNDING).astype(np.int64)
    final = np.minimum(np.ceil(centre + half - _ROUNDING).astype(np.int64), last)
    ok = inside & ~(count[final + 1] > count[np.maximum(first, 0)])
    mean[~ok] = np.nan
    return PlateSamples(mean[:, :3], mean[:, 3:], ok)


@dataclass(frozen=True)
class ThinnedFrames:
    """L frames of a recording, thinned to 60 to 120 Hz for statistics, with plates averaged to the same times.

    Thinning changes means, percentiles, principal axes and speeds over 0.1 s by less than their uncertainty, since skin
    motion and sway hardly change within a tenth of a second. Markers are sampled, not averaged, so that gaps and jumps
    do not spread, and motion above 30 Hz keeps its mean and variance. Plates are averaged, because mains hum sampled at
    60 Hz would become a constant force. Recordings below 120 Hz keep all frames. Computations that count single frames
    (swaps, jumps, gaps, saturation) need all frames and must not use this class.
    """

    step: int  # every ``step``-th frame is kept, starting with the first
    positions: FloatArray  # (L, M, 3) markers, lab axes with Z up, m; a view of the original array
    time: FloatArray  # (L,) s
    rate: float  # frames per second after thinning
    samples: tuple[PlateSamples, ...]  # wrench of every plate at these times

    @classmethod
    def of(cls, positions: FloatArray, time: FloatArray, rate: float, plates: Sequence[Plate] = ()) -> ThinnedFrames:
        """Thin frames with positions (F, M, 3), m, and times (F,), s, and average the plates to the thinned frames."""
        step = max(1, int(rate / _THINNED_HZ))
        time, rate = time[::step], rate / step
        return cls(step, positions[::step], time, rate, tuple(decimate(plate, time, rate) for plate in plates))


def compute_averaging_width(analog_rate: float | None, rate: float) -> float:
    """Return the width of the moving average that is equivalent to :func:`decimate`, s; 0 if nothing is averaged.

    A moving average over the width W adds W²/24 times its second derivative to a signal. :func:`decimate` adds T²/24 by
    the mean over the frame interval T, and Δ²/12 by the linear interpolation between samples at intervals Δ.
    ``analog_rate`` is None if there are no plates. Rates are in Hz.
    """
    if analog_rate is None or analog_rate / rate <= _FASTER:
        return 0.0
    return float(np.sqrt(rate**-2 + 2.0 * analog_rate**-2))


def reverse_force_on_plate(
    index: int, force: FloatArray, moment: FloatArray, ok: BoolArray, oddities: list[str]
) -> tuple[FloatArray, FloatArray]:
    """Return force and moment (K, 3) of the ground on the body; those of the body on the plate are reversed.

    The vertical force of the valid samples, ``ok`` (K,), decides; a reversal is noted in ``oddities``.
    """
    if not is_force_on_plate(force[ok, 2]):
        return force, moment
    oddities.append(f"plate {index} measures the force of the body on the plate: the signs were reversed")
    return -force, -moment


def is_force_on_plate(vertical: FloatArray) -> bool:
    """Return whether a force is that of the body on the plate, which points mostly down under load.

    ``vertical`` (K,) is the upward force of valid samples, N. The sign of the mean of all samples above 20 N in
    magnitude decides; each sample is limited to five times their median magnitude. A few spikes therefore do not
    outweigh a person, and an offset of the unloaded plate does not outweigh a short contact.
    """
    loaded = vertical[np.abs(vertical) > LOADED_N]
    if not loaded.size:
        return False
    most = _SPIKE * float(np.median(np.abs(loaded)))
    return bool(np.clip(loaded, -most, most).mean() < 0)


def compute_centre_of_pressure(plate: Plate, wrench: Plate | PlateSamples) -> FloatArray:
    """Return the centre of pressure (K, 2) of ``wrench`` on ``plate`` in the lab, m; NaN at 20 N or less."""
    centre = np.zeros(3) if plate.centre is None else plate.centre
    about = wrench.moment - np.cross(centre, wrench.force)
    vertical = np.where(wrench.force[:, 2] > LOADED_N, wrench.force[:, 2], np.nan)
    return centre[:2] + np.column_stack([-about[:, 1], about[:, 0]]) / vertical[:, None]
