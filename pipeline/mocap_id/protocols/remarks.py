"""Remarks on unusual repetitions: one text for each repetition, and reasons for the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_id.protocols.attempts import Attempt
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.rise_details import RiseDetails
from mocap_id.protocols.support import LIMIT
from mocap_id.verdict import Reason


def with_remark(repetition: Repetition, rise: RiseDetails) -> Repetition:
    """Return the repetition with remarks added to ``why``; it is incomplete if it does not reach standing."""
    partial = _partial(rise)
    remarks = (
        repetition.why,
        partial,
        "" if not rise.attempts else f"{rise.attempts} failed attempt{'' if rise.attempts == 1 else 's'} before",
        "" if not rise.held > 0 else f"paused for {rise.held:.1f} s during the rise",
        "" if not rise.support > LIMIT else f"{100 * rise.support:.0f} % of the weight carried by an unknown support",
    )
    why = "; ".join(remark for remark in remarks if remark)
    return replace(repetition, complete=repetition.complete and not partial, why=why)


def reasons(
    repetitions: Sequence[Repetition], rises: Sequence[RiseDetails], attempts: Sequence[Attempt], posture: Posture
) -> tuple[Reason, ...]:
    """Return the reasons for the verdict about the repetitions.

    Parameters
    ----------
    repetitions : sequence of Repetition
        Repetitions found by the protocol, without remarks.
    rises : sequence of RiseDetails
        Their details.
    attempts : sequence of Attempt
        Failed attempts.
    posture : Posture
    """
    found = (
        _cut(repetitions, posture),
        _failed(attempts),
        _short(rises),
        _paused(rises),
        _supported(rises),
    )
    return tuple(reason for reason in found if reason is not None)


def _partial(rise: RiseDetails) -> str:
    return f"reaches only {100 * rise.reached:.0f} % of the standing height" if rise.reached < STANDING else ""


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _listed(rises: Sequence[RiseDetails], chosen: Sequence[bool]) -> str:
    return ", ".join(str(k) for k, (_, one) in enumerate(zip(rises, chosen, strict=True), start=1) if one)


def _cut(repetitions: Sequence[Repetition], posture: Posture) -> Reason | None:
    whats = [part for each in repetitions for part in each.why.split("; ") if part.startswith("the recording ")]
    height = posture.height[np.isfinite(posture.height)]
    if posture.moves and len(height) and not posture.upright[-1] and height[-1] > 0.25:
        whats.append("the recording ends during a further rise, which is not counted")
    if not whats:
        return None
    return Reason(
        "repetition-cut",
        f"{'; '.join(dict.fromkeys(whats))}: events outside the recording, and quantities of whole repetitions, are "
        "unknown",
        level="ok",
    )


def _failed(attempts: Sequence[Attempt]) -> Reason | None:
    if not attempts:
        return None
    each = ", ".join(f"{one.time:.1f} s" for one in attempts)
    highest = max(attempts, key=lambda one: one.height)
    return Reason(
        "attempt-failed",
        f"an attempt to rise failed {_times(len(attempts))} (at {each}): the hips rose up to "
        f"{100 * max(highest.height, 0.0):.0f} % of the way to standing and returned to the seat. Failed attempts are "
        "not counted as repetitions",
        value=float(len(attempts)),
        level="caution",
    )


def _short(rises: Sequence[RiseDetails]) -> Reason | None:
    short = [rise.reached < STANDING for rise in rises]
    if not any(short):
        return None
    lowest = min(rise.reached for rise in rises if rise.reached < STANDING)
    return Reason(
        "rise-partial",
        f"repetition {_listed(rises, short)} does not reach standing: the hips reach {100 * lowest:.0f} % of the "
        "height of the other repetitions. It is marked as incomplete and not counted in the five-times test",
        value=lowest,
        limit=STANDING,
        level="caution",
    )


def _paused(rises: Sequence[RiseDetails]) -> Reason | None:
    paused = [rise.held > 0 for rise in rises]
    if not any(paused):
        return None
    longest = max(rise.held for rise in rises if rise.held > 0)
    return Reason(
        "rise-paused",
        f"repetition {_listed(rises, paused)} pauses between seat and standing, for up to {longest:.1f} s; its times "
        "include the pause",
        value=longest,
        level="caution",
    )


def _supported(rises: Sequence[RiseDetails]) -> Reason | None:
    supported = [rise.support > LIMIT for rise in rises]
    if not any(supported):
        return None
    most = max(rise.support for rise in rises if rise.support > LIMIT)
    return Reason(
        "support-unexplained",
        f"in the rise of repetition {_listed(rises, supported)}, up to {100 * most:.0f} % of the weight is carried "
        "neither by the plates nor, at this height, by a chair: arms on an armrest or rail, or a helping hand. These "
        "samples are used for identification, so parameters and torques are biased; seat-off may be found late",
        value=most,
        limit=LIMIT,
        level="caution",
    )
