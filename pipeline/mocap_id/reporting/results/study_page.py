"""The page of a study of people, and how each of its trials ended."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from mocap_id.reporting import style
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.grids import GridColumn, text
from mocap_id.reporting.page import (
    ExplainedReason,
    KeyNumber,
    Page,
    Prose,
    Section,
    explain_reason,
    split_code,
    to_sentence,
)
from mocap_id.reporting.study.page_data import CohortData
from mocap_id.reporting.summary_schema import ReasonEntry

Ending: TypeAlias = Literal["ok", "caution", "refused", "failed"]
ENDINGS: dict[Ending, str] = {"ok": "good", "caution": "usable with care", "refused": "refused", "failed": "failed"}
"""Words for how a trial can end: with a level of the verdict, or as failed, without a verdict."""
VERDICT: GridColumn = text("verdict", lambda row: ENDINGS[row["verdict"]])
"""Column with the verdict, for tables of trials."""


@dataclass(frozen=True)
class TrialEntry:
    """How one trial ended."""

    name: str
    about: str  # description, such as person and strategy, or joint and movement
    ending: Ending
    reasons: Sequence[ReasonEntry]  # reasons for the verdict, without notes
    message: str | None  # why the trial failed; None if it did not fail or if this is unknown
    report: str | None  # path of the trial's own report relative to the folder of the page; None without one

    @property
    def passed(self) -> bool:
        """Whether the trial has results."""
        return self.ending in ("ok", "caution")

    @property
    def level(self) -> str:
        """Level that sets the colour of the trial's box on the page."""
        return "refused" if self.ending == "failed" else self.ending

    @property
    def headline(self) -> str:
        """How the trial ended, as a heading."""
        return "Failed" if self.ending == "failed" else LEVELS[self.ending][0]

    @property
    def lead(self) -> Prose:
        """Sentence that says what the verdict means, or why the trial failed."""
        if self.ending != "failed":
            return split_code(LEVELS[self.ending][1])
        message = self.message or "the trial could not be computed"
        return split_code(to_sentence(style.clean(message)))

    @property
    def explained(self) -> tuple[ExplainedReason, ...]:
        """The reasons for the verdict with their explanations."""
        return tuple(map(explain_reason, self.reasons))


def count_passed(trials: Sequence[TrialEntry]) -> str:
    """Return a clause that says how many trials have results."""
    return f"{sum(trial.passed for trial in trials)} of {len(trials)} trials have results"


def render_study_page(
    data: CohortData,
    key_numbers: Iterable[KeyNumber],
    sections: Iterable[Section],
    figures: Drawings,
    footer: str,
) -> bytes:
    """Return the page of a study of people as HTML in UTF-8; its first sentences say how the trials ended."""
    trials = data.trials
    counts = {words: sum(trial.ending == ending for trial in trials) for ending, words in ENDINGS.items()}
    remarks = [to_sentence(remark) for remark in data.remarks]
    endings = to_sentence(", ".join(f"{count} {words}" for words, count in counts.items() if count))
    return Page(
        name=data.study,
        headline=count_passed(trials),
        lead=" ".join([endings, "Tables and figures are about the trials that have results.", *remarks]),
        command="study",
        sections=tuple(sections),
        figures=figures,
        footer=footer,
        level="ok" if all(trial.ending == "ok" for trial in trials) and not remarks else "caution",
        key_numbers=tuple(key_numbers),
        trials=trials,
    ).render()
