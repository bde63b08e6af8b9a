"""Coarse search for the clock offset between cameras and force plates, before anything is computed from both.

The clock offset δ means that the plates' sample with the time stamp t was taken at t + δ on the cameras' clock. The
fit of identify-dim determines it to a fraction of a millisecond, but its cost has many minima: it must start near the
right one. Mass, drop-outs, chair contact and the use of the plates also need forces and markers of the same time.

The vertical force on a body is F(t - δ) = Σ m_k (g + a_k(t)), with the vertical accelerations a_k of its lower, middle
and upper third. For every δ within ± 5 s, the masses are fitted, and the rms of the rest is the cost of δ. Gravity and
acceleration have the same masses, so a resting force never explains a movement. Slow changes, as by a load that is
lifted off the floor, count only a fifth. Below 40 % of the rise of the body, a chair may carry a part of it; these
samples are left out if the cost is then clearer.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import GRAVITY, FloatArray, IntArray
from mocap_id.plates.choice import average_markers, group_by_height
from mocap_id.recording import Plate, decimate
from mocap_id.recording.sample_checks import measure_body_height

_RANGE_S = 5.0  # largest offset that is tried
_STEP_S = 0.025  # step of the search; the cost is smooth over about 0.1 s
# accelerations and forces are averaged with triangular weights over the first time before and after, s; over the second
# if the offset is not known otherwise, because the markers may be noisy
_AVERAGED_S = 0.1, 0.2
_SLOW_S, _SLOW_SHARE = 1.5, 0.2  # duration of the weighted mean that counts as slow, s, and its share in the cost
_SAMPLES_HZ = 10.0  # number of averaged samples per second that are compared
_EXPLAINED = 0.8  # largest cost at a peak as a fraction of the standard deviation of the force
_UNLOADED = 0.04  # fraction of the largest load below which nothing is measured
_LEAST = 15  # smallest number of samples at an offset
_KEPT = 0.5  # smallest fraction of samples and of movement that is measured by both at an offset
_RISES_M, _OFF_CHAIR = 0.15, 0.4  # smallest rise of a body that sits down, and fraction of it above any chair
# smaller coarse offsets are not applied, because the fit finds them; the error of the search is up to 0.04 s
_NEAR_S = 0.08
# Largest cost at a peak as a fraction of the usual cost; the second value is for small movements, as in standing. At
# the right offset it is 0.05 to 0.51 in real and simulated recordings.
_CLEAR, _VERY_CLEAR = 0.65, 0.35
# Ratio of costs below which two offsets are equally good; larger for offsets below the last value, s, which are common.
# Repetitions of people differ by 1.5 and more.
_EQUAL, _EQUAL_NEAR_0, _SYNCHRONOUS_S = 1.25, 1.5, 0.15
_FLOOR = 0.12  # costs that differ by less than this fraction of the usual cost are equal
# smallest relative cost with the low samples, and largest ratio of that without them, for which they are left out
_WHOLE, _CLEARER = 0.3, 0.67
_APART_S = 0.2  # minima that are closer belong to the same peak
_STAYS_M, _TRAVELS_M = 0.1, 0.8  # largest horizontal movements of a marker of the base, and of the usual marker
# smallest rms of force and inertia, as fractions of the weight: that a peak can be trusted, and that it is expected
_SEEN, _MOVES = 0.003, 0.02


@dataclass(frozen=True)
class ClockSearch:
    """Result of the coarse search."""

    offset_s: float = 0.0  # offset by which the plates' clock was corrected, s; 0 if it is not clearly different from 0
    peak_s: float | None = None  # offset at which the forces follow the movement best, s; None if there is no such peak
    rivals_s: tuple[float, ...] = ()  # other offsets that explain the forces equally well, s
    why: str | None = None  # reason why the offset is not known; None if it is known, or if nothing moves

    def facts(self) -> dict[str, Any]:
        """Return the fact ``clock`` of wrench.parquet."""
        return asdict(self) | {"rivals_s": list(self.rivals_s)}


def find_clock_offset(
    plates: Sequence[Plate], positions: FloatArray, time: FloatArray, rate: float, *, frame_s: float
) -> ClockSearch:
    """Find the clock offset of the plates to about 0.03 s, rounded to a multiple of ``frame_s``, s.

    ``plates`` are all loaded plates, under the feet or under a chair; ``time`` (F,) are the times of ``positions``, s.
    """
    searches = (_search(plates, positions, time, rate, frame_s=frame_s, averaged=averaged) for averaged in _AVERAGED_S)
    first = next(searches)
    if first.why is None:
        return first
    return next((other for other in searches if other.why is None and other.peak_s is not None), first)


def _search(
    plates: Sequence[Plate], positions: FloatArray, time: FloatArray, rate: float, *, frame_s: float, averaged: float
) -> ClockSearch:
    """Return the result with accelerations and forces averaged over the time ``averaged``, s, before and after."""
    half, beyond, groups = max(1, round(averaged * rate)), round(_RANGE_S * rate), group_by_height(positions)
    if not plates or not groups or len(positions) < 4 * half:
        return ClockSearch()
    # a marker must stay at its place and the others near it: the plates do not always carry a person who walks
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # markers that are never visible
        away = np.linalg.norm(np.subtract(*np.nanpercentile(positions[::4, :, :2], [98, 2], axis=0)), axis=1)
        if not (np.nanmin(away) < _STAYS_M and np.nanmedian(away) < _TRAVELS_M):
            return ClockSearch()
    second = (positions[2 * half :] - 2 * positions[half:-half] + positions[: -2 * half]) * (rate / half) ** 2
    acceleration = np.full((len(positions), len(groups)), np.nan)
    acceleration[half:-half] = np.stack([average_markers(second[:, group])[:, 2] for group in groups], axis=1)
    stamped = time[0] + np.arange(-beyond, len(time) + beyond) / rate
    # saturated samples count, because those without them are not spread evenly over the movement
    whole = [plate if plate.saturated is None else replace(plate, ok=plate.ok | plate.saturated) for plate in plates]
    total = sum((decimate(plate, stamped, rate).force[:, 2] for plate in whole), np.zeros(len(stamped)))
    with np.errstate(invalid="ignore"):
        total[total < _UNLOADED * np.nanmax(total, initial=0.0)] = np.nan  # a loose cable, or a flight
    weights = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]) / half**2
    force = np.full(len(total), np.nan)
    force[half - 1 : len(total) - half + 1] = np.convolve(total, weights, "valid")
    slow = np.hanning(2 * round(_SLOW_S * rate / 2) + 1)
    sharp = force - (1.0 - _SLOW_SHARE) * _smooth(force[:, None], slow)[:, 0]
    need = GRAVITY + acceleration
    need -= (1.0 - _SLOW_SHARE) * _smooth(need, slow)

    height, seen = measure_body_height(positions), np.isfinite(acceleration).all(axis=1)
    low, high = np.nanpercentile(height, [2, 98]) if np.isfinite(height).any() else (0.0, 0.0)
    gates = [seen]
    if high - low > _RISES_M:
        with np.errstate(invalid="ignore"):
            gates.append(seen & (height > low + _OFF_CHAIR * (high - low)))
    steps = np.arange(-(beyond // (each := max(1, round(_STEP_S * rate)))), beyond // each + 1) * each
    curves = []
    for gate in gates:
        used = np.flatnonzero(gate)[:: max(1, int(rate / _SAMPLES_HZ))]
        curves.append((need[used], used, _compute_costs(need[used], sharp, used + beyond, steps)))
    known = [(rows, used, cost) for rows, used, cost in curves if np.isfinite(cost).sum() > 2]
    if not known:
        return ClockSearch()
    ratios = [float(np.nanmin(cost) / np.nanmedian(cost)) for _, _, cost in known]
    rows, used, cost = known[-1 if ratios[0] > _WHOLE and ratios[-1] < _CLEARER * ratios[0] else 0]
    usual, best = float(np.nanmedian(cost)), float(np.nanmin(cost))
    weight = float(np.nanmedian(total[beyond:-beyond]))
    inertia = weight / GRAVITY * float(np.nanstd(acceleration[used].mean(axis=1)))
    moves = min(float(np.nanstd(force[beyond:-beyond])), inertia) / max(abs(weight), 1e-9)
    if moves < _SEEN or (best > _VERY_CLEAR * usual and moves < _MOVES):
        return ClockSearch()
    at_best = sharp[used + beyond - steps[int(np.nanargmin(cost))]]
    if best > min(_CLEAR * usual, _EXPLAINED * float(np.nanstd(at_best))):
        return ClockSearch(why=f"at no offset within ± {_RANGE_S:g} s do the forces follow the movement of the markers")
    # minima that are as good as the best one, the smallest offset first
    before, after = (np.nan_to_num(np.roll(cost, by), nan=np.inf) for by in (1, -1))
    before[0] = after[-1] = np.inf
    lowest = np.flatnonzero((cost <= before) & (cost <= after))
    # between the steps, the square of the cost is a parabola
    least, left, right = cost[lowest] ** 2, before[lowest] ** 2, after[lowest] ** 2
    inner = np.isfinite(left) & np.isfinite(right) & (left + right > 2 * least)
    left, right = left[inner], right[inner]
    least[inner] -= (left - right) ** 2 / (8 * (left + right - 2 * least[inner]))
    least = np.sqrt(np.maximum(least, 0.0))
    equal = np.where(np.abs(steps[lowest]) <= _SYNCHRONOUS_S * rate, _EQUAL_NEAR_0, _EQUAL)
    good = lowest[least <= np.maximum(equal * least.min(), least.min() + _FLOOR * usual)]
    peaks: list[int] = []
    for k in good[np.argsort(cost[good])]:
        if all(abs(steps[k] - steps[other]) > _APART_S * rate for other in peaks):
            peaks.append(int(k))
    peaks.sort(key=lambda k: abs(int(steps[k])))
    around = steps[peaks[0]] + np.arange(-each, each + 1)
    fine = _compute_costs(rows, sharp, used + beyond, around)
    offset = float(around[np.nanargmin(fine)] / rate)
    if steps[peaks[0]] in (steps[0], steps[-1]):
        return ClockSearch(why=f"the forces follow the movement best at {offset:+.1f} s, the end of the search")
    applied = round(offset / frame_s) * frame_s if abs(offset) > _NEAR_S else 0.0
    rivals = tuple(float(steps[k] / rate) for k in peaks[1:])
    why = None
    if rivals:
        listed = " or ".join(f"{each:+.2f} s" for each in (offset, *rivals))
        why = f"the movement repeats so regularly that the forces fit it equally well at offsets of {listed}"
    return ClockSearch(applied, offset, rivals, why)


def _smooth(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the weighted means (F, k) of the known values around each sample; NaN where a value is not known."""
    known, kept = np.isfinite(values), slice(len(weights) // 2, len(weights) // 2 + len(values))
    total = np.stack([np.convolve(column, weights)[kept] for column in np.where(known, values, 0.0).T], axis=1)
    count = np.stack([np.convolve(column, weights)[kept] for column in known.T.astype(np.float64)], axis=1)
    return np.where(known, total / np.maximum(count, 1e-12), np.nan)


def _compute_costs(rows: FloatArray, force: FloatArray, at: IntArray, shifts: IntArray) -> FloatArray:
    """Return the rms (S,) of the force that the rows (R, k) do not explain if the plates are late by ``shifts`` (S,).

    ``force`` (T,) is sampled like the markers, whose samples are at the indices ``at`` (R,). The rms is divided by the
    fraction of samples that remain, because a few samples agree by chance. It is NaN if too few samples or too little
    of the movement remain.
    """
    measured = force[np.clip(at - shifts[:, None], 0, len(force) - 1)]  # (S, R)
    known = np.isfinite(measured)
    measured, both = np.where(known, measured, 0.0), known.astype(np.float64)
    common, count, width = rows.mean(axis=1), both.sum(axis=1), rows.shape[1]
    power, square = (common - common.mean()) ** 2, np.sum(measured**2, axis=1)
    normal = (both @ (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)).reshape(-1, width, width)
    right = measured @ rows
    most, seen = count.max(initial=0.0), both @ power  # forces may be shorter than the recording
    enough = (count >= max(_LEAST, _KEPT * most)) & (seen >= _KEPT * seen.max(initial=0.0))
    normal[~enough] = np.eye(width)
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(width)  # two thirds may move alike
    masses = np.linalg.solve(normal + ridge, right[..., None])[..., 0]
    rest = square - 2 * np.sum(masses * right, axis=1) + np.einsum("sk,skl,sl->s", masses, normal, masses)
    together = square - (measured @ common) ** 2 / np.maximum(both @ common**2, 1e-12)  # all parts have one mass
    rest = np.where((masses < 0.0).any(axis=1), together, rest)
    spread = np.sqrt(np.maximum(rest, 0.0) / np.maximum(count - width, 1.0))
    return np.where(enough, spread * most / np.maximum(count, 1.0), np.nan)
