"""Curls of the elbow: repetitions, end of the trial, compensation, torque and fatigue (thesis 8.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import stdtrit

from mocap_id.arrays import (
    GRAVITY,
    NORMAL_95,
    BoolArray,
    FloatArray,
    IntArray,
    find_complete_rows,
    find_runs,
    interpolate_gaps,
)
from mocap_id.dynamics.preparation import LowPass

_NEAR = 0.02  # share of the amplitude: if the flexion is nearer to a turning point, the elbow rests
_FAR = 0.1  # share of the amplitude: if the flexion is farther from a turning point, the elbow moves
_BESIDE = 0.1  # s: within this time of an event at the end of a long rest, the flexion must be measured
_REST = 0.5  # s: a longer rest does not belong to a curl
_ONSET = 1.2  # in a minimum-jerk movement (Flash and Hogan 1985), the ratio of the times for 0 to 2 % and 2 to 10 %
_LARGE = 80.0  # percentile of the rises that represents the large curls of the trial
_NOISE = 6.0  # smallest rise of an attempt, in standard deviations of the angle
_FEWEST = 4  # smallest number of curls with a known value for a trend
_RATE = 120.0  # Hz: enough samples for the turning points


@dataclass(frozen=True)
class CurlRules:
    """Rules for curls, compensation and the end of the trial."""

    metronome: float | None  # tempo of the metronome, curls per second; None if no tempo is required
    attempt: float  # smallest rise of the elbow's flexion that counts as an attempt, rad
    complete: float  # smallest rise of a complete curl as a share of the large curls of the trial
    # largest difference of a curl's duration from the period of the metronome, as a share of the period
    tempo: float
    pause: float  # longest pause between two curls, in periods; after a longer pause, the person has stopped
    plane: float  # largest rotation of the elbow's axis from its direction in the first curl, rad
    compensation: float  # smallest change of an angle of shoulder or thorax that counts as compensation, rad
    sustained: float  # shortest duration of a compensation and of motion out of the plane, s


@dataclass(frozen=True)
class Curl:
    """A curl or a failed attempt."""

    # Start, top, end: times of start, top (middle of the time at the top) and end, s. ``end`` is NaN if it is not
    # recorded.
    start: float
    top: float
    end: float
    amplitude: float  # rise of the flexion from start to top, rad
    complete: bool  # whether the curl rises and returns far enough
    why: str = ""  # reason why the curl is not complete, or why an event is unknown; otherwise empty
    unknown: bool = False  # whether it is unknown if the curl is complete, because the arm is not measured there

    @property
    def timed(self) -> bool:
        """Whether the curl is complete, and its start and end are known."""
        return self.complete and bool(np.isfinite(self.end - self.start))


def find_curls(
    time: FloatArray, flexion: FloatArray, sd: FloatArray, rules: CurlRules, measured: BoolArray | None = None
) -> tuple[Curl, ...]:
    """Find the curls of a trial, in order of time.

    In a curl, the flexion rises from a low to a high turning point and returns. The curl is complete if both the rise
    and the return are at least ``rules.complete`` times the rise in the large curls of the trial. An event, and the
    amplitude to it, are NaN if it may lie where the flexion is not measured.

    ``time`` (T,) are the sample times, s; ``flexion`` and ``sd`` (T,) are the flexion of the elbow and its standard
    deviation, rad, NaN where unknown. ``measured`` (T,) marks the samples in which the flexion is measured; by default,
    those in which it is known.
    """
    gaps = find_runs(~np.isfinite(flexion) if measured is None else ~(measured & np.isfinite(flexion)))
    holes = np.array([(time[gap.start], time[gap.stop - 1]) for gap in gaps]).reshape(-1, 2)
    known = np.flatnonzero(np.isfinite(flexion))
    if len(known) < 2:
        return ()
    step = max(1, round((len(known) - 1) / (time[known[-1]] - time[known[0]]) / _RATE))
    time, flexion = time[known[::step]], flexion[known[::step]]
    noise = float(np.nanmedian(sd)) if np.isfinite(sd).any() else 0.0
    turns = _find_turning_points(flexion, max(rules.attempt, _NOISE * noise))
    rises = [(low, top) for low, top in pairwise(turns) if flexion[top] > flexion[low]]
    if not rises:
        return ()
    large = float(np.percentile([flexion[top] - flexion[low] for low, top in rises], _LARGE))
    required = rules.complete * large
    curls = []
    for low, top in rises:
        back = next((turn for turn in turns if turn > top), len(time) - 1)
        rise, fall = float(flexion[top] - flexion[low]), float(flexion[top] - flexion[back])
        start = -_find_end_of_fall(-time[: top + 1][::-1], flexion[: top + 1][::-1], top - low)
        end = _find_end_of_fall(time[top:], flexion[top:], back - top)
        near = _NEAR * min(rise, max(fall, _NEAR * rise))
        middle = float(time[_find_samples_near(-flexion, top, near)].mean())
        why = ""
        if rise < required:
            why = f"the elbow rises by {np.degrees(rise):.0f}°, expected at least {np.degrees(required):.0f}°"
        elif fall < required:
            why, end = "the recording ends before the elbow is back", float("nan")
        # an event is unknown if it may lie in a hole, a time without a measured flexion
        hidden = {}
        ends = (("start", low, flexion, start), ("top", top, -flexion, middle), ("end", back, flexion, end))
        for name, turn, value, at in ends:
            rest = _find_samples_near(value, turn, near)
            first, after = time[max(rest[0] - 1, 0)], time[min(rest[-1] + 1, len(time) - 1)]
            if name != "top" and after - first > _REST:  # only the end of a long rest matters
                first, after = max(first, at - _BESIDE), min(after, at + _BESIDE)
            inside = holes[(holes[:, 1] >= first) & (holes[:, 0] <= after)]
            if len(inside) and not (name == "end" and np.isnan(end)):
                hidden[name] = f"the arm is not measured at its {name} ({inside[0, 0]:.2f}–{inside[-1, 1]:.2f} s)"
        start, middle, end = (float("nan") if name in hidden else at for name, _, _, at in ends)
        amplitude = float("nan") if {"start", "top"} & set(hidden) else rise
        text = "; ".join(hidden.values()) or why
        curls.append(Curl(start, middle, end, amplitude, not why, text, bool(why and hidden)))
    return tuple(curls)


def _find_turning_points(values: FloatArray, least: float) -> IntArray:
    """Return the indices of alternating minima and maxima of a signal that differ by at least ``least``."""
    turns: list[int] = []
    low = high = 0
    rising: bool | None = None
    for k, value in enumerate(values):
        low, high = (k if value < values[low] else low), (k if value > values[high] else high)
        if rising is not True and value - values[low] >= least:
            turns.append(low)
            rising, high = True, k
        elif rising is not False and values[high] - value >= least:
            turns.append(high)
            rising, low = False, k
    if rising is not None:
        turns.append(high if rising else low)
    return np.array(turns, dtype=np.int64)


def _find_end_of_fall(time: FloatArray, flexion: FloatArray, turn: int) -> float:
    """Return the end, s, of a fall of the flexion that begins at the first sample and is lowest at the sample ``turn``.

    The end is in the middle of a short rest. Before a long rest, it is the end of a minimum-jerk movement.
    """
    fall = float(flexion[0] - flexion[turn])
    rest = _find_samples_near(flexion, turn, _NEAR * fall)
    if time[rest[-1]] - time[rest[0]] <= _REST:
        return float(time[rest].mean())
    moving = np.flatnonzero(flexion[: rest[0]] >= flexion[turn] + _FAR * fall)
    return float(time[rest[0]] + _ONSET * (time[rest[0]] - time[moving[-1]]))


def _find_samples_near(values: FloatArray, turn: int, near: float) -> IntArray:
    """Return the indices of the run of samples around ``turn`` with values at most ``near`` above the value there."""
    away = np.flatnonzero(values > values[turn] + near)
    split = int(np.searchsorted(away, turn))
    first = away[split - 1] + 1 if split else 0
    last = away[split] if split < len(away) else len(values)
    return np.arange(first, last)


def fit_trend(values: FloatArray) -> dict[str, Any] | None:
    """Return the linear trend of a quantity (n,) over n curls by least squares, as facts of events.parquet.

    ``slope`` is the change from one curl to the next, ``interval`` its 95 % interval by Student's t, and ``count`` the
    number of known values; the result is None for fewer than four.

    Examples
    --------
    >>> fit_trend(np.array([1.0, 2.0, 3.0, 4.0]))["slope"]
    1.0
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < _FEWEST:
        return None
    number = known - known.mean()
    slope = float(number @ values[known] / (number @ number))
    rest = values[known] - values[known].mean() - slope * number
    free = len(known) - 2
    half = float(stdtrit(free, 0.975) * np.sqrt(rest @ rest / free / (number @ number)))
    return {"slope": slope, "interval": [slope - half, slope + half], "count": len(known)}


def find_trial_end(
    time: FloatArray, axis: FloatArray, curls: tuple[Curl, ...], rules: CurlRules
) -> tuple[float, str, str]:
    """Return the earliest time at which one of the rules ends a trial, s, the rule, and what was observed.

    The rule is ``stopped``, ``tempo``, ``plane``, or ``recording`` if no other rule ends the trial. ``time`` (T,) are
    the sample times, s. ``axis`` (T, 3) is the unit vector of the elbow's axis in the trial's axes, towards the right;
    NaN where unknown.
    """
    ends: list[tuple[float, str, str]] = []
    done = [curl for curl in curls if curl.complete]
    # the first failed attempt after the last complete curl
    complete = [k for k, curl in enumerate(curls) if curl.complete]
    rest = [curl for curl in (curls[complete[-1] + 1 :] if complete else curls) if not curl.unknown]
    if rest:
        ends.append((rest[0].start, "stopped", f"the next attempt fails: {rest[0].why}"))
    # the first pause between curls that is too long
    period = 1 / rules.metronome if rules.metronome else None
    durations = np.array([curl.end - curl.start for curl in done])
    if np.isfinite(durations).any():
        longest = rules.pause * (period or float(np.nanmedian(durations)))
        for curl, following in pairwise(curls):
            pause = following.start - curl.end
            if pause > longest:
                why = f"a pause of {pause:.1f} s follows, expected at most {longest:.1f} s"
                ends.append((curl.end, "stopped", why))
                break
    # before the first complete curl that is out of the metronome's tempo
    for curl in done:
        duration = curl.end - curl.start
        if period is not None and abs(duration - period) > rules.tempo * period:
            why = f"the next curl takes {duration:.2f} s, expected {period:.2f} s ± {100 * rules.tempo:.0f} %"
            ends.append((curl.start, "tempo", why))
            break
    # the first sustained rotation of the elbow's axis from its direction in the first curl
    timed = [curl for curl in done if curl.timed]
    first = (time >= timed[0].start) & (time <= timed[0].end) if timed else np.zeros(len(time), bool)
    if np.isfinite(axis[first]).any():
        reference = np.nanmean(axis[first], axis=0)
        with np.errstate(invalid="ignore"):
            turned = np.arccos(np.clip(axis @ reference / np.linalg.norm(reference), -1, 1))
            away = (turned > rules.plane) & (time >= timed[0].start) & (time <= timed[-1].end)
        for run in find_runs(away):
            if time[run.stop - 1] - time[run.start] >= rules.sustained:
                degrees = np.degrees(np.nanmax(turned[run]))
                why = f"the elbow's axis rotates by {degrees:.0f}°, expected at most {np.degrees(rules.plane):.0f}°"
                ends.append((float(time[run.start]), "plane", why))
                break
    ends_known = [curl.end for curl in done if np.isfinite(curl.end)]
    last = ends_known[-1] if ends_known else float(time[-1])
    return min(ends, key=lambda end: end[0], default=(last, "recording", "no rule ends the trial earlier"))


_VARIES = 0.25  # share of the error of the angle's changes that differs from curl to curl


def measure_compensation(
    time: FloatArray, angle: FloatArray, sd: FloatArray, curls: tuple[Curl, ...], rules: CurlRules
) -> list[dict[str, Any] | None]:
    """Return the motion of an angle of shoulder or thorax during every curl, as facts of events.parquet.

    The entry of a curl is None if it is a failed attempt or if the angle is unknown in it. ``time`` (T,) are the sample
    times, s; ``angle`` and ``sd`` (T,) are the angle and the standard deviation of its changes, rad; NaN where unknown.
    """
    spans = [slice(*np.searchsorted(time, [curl.start, curl.end])) if curl.timed else None for curl in curls]
    used = [span for span in spans if span is not None and np.isfinite(angle[span]).all() and span.stop > span.start]
    if not used:
        return [None for _ in spans]
    first, start = float(angle[used[0]].mean()), float(angle[used[0].start])
    found: list[dict[str, Any] | None] = []
    for span in spans:
        if span is None or span not in used:
            found.append(None)
            continue
        change = angle[span] - start
        error, size = float(np.sqrt(np.mean(sd[span] ** 2))), float(np.ptp(change))
        half = NORMAL_95 * float(np.sqrt(2) * error)  # at worst, the errors of both ends are independent
        away = find_runs(np.abs(change) > rules.compensation)
        longest = max((float(time[span][run.stop - 1] - time[span][run.start]) for run in away), default=0.0)
        found.append(
            {
                "range_rad": size,
                "interval_rad": [max(size - half, 0.0), size + half],
                # mean of the angle in this curl minus its mean in the first complete curl
                "offset_rad": float(change.mean()) - (first - start),
                "offset_sd_rad": np.sqrt(2) * error,
                # 95 % quantile of the range that errors of the angle alone cause: a smaller one may be no motion at all
                "floor_rad": half,
                # longest time in which the angle differs from its value at the start of the curls by too much
                "sustained_s": longest if longest >= rules.sustained else 0.0,
            }
        )
    return found


def fit_part_in_step(  # noqa: PLR0917
    time: FloatArray,
    angle: FloatArray,
    sd: FloatArray,
    flexion: FloatArray,
    axis: FloatArray | None,
    curls: Sequence[Curl],
) -> tuple[FloatArray, FloatArray, float, list[float]] | None:
    """Fit the part of an angle that depends on the flexion alone to the first complete curl with a known angle.

    Return this part at all times (T,), up to a constant, rad; the standard deviation (T,) of the changes of the rest;
    the range of the part within this curl; and the 95 % interval of the person's motion in this range. The result is
    None if the angle is known in no complete curl.

    ``time`` (T,) are the sample times, s; ``angle``, ``sd`` and ``flexion`` (T,) are the angle, the standard deviation
    of its changes, and the flexion of the elbow, rad; NaN where unknown. ``axis`` (2, 2) is the covariance of the
    elbow's axis along x and y of the upper arm, rad²; None if unknown.
    """
    spans = (slice(*np.searchsorted(time, [curl.start, curl.end])) for curl in curls if curl.timed)
    basis = np.stack([np.cos(flexion), np.sin(flexion)], axis=1)
    known = np.isfinite(angle) & np.isfinite(flexion)
    first = next((span for span in spans if span.stop - span.start > basis.shape[1] and known[span].all()), None)
    if first is None:
        return None
    middle = basis[first].mean(axis=0)
    shape, *_ = np.linalg.lstsq(basis[first] - middle, angle[first] - angle[first].mean(), rcond=None)
    curve = basis @ shape
    left = float(np.std(angle[first] - curve[first]))
    size = float(np.ptp(curve[first]))
    if axis is None:
        half = NORMAL_95 * np.sqrt(2 * np.mean(sd[first] ** 2))
    else:  # the largest rotation in a curl that an error of the elbow's axis causes
        change = basis[first] - basis[first][int(np.argmax(basis[first][:, 0]))]
        half = NORMAL_95 * float(np.sqrt(np.einsum("ti,ij,tj->t", change, axis, change).max()))
    rest = np.sqrt(left**2 + (_VARIES * sd) ** 2 / 2)
    return curve, rest, size, [max(size - float(half), 0.0), size + float(half)]


_ELBOW_CUTOFF = 4.0  # Hz: the elbow rests or moves slowly


@dataclass(frozen=True)
class Mass:
    """A rigid body that is forearm or hand, or is carried by it."""

    mass: float  # mass, kg
    centre: FloatArray  # (3,) centre of mass in the axes of the segment, m
    inertia: FloatArray  # (3,) moments of inertia about the centre of mass along the segment's axes, kg·m²
    relative_sd: float  # standard deviation of the mass as a share of the mass


@dataclass(frozen=True)
class SegmentMotion:
    """Motion of one segment in the trial's axes at T samples, and its bodies."""

    origin: FloatArray  # (T, 3) origin of the segment, m
    rotation: FloatArray  # (T, 3, 3) rotation from the segment's axes to the trial's axes
    # omega, alpha: (T, 3) angular velocity, rad/s, and angular acceleration, rad/s²
    omega: FloatArray
    alpha: FloatArray
    sd_alpha: FloatArray  # (T,) standard deviation of each component of alpha, rad/s²
    bodies: Sequence[Mass]  # bodies with this motion


def compute_elbow_torque(
    time: FloatArray, axis: FloatArray, segments: Sequence[SegmentMotion], *, tilt: float
) -> tuple[FloatArray, FloatArray]:
    """Return the torque of all muscles and devices about the elbow's axis, and its standard deviation, (T,) N·m.

    ``time`` (T,) are the sample times with constant step, s. ``axis`` (T, 3) is the unit vector of the elbow's axis in
    the trial's axes; a positive rotation about it is flexion. ``segments`` are the forearm, whose origin is the elbow,
    and the hand. ``tilt`` is the standard deviation of the forearm's direction, rad. Gravity is along -y. The
    results are NaN where the motion is unknown.
    """
    rate = (len(time) - 1) / (time[-1] - time[0])
    elbow = segments[0].origin
    down = np.array([0.0, -GRAVITY, 0.0])
    total, weight_moment, variance = np.zeros(len(time)), np.zeros(len(time)), np.zeros(len(time))
    # acceleration of the segment's origin, from low-passed positions; zero if more than half of them are missing
    acceleration = np.zeros_like(elbow)
    if find_complete_rows(elbow).sum() >= len(elbow) // 2:
        smooth = LowPass(_ELBOW_CUTOFF, rate)(interpolate_gaps(elbow))
        acceleration = np.gradient(np.gradient(smooth, axis=0), axis=0) * rate**2
    for k, motion in enumerate(segments):
        if k:
            before = segments[k - 1]
            acceleration = acceleration + _relative_acceleration(before, motion.origin - before.origin)
        for body in motion.bodies:
            out = np.einsum("tij,j->ti", motion.rotation, body.centre)
            lever = motion.origin - elbow + out
            specific_force = acceleration + _relative_acceleration(motion, out) - down
            by_force = body.mass * np.einsum("ti,ti->t", axis, np.cross(lever, specific_force))
            inertia = np.einsum("tij,j,tkj->tik", motion.rotation, body.inertia, motion.rotation)
            moment = np.einsum("tik,tk->ti", inertia, motion.alpha)
            moment += np.cross(motion.omega, np.einsum("tik,tk->ti", inertia, motion.omega))
            torque = by_force + np.einsum("ti,ti->t", axis, moment)
            about_elbow = np.einsum("ti,tik,tk->t", axis, inertia, axis) + body.mass * np.sum(lever**2, axis=1)
            total += torque
            weight_moment += body.mass * GRAVITY * np.linalg.norm(lever, axis=1)
            variance += (body.relative_sd * torque) ** 2 + (about_elbow * motion.sd_alpha) ** 2
    return total, np.sqrt(variance + (weight_moment * tilt) ** 2)


def _relative_acceleration(motion: SegmentMotion, out: FloatArray) -> FloatArray:
    """Return the acceleration (T, 3) of a point at ``out`` from the segment's origin, relative to the origin, m/s²."""
    return np.cross(motion.alpha, out) + np.cross(motion.omega, np.cross(motion.omega, out))
