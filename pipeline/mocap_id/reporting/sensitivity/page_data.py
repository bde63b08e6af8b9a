"""The data for the page of a sensitivity study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mocap_id.verdict import Level

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class ParameterEntry:
    """A parameter of the unperturbed trial: value, standard deviation and size in its unit; NaN where unknown."""

    name: str
    unit: str
    value: float
    sd: float
    size: float

    def tolerated(self, share: float) -> float:
        """Return the tolerated change as a fraction of the size: ``share``, or sd / size if this is larger."""
        return max(share, self.sd / self.size if self.sd > 0 and self.size > 0 else 0.0)


@dataclass(frozen=True)
class SensitivityData:
    """The data for the page of a sensitivity study."""

    trial: str  # name of the trial
    verdict: Level  # verdict of the unperturbed trial
    note: str  # perturbations that could not be studied; empty if there are none
    tolerance: float  # tolerated change of a parameter as a fraction of its size
    seed: int  # seed of the random numbers
    parameters: tuple[ParameterEntry, ...]  # parameters whose changes are compared
    titles: Mapping[str, str]  # titles of the kinds of perturbation, by kind
    tables: Mapping[str, pd.DataFrame]  # the tables `responses`, `perturbations` and `tolerates`
