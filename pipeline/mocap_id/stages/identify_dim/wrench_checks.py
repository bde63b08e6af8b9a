"""Checks of the wrenches of chair and force sensors against the motion of the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.clock_offset import SampledWrench, profile_offset
from mocap_id.dynamics.external_wrenches import SEAT, ExternalWrench
from mocap_id.dynamics.fit import Fit, determines_parameters, fit
from mocap_id.dynamics.lowpass import blank_incomplete
from mocap_id.dynamics.preparation import PreparedTrial, prepare
from mocap_id.dynamics.wrench_gains import WrenchGain, estimate_gains
from mocap_id.verdict import Reason

_SENSOR_RANGE = 1.0  # s, largest clock offset of a sensor that is tried, in both directions
_SENSOR_LEAST = 2.0  # s, shortest duration of the samples for this
_SENSOR_LATE, _SENSOR_BETTER = 0.02, 1.2  # smallest offset that is reported, s, and smallest ratio of the residuals


def check_chair(prepared: PreparedTrial) -> tuple[PreparedTrial, tuple[Reason, ...]]:
    """Return the trial, without the chair's wrench if it contradicts the body's motion, and a note or caution.

    Without a plate under the chair, the trial is unchanged and the tuple is empty.
    """
    recorded = prepared.recorded
    if recorded.seat is None:
        return prepared, ()
    everything = np.ones(len(recorded.time), dtype=bool)
    determined = determines_parameters(prepared, everything)
    gains = estimate_gains(prepared, fit(prepared, everything)) if determined else ()
    wrong = [gain for gain in gains if gain.name == SEAT and gain.contradicts]
    if not wrong:
        text = (
            f"the chair is on its own force plate: its wrench on segment {recorded.seat.segment} is measured, so "
            "samples with contact are also used for the identification"
        )
        return prepared, (Reason("seat-measured", text, level="ok"),)
    without = replace(recorded, external=tuple(each for each in recorded.external if each.name != SEAT))
    gain = _find_worst(wrong)
    text = (
        f"the forces of ground and chair add up best with the chair's {gain.component} times {gain.value:.2f} ± "
        f"{gain.sd:.2f}, expected 1: its plate does not measure the wrench of the chair on the body (wrong sign, "
        "corners or units, another object on the plate, or a chair leg beside it). It was left out, with all samples "
        "with contact"
    )
    reason = Reason("seat-contradiction", text, value=gain.value, limit=1.0)
    return prepare(without, prepared.settings), (reason,)


def check_sensors(prepared: PreparedTrial, found: Fit) -> tuple[Reason, ...]:
    """Return a caution for every sensor whose wrench or clock contradicts the motion of the body."""
    wrong = [gain for gain in estimate_gains(prepared, found) if gain.name != SEAT and gain.contradicts]
    clocks = tuple(_check_clock(prepared, found, each) for each in prepared.recorded.external if not each.by_plates)
    return tuple(reason for reason in clocks if reason is not None) + tuple(
        Reason(
            "external-contradiction",
            f"the forces add up best with the {gain.component} of `{name}` times {gain.value:.2f} ± {gain.sd:.2f}, "
            "expected 1: check its sign (`force: on-sensor`), its axes, its point of application (`at:`), its segment "
            "and its clock (`clock_offset_s:`) under `external:`. It was used without a change",
            value=gain.value,
            limit=1.0,
        )
        for name in dict.fromkeys(gain.name for gain in wrong)
        for gain in [_find_worst([each for each in wrong if each.name == name])]
    )


def _check_clock(prepared: PreparedTrial, found: Fit, sensor: ExternalWrench) -> Reason | None:
    """Return a caution if the forces add up clearly better with another clock offset of a sensor."""
    components, time = list(prepared.settings.components), prepared.recorded.time
    filtered = prepared.lowpass(blank_incomplete(sensor.wrench))[:, components]
    sampled = SampledWrench.of(time, filtered)
    around = np.linspace(-_SENSOR_RANGE, _SENSOR_RANGE, 21)
    known = np.isfinite(sampled(time[found.samples] - around[:, None])).all(axis=(0, 2))
    samples = found.samples[known]
    if len(samples) * prepared.lowpass.step < _SENSOR_LEAST * prepared.recorded.rate:
        return None
    rest = prepared.filtered_measured(samples, time[samples] - found.offset)[:, components] - filtered[samples]
    rows = found.design[known, :, :-1]

    def measured(times: FloatArray) -> FloatArray:
        return (rest + sampled(times)) * found.weights

    every = np.ones(len(components))
    offset, at_end = profile_offset(rows, measured, time[samples], every, _SENSOR_RANGE, prior=found.prior)
    flat = rows.reshape(-1, rows.shape[-1])
    targets = np.stack([measured(time[samples] - each).reshape(-1) for each in (0.0, offset)], axis=1)
    left = np.linalg.norm(targets - flat @ np.linalg.lstsq(flat, targets, rcond=None)[0], axis=0)
    if at_end or abs(offset) <= _SENSOR_LATE or left[0] < _SENSOR_BETTER * left[1]:
        return None
    return Reason(
        "external-clock",
        f"the forces add up best if the clock of `{sensor.name}` is moved by {offset:+.2f} s, expected at most ± "
        f"{_SENSOR_LATE:g} s (residual {left[0] / left[1]:.1f} times as large without). It was not moved: add this "
        "time to its `clock_offset_s:` under `external:`, and check its start",
        value=offset,
        limit=_SENSOR_LATE,
    )


def make_gain_facts(prepared: PreparedTrial, found: Fit) -> list[dict[str, Any]]:
    """Return JSON about each external wrench: name, segment, and the fitted gain of each component (1 is correct)."""
    gains = estimate_gains(prepared, found)
    return [
        {
            "name": each.name,
            "segment": each.segment,
            "factors": {g.component: {"value": g.value, "sd": g.sd} for g in gains if g.name == each.name},
        }
        for each in prepared.recorded.external
    ]


def _find_worst(wrong: Sequence[WrenchGain]) -> WrenchGain:
    """Return the gain whose deviation from 1 has the largest effect relative to its limit."""
    return max(wrong, key=lambda gain: abs(gain.value - 1.0) * gain.size / gain.limit)
