"""Reasons for the verdict with the explanations of their codes, for the pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from mocap_id.reporting import style
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.summary_schema import ReasonEntry

Prose: TypeAlias = tuple[tuple[str, bool], ...]
"""Pieces of a text; the flag of a piece is true for code, which was between backticks."""


@dataclass(frozen=True)
class ExplainedReason:
    """A reason for the verdict with the explanation of its code; meaning and action are empty for an unknown code."""

    level: str
    code: str
    title: str
    message: Prose
    meaning: Prose
    action: Prose


def explain_reason(reason: ReasonEntry) -> ExplainedReason:
    """Return a reason together with the explanation of its code."""
    explanation = EXPLANATIONS.get(reason.code)
    return ExplainedReason(
        level=reason.level,
        code=reason.code,
        title=explanation.title if explanation else reason.code.replace("-", " ").capitalize(),
        message=split_code(to_sentence(style.clean(reason.message))),
        meaning=split_code(explanation.meaning) if explanation else (),
        action=split_code(explanation.action) if explanation else (),
    )


def split_code(text: str) -> Prose:
    """Split a text at backticks into text and code; a text with an unpaired backtick stays one piece of text."""
    pieces = text.split("`")
    if len(pieces) % 2 == 0:
        return ((text, False),)
    return tuple((piece, k % 2 == 1) for k, piece in enumerate(pieces) if piece)


def to_sentence(message: str) -> str:
    """Return a message with a capital letter and a full stop, which it does not have on the terminal."""
    return f"{message[:1].upper()}{message[1:]}" + ("" if message.endswith((".", "?", "!", "…")) else ".")
