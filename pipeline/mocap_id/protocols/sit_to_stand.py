"""Repetitions of sit-to-stand and squat movements, their events, and remarks on unusual ones (thesis ch. 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.dynamics.fit import determines_parameters, fit
from mocap_id.dynamics.preparation import LowPass, PreparedTrial
from mocap_id.dynamics.regressor import SEAT
from mocap_id.protocols.five_times import Attempt
from mocap_id.protocols.repetitions import NAN, QUIET, STANDING, SUPPORT_LIMIT, Posture, Repetition, RiseDetails
from mocap_id.verdict import Reason

ContactRule = Literal["seat-force", "weight", "knee"]
DecidingRule = Literal["seat-plate", "seat-force", "weight", "knee"]

_SEATED = 0.5  # share of the rise: nobody sits higher
_OFF_CHAIR = 0.4  # share of the rise; above it, the hips are surely off the chair
_CHAIR_SHARE = 0.8  # share of the weight: if the feet carry less, a chair carries the rest
_THRESHOLD_SDS = 4.0  # threshold in standard deviations of the chair force without contact
_THRESHOLD_RANGE = 0.005, 0.1  # lowest and highest threshold, as shares of the standing weight
_LOADED = 0.95  # quantile of the chair force that counts as its full load
_POWERS = np.concatenate([[0.25, 0.5], np.arange(1.0, 5.01, 0.25)])
_PRIOR_POWER, _PRIOR_SD = 3.0, 0.3
_SHARE, _SHORTEST = 0.03, 0.05  # start of the fitted interval: this share of the full load, or this time, s, if earlier
_LATE = 0.15  # s after the last visible sample; from there on, the force is zero
_LONGEST = 1.0  # s, longest fitted interval
_LEAST = 3  # smallest number of samples of force in the fitted interval
_STEP = 0.004  # s, interval of instants in the coarse search; a quarter of it in the fine search


def measure_standing_weight(posture: Posture, vertical: FloatArray) -> float:
    """Return the median of the force ``vertical`` (T,) in quiet upright standing, N; NaN if nobody stands."""
    known = np.isfinite(vertical) & np.isfinite(posture.speed)
    upright = posture.upright & known
    if not upright.any():
        return float("nan")
    quiet = upright & (posture.speed < QUIET * np.max(posture.speed[known]))
    return float(np.median(vertical[quiet if quiet.any() else upright]))


def uses_chair(posture: Posture, vertical: FloatArray, weight: float) -> bool | None:
    """Return whether a chair carries part of the weight in the low phases; None if this is unknown.

    It is unknown if ``weight``, the standing weight in N, is NaN, or if ``vertical`` (T,), the force under the feet in
    N, is NaN in all low phases.
    """
    low = [run for run in find_runs(~posture.upright) if np.isfinite(vertical[run]).any()]
    if not low or np.isnan(weight):
        return None
    return any(float(np.nanmedian(vertical[run])) < _CHAIR_SHARE * weight for run in low)


def find_samples_off_chair(posture: Posture) -> BoolArray:
    """Return True (T,) for the samples in which the hips are too high for chair contact."""
    return np.nan_to_num(posture.height, nan=0.0) > _OFF_CHAIR


def find_contact_in_low_phases(posture: Posture, evidence: BoolArray) -> BoolArray:
    """Return True (T,) from the first to the last sample with ``evidence`` (T,) of contact in each low phase.

    In a low phase at the beginning or end of the recording, contact extends to that end. Evidence above half of the
    rise is ignored.
    """
    evidence = evidence & (np.nan_to_num(posture.height, nan=0.0) < _SEATED)
    out = np.zeros(len(evidence), dtype=bool)
    for low in find_runs(~posture.upright):
        indices = np.flatnonzero(evidence[low])
        if len(indices):
            first = low.start if low.start == 0 else low.start + int(indices[0])
            last = low.stop if low.stop == len(evidence) else low.start + int(indices[-1]) + 1
            out[first:last] = True
    return out


def extend_contact_to_release(time: FloatArray, touching: BoolArray, seat_force: FloatArray) -> BoolArray:
    """Return True (T,) for the samples with contact, extended from ``touching`` to the instants of zero chair force.

    ``time`` (T,) are the sample times, s, and ``touching`` (T,) marks the samples with a chair force above the noise.
    ``seat_force`` (T,) is the vertical force of the chair, N, not filtered because a low-pass would blur its end.
    """
    out = touching.copy()
    for run in find_runs(touching):
        full = float(np.nanquantile(seat_force[run], _LOADED)) if np.isfinite(seat_force[run]).any() else 0.0
        if run.stop < len(time):
            end = extrapolate_release(time, seat_force, float(time[run.stop - 1]), full)
            out[run.start : int(np.searchsorted(time, end, side="right"))] = True
        if run.start > 0:
            begin = -extrapolate_release(-time[::-1], seat_force[::-1], -float(time[run.start]), full)
            out[int(np.searchsorted(time, begin)) : run.stop] = True
    return out


def estimate_noise_on_chair(seat_force: FloatArray, height: FloatArray) -> float:
    """Return the standard deviation that a predicted chair force has at the height of the chair, N.

    The noise of the motion acts on the vertical force through the horizontal distances between the joints. These are
    small in a standing person and largest in a seated one: for a leg that bends, their square is proportional to
    1 - h². A fit of this course to the squared force finds the noise in the samples without contact.

    ``seat_force`` (R,) is the vertical force of the chair in samples without contact, N, so that it is noise, and
    ``height`` (R,) the height h of the hip in these samples, as in :class:`~mocap_id.protocols.repetitions.Posture`.
    """
    known = np.isfinite(seat_force) & np.isfinite(height)
    if not known.any():
        return 0.0
    square = (seat_force[known] - seat_force[known].mean()) ** 2
    bent = 1.0 - np.clip(height[known], 0.0, 1.0) ** 2
    spread = float(np.mean((bent - bent.mean()) ** 2))
    slope = float(np.mean((bent - bent.mean()) * square)) / spread if spread > 0.0 else 0.0
    return float(np.sqrt(np.mean(square) + max(slope, 0.0) * (1.0 - bent.mean())))


def compute_contact_threshold(noise: float, weight: float) -> float:
    """Return the chair force above which there is contact, N.

    ``noise`` is the standard deviation of the chair's force without contact, N, and ``weight`` the standing weight, N.
    """
    return float(np.clip(_THRESHOLD_SDS * noise, _THRESHOLD_RANGE[0] * weight, _THRESHOLD_RANGE[1] * weight))


def extrapolate_release(time: FloatArray, force: FloatArray, last_visible: float, full: float) -> float:
    """Return the instant at which the chair force reaches zero, s; ``last_visible`` if the samples are too few.

    A person leaves a chair smoothly, and the chair force disappears in the noise long before it is zero. In simulated
    trials, a threshold of four standard deviations is 35 to 120 ms too early. The last part of the force above the
    noise is therefore modelled as

        F(t) = A (t_release - t)^p   before the release, and zero after it.

    A, p and t_release are fitted by least squares. A smooth end hardly determines p, so p has the prior 3 ± 0.3; with
    p = 3, force, slope and curvature are all zero at the release. The prior was chosen on simulated trials. It does not
    suit chairs that are released in two stages.

    ``time`` (T,) are the sample times, s, ascending; if they are negated and reversed, the result is the first instant
    of contact. ``force`` (T,) is the vertical force of the chair, N, NaN where unknown. ``last_visible`` is the time of
    the last sample with a force above the noise, s, and ``full`` the force of the loaded chair, N.
    """
    left = time - last_visible
    with np.errstate(invalid="ignore"):
        high = left[(left <= 0) & (force > _SHARE * full)]
    start = max(min(float(high[-1]) if len(high) else -np.inf, -_SHORTEST), -_LONGEST)
    own = (left >= start) & (left <= _LATE) & np.isfinite(force)
    if np.count_nonzero(own & (left <= 0)) < _LEAST:
        return last_visible
    after = force[(left > _LATE) & (left <= 2 * _LATE) & np.isfinite(force)]
    noise = float(np.std(after)) if len(after) > 1 else 0.0
    coarse = _find_best_instant(left[own], force[own], noise, np.arange(0.0, _LATE, _STEP))
    fine = coarse + _STEP * np.arange(-1.0, 1.01, 0.25)
    return last_visible + _find_best_instant(left[own], force[own], noise, fine[fine >= 0.0])


def _find_best_instant(left: FloatArray, force: FloatArray, noise: float, instants: FloatArray) -> float:
    """Return the release time, one of ``instants`` (I,), for which F(t) with its best power fits the force best."""
    shapes = np.maximum(instants[:, None] - left, 0.0)[:, None] ** _POWERS[:, None]  # (I, P, T)
    size = np.maximum(np.sum(shapes**2, axis=2), np.finfo(float).tiny)
    explained = np.maximum(shapes @ force, 0.0) ** 2 / size - (noise * (_POWERS - _PRIOR_POWER) / _PRIOR_SD) ** 2
    return float(instants[np.argmax(explained) // len(_POWERS)])


_ROUNDS = 8  # largest number of iterations of model and contact
_SETTLED = 0.02  # s: the contact has converged if it changes by less; the low-pass blurs it over about 0.2 s


@dataclass(frozen=True)
class Contact:
    """Contact of the person with the chair in one trial."""

    chair: bool | None  # whether a chair is used; False for squats, None if the plates cannot decide it
    touching: BoolArray | None  # (T,) samples with contact, on the clock of the markers; None if unknown
    free: BoolArray  # (T,) samples to use for the identification
    # (T,) samples in which a chair whose force is not measured carries, or may carry, part of the body. A rule that
    # misses some contact counts every sample in which the hips are not surely off the chair.
    carried: BoolArray
    weight: float  # standing weight, N
    threshold: float | None  # chair force above which there is contact, N; None for rules without a threshold
    # Rule that decided the contact. It differs from the requested rule if the chair has its own plate, or if the
    # requested rule could not be applied.
    rule: DecidingRule
    # whether the iteration of model and contact converged; None for rules without iteration
    converged: bool | None = None
    # (T,) samples with a chair force above the threshold; ``touching`` also contains the samples from there to the
    # instants of zero force. None for rules without a threshold.
    above_noise: BoolArray | None = None


def find_contact(
    prepared: PreparedTrial, posture: Posture, rule: ContactRule, *, weight_share: float, knee_bend: float
) -> Contact:
    """Find the samples with chair contact by a rule of this module.

    ``weight_share`` is the share of the standing weight under the feet at which the chair is released (rule
    ``weight``), ``knee_bend`` the angle of the knee below which the person is off the chair (rule ``knee``), rad.
    """
    vertical = prepared.recorded.surroundings[:, 1]
    if prepared.recorded.seat is not None:  # the chair has its own plate
        everything = np.ones(len(vertical), dtype=bool)  # all forces are measured
        offset = fit(prepared, everything).offset if determines_parameters(prepared, everything) else 0.0
        seat = prepared.external(offset)[[each.name for each in prepared.recorded.external].index(SEAT)][:, 1]
        weight = measure_standing_weight(posture, prepared.measured(offset)[:, 1])
        if np.isnan(weight):  # the person never stands, so feet and chair together carry the weight
            weight = float(np.nanmedian(vertical))
        threshold = compute_contact_threshold(float(np.nanstd(seat[posture.upright])), weight)
        with np.errstate(invalid="ignore"):
            above_noise = find_contact_in_low_phases(posture, seat > threshold)
            touching = extend_contact_to_release(prepared.recorded.time, above_noise, seat)
        unmeasured = ~np.isfinite(prepared.recorded.seat.wrench[:, 1]) & ~find_samples_off_chair(posture)
        sits = bool(touching.any())
        return Contact(sits, touching, everything, unmeasured, weight, threshold, "seat-plate", None, above_noise)
    weight = measure_standing_weight(posture, vertical)
    chair = uses_chair(posture, vertical, weight)
    if chair is False:
        nowhere = np.zeros(len(vertical), dtype=bool)
        return Contact(False, nowhere, ~nowhere, nowhere, weight, None, rule)
    off_chair = find_samples_off_chair(posture)
    if rule == "weight" and determines_parameters(prepared, off_chair):  # no model finds the clock later by this rule
        vertical = prepared.measured(fit(prepared, off_chair).offset)[:, 1]
    with np.errstate(invalid="ignore"):
        by_weight = find_contact_in_low_phases(posture, vertical < weight_share * weight)
        knee = min(prepared.recorded.knee, prepared.recorded.q.shape[1] - 1)
        straight = np.abs(prepared.recorded.q[:, knee]) < knee_bend
    if chair is None:
        return Contact(None, None, straight, ~off_chair, weight, None, "knee")
    first = off_chair & ~by_weight
    if rule == "knee":
        return Contact(True, by_weight, straight, ~first, weight, None, rule)
    # the chair force is the Fy missing under the feet, which only a model fitted to Fy can predict
    if rule == "weight" or 1 not in prepared.settings.components or not determines_parameters(prepared, first):
        return Contact(True, by_weight, ~by_weight, ~first, weight, None, "weight")
    # Alternately fit a model to the free samples and find the contact with this model, until the contact converges.
    # Without convergence, samples with contact in either of the last two rounds are excluded. If the free samples of a
    # round would not determine a model, the search ends with the contact of the previous round.
    rate = prepared.recorded.rate
    smooth = LowPass(min(2 * prepared.lowpass.cutoff, 10.0, rate / 5), rate)
    free, before, touching, limit, converged = first, ~first, ~first, 0.0, False
    missing = np.full(len(first), np.nan)
    for _ in range(_ROUNDS):
        found = fit(prepared, free)
        base = found.problem.free_solution()[: found.base]
        measured = prepared.measured(found.offset)[:, 1]
        missing = prepared.rows[:, 1] @ base - measured
        seat_force = smooth(missing[:, None])[:, 0]
        noise = estimate_noise_on_chair(seat_force[found.in_fit], posture.height[found.in_fit])
        limit = compute_contact_threshold(noise, weight)
        with np.errstate(invalid="ignore"):
            above_noise = find_contact_in_low_phases(posture, seat_force > limit)
        if not determines_parameters(prepared, ~above_noise):
            break
        before, touching, free = touching, above_noise, ~above_noise
        converged = all(run.stop - run.start <= _SETTLED * rate for run in find_runs(before ^ touching))
        if converged:
            break
    if not converged and determines_parameters(prepared, ~(touching | before)):
        touching = touching | before
    extended = extend_contact_to_release(prepared.recorded.time, touching, missing)
    # a lost plate signal shows no chair force; only the height of the hips then excludes the chair
    carried = extended | (~np.isfinite(missing) & ~find_samples_off_chair(posture))
    extended = extended if determines_parameters(prepared, ~extended) else touching
    return Contact(True, extended, ~extended, carried, weight, limit, "seat-force", converged, touching)


_STILL = 0.05  # share of the peak speed; in a pause, the speed is lower
_PAUSE = 0.2  # s, shortest pause; at seat-off, trunk and legs may both be slow for an instant
_LEVEL = 0.1  # share of the rise; farther from seat and standing, a pause is within the rise
_MOVING = 0.15  # share of the peak speed; if the speed at its end is higher, the recording may cut off a movement


def find_sit_to_stand_repetitions(
    time: FloatArray, posture: Posture, touching: BoolArray | None, *, chair: bool | None
) -> tuple[Repetition, ...]:
    """Find the repetitions of rising from a chair and sitting down, or of squatting.

    ``time`` (T,) are the sample times, s; ``touching`` (T,) marks the samples with chair contact, None if unknown.
    ``chair`` says whether a chair is used; None, if unknown, counts as True.
    """
    if not posture.moves:
        return ()
    if chair is not False:
        return tuple(_describe_rise(time, posture, touching, up) for up in find_runs(posture.upright))
    squats = []
    for down in find_runs(~posture.upright):
        if down.start == 0 or down.stop == len(time):  # not between two upright phases
            continue
        before, after = _find_neighbours(~posture.upright, down)
        start = _find_rest(time, posture, before, _find_peak_speed(posture.speed, before, down), last=True)
        stand = _find_rest(time, posture, after, _find_peak_speed(posture.speed, down, after))
        why = ["the recording begins during the descent"] if np.isnan(start) else []
        why += ["the recording ends during the rise"] if np.isnan(stand) else []
        squats.append(Repetition(start, NAN, stand, NAN, stand, not why, "; ".join(why)))
    return tuple(squats)


def estimate_event_sd(
    time: FloatArray,
    posture: Posture,
    repetitions: Sequence[Repetition],
    speed_sd: FloatArray,
    above_noise: BoolArray | None,
) -> dict[str, FloatArray]:
    """Return the standard deviations of `start`, `stand`, `seat_on` and `end` of each repetition, s; NaN if unknown.

    The first three follow from the speed: half the difference between the events with the speed raised and lowered by
    its standard deviation ``speed_sd`` (T,), rad/s. An event lies up to one frame before or after the sample that is
    given for it. For `seat_on`, the chair's force is extrapolated from the first sample with a force above the noise
    (``above_noise``, as in :class:`Contact`); the standard deviation is the length of
    the extrapolation. A rule without a threshold gives none.
    """
    frame = float(np.median(np.diff(time))) ** 2 / 3  # of an error between 0 and one frame
    slow, fast = (
        find_sit_to_stand_repetitions(
            time, replace(posture, speed=np.maximum(posture.speed + sign * speed_sd, 0.0)), None, chair=None
        )
        for sign in (-1, 1)
    )
    found = {}
    for name in ("start", "stand", "end"):
        early, late = (np.array([getattr(each, name) for each in varied], dtype=np.float64) for varied in (slow, fast))
        found[name] = np.sqrt(((late - early) / 2) ** 2 + frame)
    found["seat_on"] = np.full(len(repetitions), np.nan)
    if above_noise is not None:
        visible = np.append(time[above_noise], np.nan)
        first = np.searchsorted(visible[:-1], [each.seat_on for each in repetitions])
        late = visible[first] - np.array([each.seat_on for each in repetitions])
        found["seat_on"] = np.sqrt(late**2 + frame)
    return found


def _find_neighbours(state: BoolArray, run: slice) -> tuple[slice, slice]:
    """Return the runs of the opposite state before and after a run; empty slices at the ends of the recording."""
    others = find_runs(~state)
    before = [other for other in others if other.stop == run.start]
    after = [other for other in others if other.start == run.stop]
    size = len(state)
    return (before or [slice(0, 0)])[0], (after or [slice(size, size)])[0]


def _describe_rise(time: FloatArray, posture: Posture, touching: BoolArray | None, up: slice) -> Repetition:
    """Return the repetition with the upright phase ``up``: rise, stand and descent."""
    before, after = _find_neighbours(posture.upright, up)
    rises, sits = up.start > 0, up.stop < len(time)  # within the recording
    start = stand = end = seat_off = seat_on = float("nan")
    cut: list[str] = []
    if rises:
        peak = _find_peak_speed(posture.speed, before, up)
        start, stand = _find_rest(time, posture, before, peak, last=True), _find_rest(time, posture, up, peak)
        seat_off = _find_seat_event(time, touching, before, last=True)
        if before.start == 0 and np.isnan(start):
            cut.append("the recording begins during the rise")
        if not sits and np.isnan(stand):
            cut.append("the recording ends during the rise")
    if sits:
        end = _find_rest(time, posture, after, _find_peak_speed(posture.speed, up, after))
        seat_on = _find_seat_event(time, touching, after, last=False)
        if after.stop == len(time) and np.isnan(end):
            cut.append("the recording ends during the descent")
    begins_low, ends_low = _is_below_top(posture, up, 0), _is_below_top(posture, up, -1)
    if not rises and begins_low:
        stand = _find_rest(time, posture, up, _find_peak_speed(posture.speed, up))
    missing = (
        (not rises, f"the recording begins {'during the rise' if begins_low else 'upright'}"),
        (not sits and not cut, f"the recording ends {'during the descent' if ends_low else 'upright'}"),
        (touching is None, "no plate measures when the chair is released"),
        (rises and touching is not None and np.isnan(seat_off), "no chair contact before the rise"),
        (sits and touching is not None and np.isnan(seat_on), "no chair contact after the descent"),
    )
    why = cut + [text for is_missing, text in missing if is_missing]
    return Repetition(start, seat_off, stand, seat_on, end, not why, "; ".join(why))


def _is_below_top(posture: Posture, up: slice, end: int) -> bool:
    """Return whether the first (0) or last (-1) known sample of an upright phase is clearly below its top."""
    known = posture.height[up][np.isfinite(posture.height[up])]
    return bool(len(known) and known.max() - known[end] > _LEVEL)


def _find_peak_speed(speed: FloatArray, *parts: slice) -> float:
    """Return the largest known speed in the given parts of the recording; 0 if no speed is known."""
    joined = np.concatenate([speed[part] for part in parts])
    return float(np.nanmax(joined)) if np.isfinite(joined).any() else 0.0


def _find_rest(time: FloatArray, posture: Posture, part: slice, peak: float, *, last: bool = False) -> float:
    """Return the start of the first pause in a part or, with ``last``, the end of its last pause, s.

    Without a pause, the result is the slowest instant. It is NaN if the recording ends there while the person moves.
    """
    # samples of an upright part near its top, or of a low part near its bottom
    level, height = np.zeros(len(posture.height), dtype=bool), posture.height[part]
    with np.errstate(invalid="ignore"):
        if np.isfinite(height).any():
            high = posture.upright[part.start]
            level[part] = height > np.nanmax(height) - _LEVEL if high else height < np.nanmin(height) + _LEVEL
        still = level & (posture.speed < _STILL * peak)
    pauses = [run for run in find_runs(still) if time[run.stop - 1] - time[run.start] >= _PAUSE]
    if pauses:
        return float(time[pauses[-1].stop - 1] if last else time[pauses[0].start])
    known = np.flatnonzero(level & np.isfinite(posture.speed))
    if not len(known):
        return float("nan")
    slowest = known[np.argmin(posture.speed[known])]
    at_end = part.start == 0 if last else part.stop == len(time)
    cut = at_end and slowest in (known[0], known[-1]) and posture.speed[slowest] > _MOVING * peak
    return float("nan") if cut else float(time[slowest])


def _find_seat_event(time: FloatArray, touching: BoolArray | None, low: slice, *, last: bool) -> float:
    """Return the first contact in a low phase or, with ``last``, seat-off after the last, s; NaN without contact."""
    contact: Sequence[int] = [] if touching is None else np.flatnonzero(touching[low]).tolist()
    if not contact:
        return float("nan")
    index = low.start + contact[-1] + 1 if last else low.start + contact[0]
    return float(time[min(index, len(time) - 1)])


_RISING = 0.25  # share of the rise above which the last sample belongs to a rise


def add_remarks(repetition: Repetition, rise: RiseDetails) -> Repetition:
    """Return the repetition with remarks on its rise in ``why``; it is incomplete if it does not reach standing."""
    remarks = [repetition.why] if repetition.why else []
    if rise.reached < STANDING:
        remarks.append(f"reaches only {100 * rise.reached:.0f} % of the standing height")
    if rise.attempts:
        remarks.append(f"{rise.attempts} failed attempt{'' if rise.attempts == 1 else 's'} before")
    if rise.held > 0:
        remarks.append(f"paused for {rise.held:.1f} s during the rise")
    if rise.support > SUPPORT_LIMIT:
        remarks.append(f"{100 * rise.support:.0f} % of the weight carried by an unknown support")
    complete = repetition.complete and not rise.reached < STANDING
    return replace(repetition, complete=complete, why="; ".join(remarks))


def explain_repetitions(
    repetitions: Sequence[Repetition], rises: Sequence[RiseDetails], attempts: Sequence[Attempt], posture: Posture
) -> tuple[Reason, ...]:
    """Return the reasons for the verdict about the repetitions."""
    reasons = []
    cuts = [part for each in repetitions for part in each.why.split("; ") if part.startswith("the recording ")]
    height = posture.height[np.isfinite(posture.height)]
    if posture.moves and len(height) and not posture.upright[-1] and height[-1] > _RISING:
        cuts.append("the recording ends during a further rise, which is not counted")
    if cuts:
        text = (
            f"{'; '.join(dict.fromkeys(cuts))}: events outside the recording, and quantities of whole repetitions, are "
            "unknown"
        )
        reasons.append(Reason("repetition-cut", text, level="ok"))
    if attempts:
        times = ", ".join(f"{attempt.time_s:.1f} s" for attempt in attempts)
        highest = max(attempt.height for attempt in attempts)
        text = (
            f"an attempt to rise failed {'once' if len(attempts) == 1 else f'{len(attempts)} times'} (at {times}): "
            f"the hips rose up to {100 * max(highest, 0.0):.0f} % of the way to standing and returned to the seat. "
            "Failed attempts are not counted as repetitions"
        )
        reasons.append(Reason("attempt-failed", text, float(len(attempts))))
    numbered = list(enumerate(rises, start=1))
    partial = {str(k): rise.reached for k, rise in numbered if rise.reached < STANDING}
    if partial:
        lowest = min(partial.values())
        text = (
            f"the person does not fully stand in repetition {', '.join(partial)}: the hips reach {100 * lowest:.0f} % "
            "of the height of the other repetitions. It is marked as incomplete and not counted in the five-times "
            "test"
        )
        reasons.append(Reason("rise-partial", text, lowest, STANDING))
    paused = {str(k): rise.held for k, rise in numbered if rise.held > 0}
    if paused:
        longest = max(paused.values())
        text = (
            f"the person pauses between seat and standing in repetition {', '.join(paused)}, for up to {longest:.1f} "
            "s; the times of the repetition include the pause"
        )
        reasons.append(Reason("rise-paused", text, longest))
    supported = {str(k): rise.support for k, rise in numbered if rise.support > SUPPORT_LIMIT}
    if supported:
        most = max(supported.values())
        text = (
            f"in the rise of repetition {', '.join(supported)}, up to {100 * most:.0f} % of the weight is carried "
            "neither by the plates nor, at this height, by a chair: arms on an armrest or rail, or a helping hand. "
            "These samples are used for identification, so parameters and torques are biased; seat-off may be "
            "found late. In these rises, and in the sitting before them, joint torques are unknown (NaN)"
        )
        reasons.append(Reason("support-unexplained", text, most, SUPPORT_LIMIT))
    return tuple(reasons)
