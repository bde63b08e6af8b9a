"""Chair contact in sit-to-stand and squat trials (thesis ch. 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, find_runs
from mocap_id.dynamics.external_wrenches import SEAT
from mocap_id.dynamics.fit import determines_parameters, fit
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.protocols import contact_rules
from mocap_id.protocols.contact_rules import ContactRule, DecidingRule
from mocap_id.protocols.posture import Posture

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
    """Find the samples with chair contact by a rule of :mod:`mocap_id.protocols.contact_rules`.

    Parameters
    ----------
    weight_share : float
        Share of the standing weight under the feet at which the chair is released (rule ``weight``).
    knee_bend : float
        Angle of the knee below which the person is off the chair (rule ``knee``), rad.
    """
    if prepared.recorded.seat is not None:
        return find_contact_by_seat_plate(prepared, posture)
    vertical = prepared.recorded.surroundings[:, 1]
    weight = contact_rules.measure_standing_weight(posture, vertical)
    chair = contact_rules.uses_chair(posture, vertical, weight)
    if chair is False:
        nowhere = np.zeros(len(vertical), dtype=bool)
        return Contact(False, nowhere, ~nowhere, nowhere, weight, None, rule)
    off_chair = contact_rules.find_samples_off_chair(posture)
    if rule == "weight" and determines_parameters(prepared, off_chair):  # no model finds the clock later by this rule
        vertical = prepared.measured(fit(prepared, off_chair).offset)[:, 1]
    with np.errstate(invalid="ignore"):
        by_weight = contact_rules.find_contact_in_low_phases(posture, vertical < weight_share * weight)
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
    return _find_contact_by_seat_force(prepared, posture, first, weight)


def find_contact_by_seat_plate(prepared: PreparedTrial, posture: Posture) -> Contact:
    """Find the chair contact by the chair's own plate; all samples are usable because all forces are measured."""
    assert prepared.recorded.seat is not None
    everything = np.ones(len(prepared.recorded.time), dtype=bool)
    offset = fit(prepared, everything).offset if determines_parameters(prepared, everything) else 0.0
    seat = prepared.external(offset)[[each.name for each in prepared.recorded.external].index(SEAT)][:, 1]
    weight = contact_rules.measure_standing_weight(posture, prepared.measured(offset)[:, 1])
    if np.isnan(weight):  # the person never stands, so feet and chair together carry the weight
        weight = float(np.nanmedian(prepared.recorded.surroundings[:, 1]))
    threshold = contact_rules.compute_contact_threshold(float(np.nanstd(seat[posture.upright])), weight)
    with np.errstate(invalid="ignore"):
        above_noise = contact_rules.find_contact_in_low_phases(posture, seat > threshold)
        touching = contact_rules.extend_contact_to_release(prepared.recorded.time, above_noise, seat)
    unmeasured = ~np.isfinite(prepared.recorded.seat.wrench[:, 1]) & ~contact_rules.find_samples_off_chair(posture)
    return Contact(
        bool(touching.any()),
        touching,
        everything,
        unmeasured,
        weight,
        threshold,
        "seat-plate",
        above_noise=above_noise,
    )


def _find_contact_by_seat_force(prepared: PreparedTrial, posture: Posture, first: BoolArray, weight: float) -> Contact:
    """Alternately fit a model to the free samples and find the contact with this model, until the contact converges.

    Without convergence, samples with contact in either of the last two rounds are excluded. If the free samples of a
    round would not determine a model, the search ends with the contact of the previous round.
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
        noise = contact_rules.estimate_noise_on_chair(seat_force[found.in_fit], posture.height[found.in_fit])
        threshold = contact_rules.compute_contact_threshold(noise, weight)
        with np.errstate(invalid="ignore"):
            above_noise = contact_rules.find_contact_in_low_phases(posture, seat_force > threshold)
        if not determines_parameters(prepared, ~above_noise):
            break
        before, touching, free = touching, above_noise, ~above_noise
        converged = all(run.stop - run.start <= _SETTLED * rate for run in find_runs(before ^ touching))
        if converged:
            break
    if not converged and determines_parameters(prepared, ~(touching | before)):
        touching = touching | before
    extended = contact_rules.extend_contact_to_release(prepared.recorded.time, touching, missing)
    # a lost plate signal shows no chair force; only the height of the hips then excludes the chair
    carried = extended | (~np.isfinite(missing) & ~contact_rules.find_samples_off_chair(posture))
    extended = extended if determines_parameters(prepared, ~extended) else touching
    return Contact(True, extended, ~extended, carried, weight, threshold, "seat-force", converged, touching)
