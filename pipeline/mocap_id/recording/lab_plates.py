"""Force plates in lab coordinates, resampled to the times of the markers.

Sign convention: the wrench is that of the ground on the body, about the lab origin. The vertical force under a standing
person is positive. A file with the opposite sign (force of the body on the plate) is recognised and reversed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.c3d_plates import StoredPlate
from mocap_id.recording.model import Plate
from mocap_id.recording.plate_types import compute_plate_axes, compute_surface_wrench

_ROUNDING = 1e-6  # relative tolerance of times that a file stores in single precision
_FASTER = 1.001  # ratio of plate rate to marker rate above which samples are averaged
_THINNED_HZ = 60.0  # lowest frame rate of thinned recordings


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
    mean = np.where((half > 1e-9)[:, None], _average_intervals(samples, centre, half), _interpolate(samples, centre))
    ok = inside & ~_contains_bad(~plate.ok, centre - half, centre + half)
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


def _interpolate(samples: FloatArray, at: FloatArray) -> FloatArray:
    low = np.minimum(at.astype(np.int64), len(samples) - 2)
    part = (at - low)[:, None]
    return np.asarray(samples[low] * (1 - part) + samples[low + 1] * part)


def _average_intervals(samples: FloatArray, centre: FloatArray, half: FloatArray) -> FloatArray:
    """Return the mean of the piecewise linear signal over ``centre`` ± ``half``, both (F,) in samples."""
    integral = np.zeros_like(samples)
    np.cumsum((samples[1:] + samples[:-1]) / 2, axis=0, out=integral[1:])

    def primitive(at: FloatArray) -> FloatArray:
        low = np.minimum(at.astype(np.int64), len(samples) - 2)
        part = (at - low)[:, None]
        return np.asarray(integral[low] + samples[low] * part + (samples[low + 1] - samples[low]) * part**2 / 2)

    width = np.maximum(2 * half, 1e-12)[:, None]
    return np.asarray((primitive(centre + half) - primitive(centre - half)) / width)


def _contains_bad(bad: BoolArray, start: FloatArray, stop: FloatArray) -> BoolArray:
    """Return for each interval from ``start`` to ``stop``, (F,) in samples, whether it contains an invalid sample."""
    count = np.concatenate([[0], np.cumsum(bad)])
    low = np.floor(start + _ROUNDING).astype(np.int64)
    high = np.minimum(np.ceil(stop - _ROUNDING).astype(np.int64), len(bad) - 1)
    return np.asarray(count[high + 1] > count[np.maximum(low, 0)])


LOADED_N = 20.0
"""Below this vertical force, neither the sign nor the centre of pressure of a plate is meaningful."""

_ON_PLATE_M = 0.05
_SHARE_ON_PLATE = 0.8
_SPIKE = 5.0


def place_plate(stored: StoredPlate, rotation: FloatArray, start: float, rate: float, oddities: list[str]) -> Plate:
    """Return a stored plate as a plate in the lab with the wrench of the ground on the body; add notes to ``oddities``.

    ``rotation`` (3, 3) rotates vectors from the file's axes to the axes of the lab (Z up). ``start`` is the time of the
    first analog sample, s; ``rate`` is in samples per second.
    """
    assumptions = tuple(f"plate {stored.index}: {text}" for text in stored.assumptions)
    oddities += [*stored.oddities, *assumptions]
    kind, signals, problem = f"type {stored.kind}", stored.signals, stored.problem
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
        oddities.append(f"plate {stored.index} is not used: {problem}")
        missing = np.full((len(stored.ok), 3), np.nan)
        ok = np.zeros(len(stored.ok), bool)
        return Plate(stored.index, kind, None, missing, missing.copy(), ok, rate, start, problem)
    force, moment = (part @ axes.T for part in compute_surface_wrench(signals))
    force, moment = reverse_force_on_plate(stored.index, force, moment, stored.ok, oddities)
    moment = moment + np.cross(corners.mean(axis=0), force)
    plate = Plate(stored.index, kind, corners, force, moment, stored.ok, rate, start)
    oddities += _note_load_off_plate(plate)
    dead = tuple((name, axes[:, axis]) for name, axis in stored.dead)
    return replace(plate, assumptions=assumptions, saturated=stored.saturated, dead=dead)


def reverse_force_on_plate(
    index: int, force: FloatArray, moment: FloatArray, ok: BoolArray, oddities: list[str]
) -> tuple[FloatArray, FloatArray]:
    """Return force and moment (K, 3) of the ground on the body; those of the body on the plate are reversed.

    The vertical force of the valid samples, ``ok`` (K,), decides. If the signs are reversed, a note is added to
    ``oddities``.
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
    """Return the centre of pressure (K, 2) of ``wrench`` on the surface of ``plate``, in lab axes, m.

    It is NaN if the vertical force is at most 20 N.
    """
    centre = np.zeros(3) if plate.centre is None else plate.centre
    about = wrench.moment - np.cross(centre, wrench.force)
    vertical = np.where(wrench.force[:, 2] > LOADED_N, wrench.force[:, 2], np.nan)
    return centre[:2] + np.column_stack([-about[:, 1], about[:, 0]]) / vertical[:, None]


def _note_load_off_plate(plate: Plate) -> list[str]:
    """Return a note if the load acts beside the plate, which means that a unit, the origin or a corner is wrong."""
    assert plate.corners is not None
    most = plate.force[plate.ok, 2].max(initial=0.0)
    good = plate.ok & (plate.force[:, 2] > max(LOADED_N, 0.1 * most))
    if not good.any():
        return []
    point = compute_centre_of_pressure(plate, plate)[good]
    x, y = plate.corners[0] - plate.corners[1], plate.corners[0] - plate.corners[3]
    away = point - plate.corners.mean(axis=0)[:2]
    inside = np.ones(len(point), bool)
    for side in (x, y):
        half = np.linalg.norm(side) / 2
        inside &= np.abs(away @ side[:2]) / (2 * half) < half + _ON_PLATE_M
    if inside.mean() >= _SHARE_ON_PLATE:
        return []
    return [
        f"plate {plate.index}: the centre of pressure lies off the plate in {100 * (1 - inside.mean()):.0f} % of its "
        "loaded samples: check its corners, ORIGIN and moment units"
    ]
