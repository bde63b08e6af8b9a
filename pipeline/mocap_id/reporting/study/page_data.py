"""The data of a cohort's page: how each trial ended, and the study's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

    from mocap_id.reporting.results.trial_entries import TrialEntry

PAGE_FILE = "cohort.html"
COHORT = "cohort"
"""Subject of the rows about all people; no person may have this id."""


@dataclass(frozen=True)
class CohortData:
    """The data of a cohort's page."""

    study: str  # name of the study
    trials: tuple[TrialEntry, ...]
    tables: Mapping[str, pd.DataFrame]  # trials, lengths, strategies, models, parameters, variation

    @property
    def subjects(self) -> tuple[str, ...]:
        """Ids of the people, in the order of the trials."""
        return tuple(dict.fromkeys(self.tables["trials"]["subject"]))

    @property
    def strategies(self) -> tuple[str, ...]:
        """The strategies, in the order of the trials."""
        return tuple(dict.fromkeys(self.tables["trials"]["strategy"]))

    def of_cohort(self, table: str) -> pd.DataFrame:
        """Return the rows about all people."""
        frame = self.tables[table]
        return frame[frame["subject"] == COHORT]

    def of_people(self, table: str) -> pd.DataFrame:
        """Return the rows about single people."""
        frame = self.tables[table]
        return frame[frame["subject"] != COHORT]
