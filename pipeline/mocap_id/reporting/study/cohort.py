"""The data for the page of a study of people: how each trial ended, and the study's tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.contents import COHORT
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.figure import Drawings, Item, Points, Rule
from mocap_id.reporting.grids import GridColumn, text
from mocap_id.reporting.page import KeyNumber, Page, Section
from mocap_id.reporting.reasons import ExplainedReason, Prose, explain_reason, split_code, to_sentence
from mocap_id.reporting.summary_schema import ReasonEntry


@dataclass(frozen=True)
class CohortData:
    """The data for the page of a study of people."""

    study: str  # name of the study
    trials: tuple[TrialEntry, ...]
    tables: Mapping[str, pd.DataFrame]  # the study's tables by name
    remarks: tuple[str, ...] = ()  # sentences about trials that may be of another person

    @property
    def subjects(self) -> tuple[str, ...]:
        """Ids of the people, in the order of the trials."""
        return tuple(dict.fromkeys(self.tables["trials"]["subject"]))

    @property
    def strategies(self) -> tuple[str, ...]:
        """The strategies, in the order of the trials."""
        return tuple(dict.fromkeys(self.tables["trials"]["strategy"]))

    def of_cohort(self, table: str) -> pd.DataFrame:
        """Return the rows of a table that are about all people together."""
        frame = self.tables[table]
        return frame[frame["subject"] == COHORT]

    def of_people(self, table: str) -> pd.DataFrame:
        """Return the rows of a table that are about single people."""
        frame = self.tables[table]
        return frame[frame["subject"] != COHORT]


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


_SPREAD = 0.6  # fraction of a row's height over which the trials of a person are spread


def place_trials(data: CohortData, trials: Sequence[str], subjects: Sequence[str] = ()) -> FloatArray:
    """Return the vertical position of each trial: in the row of the person, a person's trials in their order.

    The rows are in the order of ``subjects``; if it is empty, in the order in which people occur in the trials.
    """
    rows: dict[str, float] = {}
    frame = data.tables["trials"]
    for row, subject in enumerate(subjects or data.subjects):
        own = frame[frame["subject"] == subject]["trial"]
        rows |= {name: row + offset for name, offset in zip(own, spread_evenly(len(own), _SPREAD), strict=True)}
    return np.array([rows[trial] for trial in trials], dtype=np.float64)


def spread_evenly(count: int, width: float) -> FloatArray:
    """Return ``count`` evenly spaced positions, centred at zero, over a width; zero for a single position."""
    return width * (np.arange(count) / (count - 1) - 0.5) if count > 1 else np.zeros(count)


def name_rows(data: CohortData) -> tuple[str, ...]:
    """Return the labels of the rows: the ids of the people."""
    return tuple(style.clean(subject, 16) for subject in data.subjects)


def draw_separators(data: CohortData) -> list[Item]:
    """Return the lines between the rows of two people."""
    return [Rule("y", k - 0.5, style.GRID) for k in range(1, len(data.subjects))]


def draw_dots(data: CohortData, frame: pd.DataFrame, value: str, sd: str, *, factor: float = 1) -> list[Item]:
    """Return a dot with a 95 % interval for each row of a data frame, coloured by strategy.

    ``value`` and ``sd`` are column names; the frame also has `trial` and `strategy`. Values are times ``factor``.
    """
    known = frame[np.isfinite(frame[value].to_numpy(dtype=np.float64))]
    items: list[Item] = []
    for k, strategy in enumerate(data.strategies, start=1):
        own = known[known["strategy"] == strategy]
        if own.empty:
            continue
        trials, spread = own["trial"].tolist(), own[sd].to_numpy(dtype=np.float64)
        half = NORMAL_95 * factor * np.where(np.isfinite(spread), spread, 0.0)
        x = factor * own[value].to_numpy(dtype=np.float64)
        label, names = style.clean(strategy, 20), tuple(style.clean(trial, 30) for trial in trials)
        items.append(
            Points(x, place_trials(data, trials), style.pick_colour(k), label, size=3.5, half=half, names=names)
        )
    return items
