"""What a cohort's page is made from: how each trial went, and the study's tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

from mocap_id.reporting.shape import ReasonEntry

if TYPE_CHECKING:
    import pandas as pd

PAGE_FILE = "cohort.html"
COHORT = "cohort"
"""The subject of the rows that are about all people; so nobody may have this id."""

Fate: TypeAlias = Literal["ok", "caution", "refused", "failed"]


@dataclass(frozen=True)
class TrialEntry:
    """How one trial went.

    Parameters
    ----------
    name, subject, strategy : str
    fate : {"ok", "caution", "refused", "failed"}
        The verdict's level, or that there is no verdict.
    reasons : sequence of ReasonEntry
        Of the verdict; without notes.
    message : str or None
        Why it failed.
    report : str or None
        Where its own page is, from the cohort's.
    """

    name: str
    subject: str
    strategy: str
    fate: Fate
    reasons: Sequence[ReasonEntry]
    message: str | None
    report: str | None


@dataclass(frozen=True)
class CohortMaterial:
    """A study as its page sees it.

    Parameters
    ----------
    study, product : str
        Name of the study; version of the product.
    trials : tuple of TrialEntry
    tables : mapping of str to DataFrame
        trials, lengths, strategies, models, parameters, variation.
    """

    study: str
    product: str
    trials: tuple[TrialEntry, ...]
    tables: Mapping[str, pd.DataFrame]

    @property
    def subjects(self) -> tuple[str, ...]:
        """Ids of the people, in the order of the trials."""
        return tuple(dict.fromkeys(trial.subject for trial in self.trials))

    @property
    def strategies(self) -> tuple[str, ...]:
        """In the order of the trials."""
        return tuple(dict.fromkeys(trial.strategy for trial in self.trials))

    def of_cohort(self, table: str) -> pd.DataFrame:
        """The rows about all people."""
        frame = self.tables[table]
        return frame[frame["subject"] == COHORT]

    def of_people(self, table: str) -> pd.DataFrame:
        """The rows about single people."""
        frame = self.tables[table]
        return frame[frame["subject"] != COHORT]
