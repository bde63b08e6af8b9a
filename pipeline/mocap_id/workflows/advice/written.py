"""An advice for people, programs and robots: lines, JSON, a figure, and the movement as CSV."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.dynamics.course import Course
from mocap_id.dynamics.excitation import standing
from mocap_id.dynamics.foresight import Foreseen
from mocap_id.dynamics.proposal import OBJECTIVES, Proposal
from mocap_id.reporting.movement import draw
from mocap_id.reporting.numbers import show
from mocap_id.reporting.paper import drawn
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.advice.advise import Advised

_CLOSER = 0.95  # of a standard deviation: changes by less are not worth a word
_NAMED = 4


def lines(advised: Advised) -> Iterator[str]:
    """In plain words."""
    found = advised.design
    yield f"{advised.trial}: {len(advised.names)} parameters, condition number {found.now.condition:.0f}"
    yield _limits(advised)
    yield ""
    if found.best is None or not found.helps:
        yield (
            "nothing within these limits helps: no movement that was tried takes a fifth off the "
            f"{OBJECTIVES[found.objective]}. More markers, a zeroed plate or a longer recording would"
        )
    else:
        yield f"record this, {found.seconds:.0f} s: {found.best.words}"
        yield f"  {_worth(advised, found.best)}"
    yield ""
    yield "simple changes, best first:"
    shown = [each for each in found.simple if each.value < found.value]
    for place, each in enumerate(shown, start=1):
        yield f"  {place}. {each.words}: {_worth(advised, each)}"
    if not shown:
        yield "  none that would tell more"
    yield ""
    if found.designed is not None:
        yield f"designed: {found.designed.words}: {_worth(advised, found.designed)}"
    else:
        yield "designed: no movement of all joints together stays within these limits"
    yield ""
    yield from _table(advised)


def _limits(advised: Advised) -> str:
    limits = advised.limits
    parts = [
        f"{name} {np.degrees(low):.0f}° to {np.degrees(high):.0f}°, up to {np.degrees(speed):.0f}°/s"
        for name, low, high, speed in zip(advised.joints, limits.low, limits.high, limits.speed, strict=True)
    ]
    if limits.support is None:
        return "limits: " + "; ".join(parts) + "; the base is bolted down"
    low, high = (100 * end for end in limits.support)
    return "limits: " + "; ".join(parts) + f"; centre of pressure {low:.1f} to {high:.1f} cm"


def _worth(advised: Advised, proposal: Proposal) -> str:
    """By how much the standard deviations shrink, those that are largest first, and the condition number."""
    found = advised.design
    before, after = found.now.sd / found.size, proposal.foreseen.sd / found.size
    gains = [i for i in np.argsort(-before) if after[i] < _CLOSER * before[i]]
    named = [
        f"sd of {advised.names[i]} from {show(100 * before[i], 2, '%')} to {show(100 * after[i], 2, '%')}"
        for i in gains[:_NAMED]
    ]
    condition = f"condition number {found.now.condition:.0f} -> {proposal.foreseen.condition:.0f}"
    return ", ".join([*(named or ["no sd smaller"]), condition])


def _table(advised: Advised) -> Iterator[str]:
    found = advised.design
    columns = [("now", found.now)]
    if found.simple:
        columns.append(("simple", found.simple[0].foreseen))
    if found.designed is not None:
        columns.append(("designed", found.designed.foreseen))
    width = max(map(len, advised.names))
    yield "sd by size, %".ljust(width) + "".join(name.rjust(10) for name, _ in columns)
    for i, name in enumerate(advised.names):
        yield name.ljust(width) + "".join(f"{100 * f.sd[i] / found.size[i]:10.2f}" for _, f in columns)
    yield "condition number".ljust(width) + "".join(f"{f.condition:10.1f}" for _, f in columns)


def as_json(advised: Advised) -> dict[str, Any]:
    """The same for programs; null where a number is not known."""
    found, limits = advised.design, advised.limits
    return {
        "schema": "mocap-id/advice",
        "version": 1,
        "trial": advised.trial,
        "objective": {"name": found.objective, "text": OBJECTIVES[found.objective], "now": _number(found.value)},
        "helps": found.helps,
        "seconds": found.seconds,
        "limits": {
            "joints": [
                {
                    "name": name,
                    "low_deg": math.degrees(limits.low[j]),
                    "high_deg": math.degrees(limits.high[j]),
                    "speed_deg_s": math.degrees(limits.speed[j]),
                    "acceleration_deg_s2": math.degrees(limits.acceleration[j]),
                }
                for j, name in enumerate(advised.joints)
            ],
            "support_m": None if limits.support is None else list(limits.support),
        },
        "now": _foreseen(advised, found.now),
        "simple": [_proposal(advised, each) for each in found.simple],
        "designed": None if found.designed is None else _proposal(advised, found.designed),
    }


def _proposal(advised: Advised, proposal: Proposal) -> dict[str, Any]:
    head = {"text": proposal.words, "designed": proposal.designed, "objective": _number(proposal.value)}
    return head | _foreseen(advised, proposal.foreseen)


def _foreseen(advised: Advised, foreseen: Foreseen) -> dict[str, Any]:
    size = advised.design.size
    return {
        "condition_number": _number(foreseen.condition),
        "condition_number_scaled": _number(foreseen.condition_scaled),
        "fitted_s": foreseen.samples,
        "parameters": [
            {
                "name": name,
                "value": float(advised.value[i]),
                "unit": advised.units[i],
                "sd": _number(foreseen.sd[i]),
                "relative_sd": _number(foreseen.sd[i] / size[i]),
                "verdict": standing(float(foreseen.sd[i] / size[i]), advised.weak),
            }
            for i, name in enumerate(advised.names)
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def csv_text(advised: Advised, course: Course) -> str:
    """A movement: time_s, and angle, velocity and acceleration of every joint in rad, rad/s and rad/s²."""
    heads = [f"{joint.replace(' ', '_')}_{unit}" for unit in ("rad", "rad_s", "rad_s2") for joint in advised.joints]
    rows = np.column_stack([course.time - course.time[0], course.q, course.dq, course.ddq])
    stream = io.StringIO()
    np.savetxt(stream, rows, fmt="%.6f", delimiter=",", header=",".join(["time_s", *heads]), comments="")
    return stream.getvalue()


def write(advised: Advised, folder: Path) -> tuple[Path, ...]:
    """Write ``advice.json``; and ``movement.csv`` and ``movement.svg`` (and PDF) of the best movement of its own.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    told = json.dumps(as_json(advised), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    contents = {"advice.json": told.encode()}
    made = advised.design.made
    if made is not None:
        contents["movement.csv"] = csv_text(advised, made.course).encode()
        title = f"A movement to record after {advised.trial}"
        contents |= drawn("movement", title, lambda: draw(made.course, advised.joints, advised.limits, made.words))
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    replace_together(folder, contents)
    return tuple(folder / name for name in contents)
