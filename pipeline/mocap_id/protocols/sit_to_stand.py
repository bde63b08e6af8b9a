"""Sit-to-stand and squats: where the chair is, and the repetitions, whatever their number (thesis ch. 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.external import SEAT
from mocap_id.dynamics.fit import determined, fit
from mocap_id.dynamics.lowpass import LowPass, runs
from mocap_id.dynamics.prepare import Prepared
from mocap_id.protocols import contact
from mocap_id.protocols.contact import ContactRule, DecidingRule
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition

_STILL = 0.05  # of the peak speed: slower than this is a pause …
_PAUSE = 0.2  # … if it lasts this long, s: at seat-off trunk and legs may both be slow for an instant
_ROUNDS = 8
_SETTLED = 0.02  # s: contact that moves by no more does not matter, the filter's reach is ten times that


@dataclass(frozen=True)
class Contact:
    """Where the chair is.

    Parameters
    ----------
    chair : bool or None
        A chair is used; False for squats, None where the plates do not tell.
    touching : (T,) bool array or None
        Samples with contact, on the markers' clock; None where the plates do not tell.
    free : (T,) bool array
        Samples to identify on.
    weight : float
        Standing weight, N.
    threshold : float or None
        Missing vertical force that counted as contact, N; None where the rule was another.
    rule : DecidingRule
        The rule that decided: the chair's own plate where there is one; another than asked for where that one had too
        little to go by.
    converged : bool or None
        The contact and the model that shows it agree with each other; None where the rule was another.
    """

    chair: bool | None
    touching: BoolArray | None
    free: BoolArray
    weight: float
    threshold: float | None
    rule: DecidingRule
    converged: bool | None = None


def find_contact(
    prepared: Prepared, posture: Posture, rule: ContactRule, *, weight_share: float, knee_bend: float
) -> Contact:
    """Find the samples without chair contact.

    Parameters
    ----------
    prepared : Prepared
    posture : Posture
    rule : {"seat-force", "weight", "knee"}
        See :mod:`mocap_id.protocols.contact`.
    weight_share : float
        Share of the standing weight that releases the chair, rule ``weight``.
    knee_bend : float
        Bend of the second joint, rad, below which the person is off the chair, rule ``knee``.
    """
    if prepared.recorded.seat is not None:
        return by_seat_plate(prepared, posture)
    vertical = prepared.recorded.surroundings[:, 1]
    weight = contact.standing_weight(posture, vertical)
    chair = contact.uses_chair(posture, vertical, weight)
    if chair is False:
        nowhere = np.zeros(len(vertical), dtype=bool)
        return Contact(False, nowhere, ~nowhere, weight, None, rule)
    with np.errstate(invalid="ignore"):
        by_weight = contact.touching(posture, vertical < weight_share * weight)
        straight = np.abs(prepared.recorded.q[:, min(1, prepared.recorded.q.shape[1] - 1)]) < knee_bend
    if chair is None:
        return Contact(None, None, straight, weight, None, "knee")
    if rule == "knee":
        return Contact(True, by_weight, straight, weight, None, rule)
    first = contact.surely_free(posture) & ~by_weight
    # the seat's force is what the feet lack in Fy: a model that was not fitted to it does not know that
    if rule == "weight" or 1 not in prepared.settings.components or not determined(prepared, first):
        return Contact(True, by_weight, ~by_weight, weight, None, "weight")
    return _by_seat_force(prepared, posture, first, weight)


def by_seat_plate(prepared: Prepared, posture: Posture) -> Contact:
    """Contact as the chair's own plate shows it; every sample is free to identify on, since nothing is unmeasured."""
    everything = np.ones(len(prepared.recorded.time), dtype=bool)
    offset = fit(prepared, everything).offset if determined(prepared, everything) else 0.0
    seat = prepared.external(offset)[[each.name for each in prepared.recorded.external].index(SEAT)][:, 1]
    weight = contact.standing_weight(posture, prepared.measured(offset)[:, 1])
    if np.isnan(weight):  # nobody is seen to stand: what both plates carry together is the weight
        weight = float(np.nanmedian(prepared.recorded.surroundings[:, 1]))
    threshold = contact.seat_force_threshold(seat, posture.upright, weight)
    with np.errstate(invalid="ignore"):
        touching = contact.until_zero(prepared.recorded.time, contact.touching(posture, seat > threshold), seat)
    return Contact(bool(touching.any()), touching, everything, weight, threshold, "seat-plate")


def sit_to_stand_repetitions(
    time: FloatArray, posture: Posture, touching: BoolArray | None, *, chair: bool | None
) -> tuple[Repetition, ...]:
    """Repetitions of rising from a chair and sitting down again, or of squatting.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    touching : (T,) bool array or None
        Contact with the chair; None where no plate tells.
    chair : bool or None
        A chair is used; None counts as one.
    """
    if not posture.moves:
        return ()
    if chair is not False:
        return tuple(_rising(time, posture, touching, up) for up in runs(posture.upright))
    down = [run for run in runs(~posture.upright) if run.start > 0 and run.stop < len(time)]
    return tuple(_squatting(time, posture, run) for run in down)


def _by_seat_force(prepared: Prepared, posture: Posture, first: BoolArray, weight: float) -> Contact:
    """Alternate between a model of what is surely free and the contact that it shows, until neither changes.

    Where they do not settle, what either of the last two rounds calls contact is left out. A round whose free samples
    would not determine a model ends the search too, with the contact before it.
    """
    rate = prepared.recorded.rate
    smooth = LowPass(min(2 * prepared.lowpass.cutoff, 10.0, rate / 5), rate)
    free, before, touching, threshold, converged = first, ~first, ~first, 0.0, False
    missing = np.full(len(first), np.nan)
    for _ in range(_ROUNDS):
        found = fit(prepared, free)
        base = found.problem.free_solution()[: found.base]
        measured = prepared.measured(found.offset)[:, 1]
        missing = prepared.rows[:, 1] @ base - measured
        seat_force = smooth(missing[:, None])[:, 0]
        threshold = contact.seat_force_threshold(seat_force, found.in_fit, weight)
        with np.errstate(invalid="ignore"):
            shown = contact.touching(posture, seat_force > threshold)
        if not determined(prepared, ~shown):
            break
        before, touching, free = touching, shown, ~shown
        converged = all(run.stop - run.start <= _SETTLED * rate for run in runs(before ^ touching))
        if converged:
            break
    if not converged and determined(prepared, ~(touching | before)):
        touching = touching | before
    longer = contact.until_zero(prepared.recorded.time, touching, missing)
    touching = longer if determined(prepared, ~longer) else touching
    return Contact(True, touching, ~touching, weight, threshold, "seat-force", converged)


def _rising(time: FloatArray, posture: Posture, touching: BoolArray | None, up: slice) -> Repetition:
    """The repetition around one upright phase."""
    before, after = _neighbours(posture.upright, up)
    rose, sat = up.start > 0, up.stop < len(time)
    start = stand = end = seat_off = seat_on = float("nan")
    if rose:
        peak = _peak(posture.speed, before, up)
        start = _pause_end(time, posture.speed, before, peak)
        stand = _pause_start(time, posture.speed, up, peak)
        seat_off = _event(time, touching, before, last=True)
    if sat:
        end = _pause_start(time, posture.speed, after, _peak(posture.speed, up, after))
        seat_on = _event(time, touching, after, last=False)
    missing = [
        text
        for absent, text in (
            (not rose, "the recording begins upright"),
            (not sat, "the recording ends upright"),
            (touching is None, "no plate shows when the chair is released"),
            (rose and touching is not None and np.isnan(seat_off), "no contact with the chair before the rise"),
            (sat and touching is not None and np.isnan(seat_on), "no contact with the chair after the descent"),
        )
        if absent
    ]
    return Repetition(start, seat_off, stand, seat_on, end, not missing, "; ".join(missing))


def _squatting(time: FloatArray, posture: Posture, down: slice) -> Repetition:
    """The repetition around one low phase between two upright ones."""
    before, after = _neighbours(~posture.upright, down)
    start = _pause_end(time, posture.speed, before, _peak(posture.speed, before, down))
    stand = _pause_start(time, posture.speed, after, _peak(posture.speed, down, after))
    return Repetition(start, float("nan"), stand, float("nan"), stand, True)


def _neighbours(state: BoolArray, run: slice) -> tuple[slice, slice]:
    """The stretches of the opposite state on both sides of a run; empty at the recording's ends."""
    others = runs(~state)
    before = [other for other in others if other.stop == run.start]
    after = [other for other in others if other.start == run.stop]
    size = len(state)
    return (before or [slice(0, 0)])[0], (after or [slice(size, size)])[0]


def _peak(speed: FloatArray, *parts: slice) -> float:
    joined = np.concatenate([speed[part] for part in parts])
    return float(np.nanmax(joined)) if np.isfinite(joined).any() else 0.0


def _pause_start(time: FloatArray, speed: FloatArray, part: slice, peak: float) -> float:
    """When the first pause of a part begins; without one, its slowest instant."""
    pauses = _pauses(time, speed, part, peak)
    return float(time[pauses[0].start]) if pauses else _slowest(time, speed, part)


def _pause_end(time: FloatArray, speed: FloatArray, part: slice, peak: float) -> float:
    """When the last pause of a part ends; without one, its slowest instant."""
    pauses = _pauses(time, speed, part, peak)
    return float(time[pauses[-1].stop - 1]) if pauses else _slowest(time, speed, part)


def _pauses(time: FloatArray, speed: FloatArray, part: slice, peak: float) -> list[slice]:
    """Stretches of stillness within a part, in samples of the trial."""
    still = np.zeros(len(time), dtype=bool)
    with np.errstate(invalid="ignore"):
        still[part] = speed[part] < _STILL * peak
    return [run for run in runs(still) if time[run.stop - 1] - time[run.start] >= _PAUSE]


def _slowest(time: FloatArray, speed: FloatArray, part: slice) -> float:
    known = np.flatnonzero(np.isfinite(speed[part]))
    return float(time[part.start + int(known[np.argmin(speed[part][known])])]) if len(known) else float("nan")


def _event(time: FloatArray, touching: BoolArray | None, low: slice, *, last: bool) -> float:
    """Time of the chair's release (last contact) or touch (first contact) in a low phase; NaN without one."""
    found: Sequence[int] = [] if touching is None else np.flatnonzero(touching[low]).tolist()
    if not found:
        return float("nan")
    index = low.start + found[-1] + 1 if last else low.start + found[0]
    return float(time[min(index, len(time) - 1)])
