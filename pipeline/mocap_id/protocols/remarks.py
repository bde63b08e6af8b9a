"""What is unusual about repetitions, in words: for each of them, and for the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_id.protocols.attempts import Attempt
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.rise import Rise
from mocap_id.protocols.support import LIMIT
from mocap_id.verdict import Reason


def with_remark(repetition: Repetition, rise: Rise) -> Repetition:
    """The repetition with everything unusual among its ``why``; one that does not come to standing is not complete."""
    partial = _partial(rise)
    remarks = (
        repetition.why,
        partial,
        "" if not rise.attempts else f"{_times(rise.attempts)} tried in vain before",
        "" if not rise.held > 0 else f"held for {rise.held:.1f} s in mid-rise",
        "" if not rise.support > LIMIT else f"{100 * rise.support:.0f} % of the weight carried by something unknown",
    )
    why = "; ".join(remark for remark in remarks if remark)
    return replace(repetition, complete=repetition.complete and not partial, why=why)


def reasons(
    repetitions: Sequence[Repetition], rises: Sequence[Rise], tried: Sequence[Attempt], posture: Posture
) -> tuple[Reason, ...]:
    """What the verdict says of the repetitions.

    Parameters
    ----------
    repetitions : sequence of Repetition
        As the protocol found them.
    rises : sequence of Rise
        Their details.
    tried : sequence of Attempt
    posture : Posture
    """
    found = (
        _cut(repetitions, posture),
        _failed(tried),
        _short(rises),
        _paused(rises),
        _supported(rises),
    )
    return tuple(reason for reason in found if reason is not None)


def _partial(rise: Rise) -> str:
    return f"reaches only {100 * rise.reached:.0f} % of the height of standing" if rise.reached < STANDING else ""


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _listed(rises: Sequence[Rise], chosen: Sequence[bool]) -> str:
    return ", ".join(str(k) for k, (_, one) in enumerate(zip(rises, chosen, strict=True), start=1) if one)


def _cut(repetitions: Sequence[Repetition], posture: Posture) -> Reason | None:
    """The recording's ends cut repetitions off."""
    whats = [part for each in repetitions for part in each.why.split("; ") if part.startswith("the recording ")]
    height = posture.height[np.isfinite(posture.height)]
    if posture.moves and len(height) and not posture.upright[-1] and height[-1] > 0.25:
        whats.append("the recording ends during a rise that is not counted")
    if not whats:
        return None
    return Reason(
        "repetition-cut",
        f"{'; '.join(dict.fromkeys(whats))}: events outside the recording are not known, and what belongs to a whole "
        "repetition is not told",
        level="ok",
    )


def _failed(tried: Sequence[Attempt]) -> Reason | None:
    if not tried:
        return None
    each = ", ".join(f"{one.time:.1f} s" for one in tried)
    highest = max(tried, key=lambda one: one.height)
    return Reason(
        "attempt-failed",
        f"a rise was broken off {_times(len(tried))} (at {each}): the hips came up to "
        f"{100 * max(highest.height, 0.0):.0f} % of the way to standing and back to the seat. It is counted as no "
        "repetition",
        value=float(len(tried)),
        level="caution",
    )


def _short(rises: Sequence[Rise]) -> Reason | None:
    short = [rise.reached < STANDING for rise in rises]
    if not any(short):
        return None
    lowest = min(rise.reached for rise in rises if rise.reached < STANDING)
    return Reason(
        "rise-partial",
        f"repetition {_listed(rises, short)} does not come to standing: the hips reach {100 * lowest:.0f} % of the "
        "height that they reach in the others. It is kept, as not complete, and not counted for the five-times test",
        value=lowest,
        limit=STANDING,
        level="caution",
    )


def _paused(rises: Sequence[Rise]) -> Reason | None:
    paused = [rise.held > 0 for rise in rises]
    if not any(paused):
        return None
    longest = max(rise.held for rise in rises if rise.held > 0)
    return Reason(
        "rise-paused",
        f"repetition {_listed(rises, paused)} stops between seat and standing, for up to {longest:.1f} s: its times "
        "are longer by that",
        value=longest,
        level="caution",
    )


def _supported(rises: Sequence[Rise]) -> Reason | None:
    supported = [rise.support > LIMIT for rise in rises]
    if not any(supported):
        return None
    most = max(rise.support for rise in rises if rise.support > LIMIT)
    return Reason(
        "support-unexplained",
        f"while repetition {_listed(rises, supported)} rises, up to {100 * most:.0f} % of the weight is carried "
        "neither by the plates nor, that high, by a chair: arms on a rest or rail, or a helping hand. Samples with "
        "that support are identified on, so parameters and torques are biased; seat-off may be told late",
        value=most,
        limit=LIMIT,
        level="caution",
    )
