"""The data for the page of a study of people: how each trial ended, and the study's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

    from mocap_id.reporting.results.study_page import TrialEntry

PAGE_FILE = "cohort.html"
COHORT = "cohort"
"""Value of ``subject`` in the rows about all people; no person may have this id."""


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
