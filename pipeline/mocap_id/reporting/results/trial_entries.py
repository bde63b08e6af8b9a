"""How each trial of a study ended, as data and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from mocap_id.reporting import style
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.page import ExplainedReason, Prose, explained, prose, sentence
from mocap_id.reporting.summary_schema import ReasonEntry

Fate: TypeAlias = Literal["ok", "caution", "refused", "failed"]
FATES: dict[Fate, str] = {"ok": "good", "caution": "usable with care", "refused": "refused", "failed": "failed"}
"""Each way to end, in words: the level of the verdict, or that there is none."""


@dataclass(frozen=True)
class TrialEntry:
    """How one trial ended."""

    name: str
    about: str  # person and strategy, or joint and movement
    fate: Fate
    reasons: Sequence[ReasonEntry]  # reasons of the verdict, without notes
    message: str | None  # why the trial failed
    report: str | None  # path of the trial's own report, from the page's folder

    @property
    def passed(self) -> bool:
        """Whether the trial has results."""
        return self.fate in ("ok", "caution")

    @property
    def level(self) -> str:
        """Level whose colour the page uses."""
        return "refused" if self.fate == "failed" else self.fate

    @property
    def headline(self) -> str:
        """How the trial ended, as a heading."""
        return "Failed" if self.fate == "failed" else LEVELS[self.fate][0]

    @property
    def lead(self) -> Prose:
        """What this outcome means, or why the trial failed."""
        if self.fate != "failed":
            return prose(LEVELS[self.fate][1])
        return prose(sentence(style.printable(self.message)) if self.message else "It could not be computed.")

    @property
    def explained(self) -> tuple[ExplainedReason, ...]:
        """The reasons with their explanations."""
        return tuple(explained(reason) for reason in self.reasons)


def headline(trials: Sequence[TrialEntry]) -> str:
    """Return how many trials have results."""
    return f"{sum(trial.passed for trial in trials)} of {len(trials)} trials went through"


def counts(trials: Sequence[TrialEntry]) -> str:
    """Return how many trials ended in which way, as a sentence without a full stop."""
    counted = {words: sum(trial.fate == fate for trial in trials) for fate, words in FATES.items()}
    text = ", ".join(f"{count} {words}" for words, count in counted.items() if count)
    return f"{text[:1].upper()}{text[1:]}"
