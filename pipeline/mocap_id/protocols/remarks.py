"""Unusual repetitions of sit-to-stand: one text for each repetition, and reasons for the verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mocap_id.protocols.attempts import Attempt
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import SUPPORT_LIMIT, Repetition, RiseDetails
from mocap_id.verdict import Reason

_RISING = 0.25  # share of the rise above which the last sample belongs to a rise


def add_remarks(repetition: Repetition, rise: RiseDetails) -> Repetition:
    """Return the repetition with remarks on its rise in ``why``; it is incomplete if it does not reach standing."""
    partial = ""
    if rise.reached < STANDING:
        partial = f"reaches only {100 * rise.reached:.0f} % of the standing height"
    support = f"{100 * rise.support:.0f} % of the weight carried by an unknown support" if _is_supported(rise) else ""
    remarks = (
        repetition.why,
        partial,
        "" if not rise.attempts else f"{rise.attempts} failed attempt{'' if rise.attempts == 1 else 's'} before",
        "" if not rise.held > 0 else f"paused for {rise.held:.1f} s during the rise",
        support,
    )
    why = "; ".join(remark for remark in remarks if remark)
    return replace(repetition, complete=repetition.complete and not partial, why=why)


def explain_repetitions(
    repetitions: Sequence[Repetition], rises: Sequence[RiseDetails], attempts: Sequence[Attempt], posture: Posture
) -> tuple[Reason, ...]:
    """Return the reasons for the verdict about the repetitions."""
    reasons = _explain_cuts(repetitions, posture)
    if attempts:
        times = ", ".join(f"{attempt.time_s:.1f} s" for attempt in attempts)
        highest = max(attempt.height for attempt in attempts)
        reasons.append(
            Reason(
                "attempt-failed",
                f"an attempt to rise failed {'once' if len(attempts) == 1 else f'{len(attempts)} times'} (at {times}): "
                f"the hips rose up to {100 * max(highest, 0.0):.0f} % of the way to standing and returned to the seat. "
                "Failed attempts are not counted as repetitions",
                value=float(len(attempts)),
            )
        )
    numbered = list(enumerate(rises, start=1))
    partial = {k: rise.reached for k, rise in numbered if rise.reached < STANDING}
    if partial:
        lowest = min(partial.values())
        reasons.append(
            Reason(
                "rise-partial",
                f"the person does not fully stand in repetition {_list(partial)}: the hips reach {100 * lowest:.0f} % "
                "of the height of the other repetitions. It is marked as incomplete and not counted in the five-times "
                "test",
                value=lowest,
                limit=STANDING,
            )
        )
    paused = {k: rise.held for k, rise in numbered if rise.held > 0}
    if paused:
        longest = max(paused.values())
        reasons.append(
            Reason(
                "rise-paused",
                f"the person pauses between seat and standing in repetition {_list(paused)}, for up to {longest:.1f} "
                "s; the times of the repetition include the pause",
                value=longest,
            )
        )
    supported = {k: rise.support for k, rise in numbered if _is_supported(rise)}
    if supported:
        reasons.append(_explain_support(supported))
    return tuple(reasons)


def _is_supported(rise: RiseDetails) -> bool:
    return rise.support > SUPPORT_LIMIT


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def _explain_cuts(repetitions: Sequence[Repetition], posture: Posture) -> list[Reason]:
    """Return a note if the recording begins or ends within a repetition."""
    cuts = [part for each in repetitions for part in each.why.split("; ") if part.startswith("the recording ")]
    height = posture.height[np.isfinite(posture.height)]
    if posture.moves and len(height) and not posture.upright[-1] and height[-1] > _RISING:
        cuts.append("the recording ends during a further rise, which is not counted")
    if not cuts:
        return []
    text = (
        f"{'; '.join(dict.fromkeys(cuts))}: events outside the recording, and quantities of whole repetitions, are "
        "unknown"
    )
    return [Reason("repetition-cut", text, level="ok")]


def _explain_support(shares: Mapping[int, float]) -> Reason:
    """Return a caution about an unknown support; ``shares`` are its shares of the weight by repetition."""
    most = max(shares.values())
    return Reason(
        "support-unexplained",
        f"in the rise of repetition {_list(shares)}, up to {100 * most:.0f} % of the weight is carried neither by the "
        "plates nor, at this height, by a chair: arms on an armrest or rail, or a helping hand. These samples are used "
        "for identification, so parameters and torques are biased; seat-off may be found late. In these rises, and in "
        "the sitting before them, joint torques are unknown (NaN)",
        value=most,
        limit=SUPPORT_LIMIT,
    )
