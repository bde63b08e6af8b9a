"""What the pages of all studies of people share: the data, how each trial ended, and figures with a row per person."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.reporting import COHORT, ENDINGS, Ending, style
from mocap_id.reporting.figure import Drawings, Item, Points, Rule
from mocap_id.reporting.page import KeyNumber, Page, Section, to_sentence
from mocap_id.reporting.summary_schema import ReasonEntry

if TYPE_CHECKING:
    from mocap_id.reporting.results import ResultTable

_SPREAD = 0.6  # fraction of a row's height over which the trials of a person are spread


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


@dataclass(frozen=True)
class CohortData:
    """The data for the page of a study of people."""

    study: str  # name of the study
    trials: tuple[TrialEntry, ...]
    tables: Mapping[str, ResultTable]  # the study's tables by name
    remarks: tuple[str, ...] = ()  # sentences about trials that may be of another person

    def frame(self, table: str) -> pd.DataFrame:
        """Return all rows of a table."""
        return self.tables[table].frame

    def of_cohort(self, table: str) -> pd.DataFrame:
        """Return the rows of a table that are about all people together."""
        return self.frame(table)[self.frame(table)["subject"] == COHORT]

    def of_people(self, table: str) -> pd.DataFrame:
        """Return the rows of a table that are about single people."""
        return self.frame(table)[self.frame(table)["subject"] != COHORT]

    def list_labels(self, label: str) -> list[str]:
        """Return the different values of a column of the table `trials`, in the order of the trials."""
        return list(dict.fromkeys(self.frame("trials")[label]))

    @property
    def subjects(self) -> list[str]:
        """Ids of the people, in the order of the trials."""
        return self.list_labels("subject")


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


# Figures with a row for each person and, within the row, a position for each trial.


def place_trials(data: CohortData, trials: Sequence[str], subjects: Sequence[str] = ()) -> FloatArray:
    """Return the vertical position of each trial: in the row of the person, a person's trials in their order.

    The rows are in the order of ``subjects``; if it is empty, in the order in which people occur in the trials.
    """
    rows: dict[str, float] = {}
    frame = data.frame("trials")
    for row, subject in enumerate(subjects or data.subjects):
        own = frame[frame["subject"] == subject]["trial"]
        rows |= {name: row + offset for name, offset in zip(own, spread_evenly(len(own), _SPREAD), strict=True)}
    return np.array([rows[trial] for trial in trials], dtype=np.float64)


def spread_evenly(count: int, width: float) -> FloatArray:
    """Return ``count`` evenly spaced positions, centred at zero, over a width; zero for a single position."""
    return width * (np.arange(count) / (count - 1) - 0.5) if count > 1 else np.zeros(count)


def draw_separators(data: CohortData) -> list[Item]:
    """Return the lines between the rows of two people."""
    return [Rule("y", k - 0.5, style.GRID) for k in range(1, len(data.subjects))]


def draw_dots(data: CohortData, frame: pd.DataFrame, value: str, sd: str, *, factor: float = 1) -> list[Item]:
    """Return a dot with a 95 % interval for each row of a data frame, coloured by strategy.

    ``value`` and ``sd`` are column names; the frame also has `trial` and `strategy`. Values are times ``factor``.
    """
    known = frame[np.isfinite(to_floats(frame[value]))]
    items: list[Item] = []
    for k, strategy in enumerate(data.list_labels("strategy"), start=1):
        own = known[known["strategy"] == strategy]
        if own.empty:
            continue
        trials, spread = own["trial"].tolist(), to_floats(own[sd])
        half = NORMAL_95 * factor * np.where(np.isfinite(spread), spread, 0.0)
        label, names = style.clean(strategy, 20), tuple(style.clean(trial, 30) for trial in trials)
        place, colour = place_trials(data, trials), style.pick_colour(k)
        items.append(Points(factor * to_floats(own[value]), place, colour, label, size=3.5, half=half, names=names))
    return items


def to_floats(column: pd.Series) -> FloatArray:
    """Return a column of numbers as an array; NaN where unknown."""
    return np.asarray(column.to_numpy(dtype=np.float64))
