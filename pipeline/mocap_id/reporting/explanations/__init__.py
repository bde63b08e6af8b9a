"""Plain-language explanations of every reason code: what it means and what to do."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.chain import CHAIN
from mocap_id.reporting.explanations.contact import CONTACT
from mocap_id.reporting.explanations.explanation import Explanation
from mocap_id.reporting.explanations.inertial import INERTIAL
from mocap_id.reporting.explanations.landmarks import LANDMARKS
from mocap_id.reporting.explanations.parameters import PARAMETERS
from mocap_id.reporting.explanations.recording import RECORDING
from mocap_id.reporting.explanations.space import SPACE
from mocap_id.reporting.explanations.transfer import TRANSFER
from mocap_id.verdict import Level

__all__ = ["EXPLANATIONS", "LEVELS", "Explanation", "as_markdown"]

EXPLANATIONS: Mapping[str, Explanation] = {
    **RECORDING,
    **CHAIN,
    **LANDMARKS,
    **SPACE,
    **INERTIAL,
    **CONTACT,
    **PARAMETERS,
    **TRANSFER,
}
"""Explanations of all stages and workflows by reason code."""

LEVELS: Mapping[Level, tuple[str, str]] = {
    "ok": ("Good", "Every check passed. The numbers below can be used, each with its interval."),
    "caution": (
        "Usable with care",
        "The trial was processed, but the reasons listed here limit what can be concluded from it.",
    ),
    "refused": (
        "Refused",
        "The method cannot treat this recording. This is a finding about the recording, not a program failure. The "
        "report says why, what to change, and what the recording still shows.",
    ),
}
"""Headline and first sentence for each level of a verdict."""


def as_markdown() -> str:
    """Return the explanations of all codes as a chapter of the documentation."""
    order: tuple[Level, ...] = ("refused", "caution", "ok")
    names = {"refused": "refused", "caution": "caution", "ok": "note"}
    entries = sorted(EXPLANATIONS.items(), key=lambda item: (order.index(item[1].levels[0]), item[0]))
    parts = (
        f"### `{code}`: {entry.title}\n\n"
        f"*{' or '.join(names[level] for level in entry.levels)}*\n\n"
        f"{entry.meaning}\n\n**What to do.** {entry.action}\n"
        for code, entry in entries
    )
    return "\n".join(parts)
