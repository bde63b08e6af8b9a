"""Checks of the wrenches of chair and force sensors against the motion of the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.dynamics.external_wrenches import SEAT
from mocap_id.dynamics.fit import Fit, determines_parameters, fit
from mocap_id.dynamics.preparation import PreparedTrial, prepare
from mocap_id.dynamics.wrench_gains import WrenchGain, estimate_gains
from mocap_id.verdict import Reason


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
    """Return a caution for every sensor whose wrench contradicts the motion of the body."""
    wrong = [gain for gain in estimate_gains(prepared, found) if gain.name != SEAT and gain.contradicts]
    return tuple(
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
