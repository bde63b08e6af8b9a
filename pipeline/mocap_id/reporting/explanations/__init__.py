"""What every code of a verdict means and what to do about it, for people."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.contact import CONTACT
from mocap_id.reporting.explanations.explanation import Explanation
from mocap_id.reporting.explanations.external import EXTERNAL
from mocap_id.reporting.explanations.parameters import PARAMETERS
from mocap_id.reporting.explanations.recording import RECORDING
from mocap_id.reporting.explanations.rising import RISING
from mocap_id.reporting.explanations.skeleton import SKELETON
from mocap_id.reporting.explanations.transfer import TRANSFER
from mocap_id.verdict import Level

__all__ = ["EXPLANATIONS", "LEVELS", "Explanation", "as_markdown"]

EXPLANATIONS: Mapping[str, Explanation] = {
    **RECORDING,
    **SKELETON,
    **CONTACT,
    **RISING,
    **EXTERNAL,
    **PARAMETERS,
    **TRANSFER,
}
"""Every code of every stage and workflow."""

LEVELS: Mapping[Level, tuple[str, str]] = {
    "ok": ("Good", "Every check passed: the numbers below can be used, each with the interval that stands beside it."),
    "caution": (
        "Usable with care",
        "The trial went through, but what is listed here limits what can be concluded from it.",
    ),
    "refused": (
        "Refused",
        "This recording is not what the method can treat. That is a finding, not a failure of the program: below is "
        "why, what to change, and what the recording shows all the same.",
    ),
}
"""Headline and first sentence for each level of a verdict."""


def as_markdown() -> str:
    """The codes as a chapter of the documentation."""
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
