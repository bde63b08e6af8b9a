"""What else than the ground acts on the body: read from wrench.parquet, and held against what the body feels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.dynamics.external import SEAT, External
from mocap_id.dynamics.fit import Fit, determined, fit
from mocap_id.dynamics.gains import Gain, gains
from mocap_id.dynamics.prepare import Prepared, Recorded, prepare
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Context
from mocap_id.verdict import Reason

_THIGH = "thigh"
_THIRD = 2  # segment of a leg that stands on its foot, whatever it is called


def external(context: Context, seat_plate: bool, seat_segment: str | int | None) -> tuple[External, ...]:
    """The external wrenches of wrench.parquet and the segments that they act on.

    Raises
    ------
    ConfigError
        A segment is named that the chain does not have.
    """
    table = context.table("wrench.parquet")
    told = [fact for fact in table.facts.get("external") or () if seat_plate or fact["name"] != SEAT]
    if not told:
        return ()
    tree: Any = context.tree("chain.h5").data["segments"]
    names = [str(name) for name in tree["name"]]
    found = []
    for fact in told:
        wrench = table.stack([f"{component}_{fact['columns']}" for component in WRENCH_COMPONENTS])
        wanted, key = fact.get("segment"), f"external: {fact['name']}: segment"
        if fact["name"] == SEAT:
            wanted, key = _seat(names) if seat_segment is None else seat_segment, "identify-dim: seat_segment"
        segment = _segment(names, wanted, key)
        found.append(External(fact["name"], segment, wrench, by_plates=fact["clock"] == "plates"))
    return tuple(found)


def settle(recorded: Recorded, prepared: Prepared | None) -> tuple[Recorded, Prepared | None, tuple[Reason, ...]]:
    """Keep the chair's wrench if it can be what the body feels; else leave it out, as if it were not measured."""
    if recorded.seat is None or prepared is None:
        return recorded, prepared, ()
    everything = np.ones(len(recorded.time), dtype=bool)
    judged = gains(prepared, fit(prepared, everything)) if determined(prepared, everything) else ()
    wrong = [gain for gain in judged if gain.name == SEAT and gain.contradicts]
    if not wrong:
        return recorded, prepared, (_measured(recorded.seat),)
    without = replace(recorded, external=tuple(each for each in recorded.external if each.name != SEAT))
    return without, prepare(without, prepared.settings), (_contradiction(wrong),)


def doubts(prepared: Prepared, found: Fit) -> tuple[Reason, ...]:
    """Sensors whose force cannot be what the body feels."""
    judged = [gain for gain in gains(prepared, found) if gain.name != SEAT and gain.contradicts]
    return tuple(
        Reason(
            "external-contradiction",
            f"the forces add up best with the {gain.component} of `{name}` times {gain.value:.2f} ± {gain.sd:.2f}, "
            "expected 1: look at its sense (`force: on-sensor`), its axes, where it acts (`at:`), its segment's marker "
            "and its clock (`clock_offset_s:`) under `external:`. It was used as it is",
            value=gain.value,
            limit=1.0,
        )
        for name in dict.fromkeys(gain.name for gain in judged)
        for gain in [_worst([each for each in judged if each.name == name])]
    )


def facts(prepared: Prepared, found: Fit) -> list[dict[str, Any]]:
    """JSON rows for dynamics.h5: name, segment and the factors with which the forces add up best."""
    judged = gains(prepared, found)
    return [
        {
            "name": each.name,
            "segment": each.segment,
            "factors": {g.component: {"value": g.value, "sd": g.sd} for g in judged if g.name == each.name},
        }
        for each in prepared.recorded.external
    ]


def _segment(names: Sequence[str], wanted: str | int, key: str) -> int:
    """Number of a segment by its name or number."""
    if isinstance(wanted, int) and 0 <= wanted < len(names):
        return wanted
    if wanted in names:
        return names.index(str(wanted))
    listed = ", ".join(f"{number} ({name})" for number, name in enumerate(names))
    raise ConfigError(f"{key}: there is no segment {wanted!r} here; expected one of {listed}")


def _seat(names: Sequence[str]) -> int:
    """The thigh; by its place in the leg where no segment is called so."""
    return names.index(_THIGH) if _THIGH in names else min(_THIRD, len(names) - 1)


def _worst(wrong: Sequence[Gain]) -> Gain:
    return max(wrong, key=lambda gain: abs(gain.value - 1.0) * gain.size / gain.limit)


def _measured(seat: External) -> Reason:
    return Reason(
        "seat-measured",
        f"the chair stands on a force plate of its own: its wrench, which acts on segment {seat.segment}, counts as "
        "measured, and samples with contact are identified on too",
        level="ok",
    )


def _contradiction(wrong: Sequence[Gain]) -> Reason:
    gain = _worst(wrong)
    return Reason(
        "seat-contradiction",
        f"the forces of ground and chair add up best with the chair's {gain.component} times {gain.value:.2f} ± "
        f"{gain.sd:.2f}, expected 1: its plate's wrench is not what the chair does to the body (sign, corners, units, "
        "another thing on that plate, or a part of the chair beside it). It was left out, and with it all samples with "
        "contact",
        value=gain.value,
        limit=1.0,
    )
