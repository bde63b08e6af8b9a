"""What a sensitivity study's page is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from mocap_id.verdict import Level


@dataclass(frozen=True)
class ParameterEntry:
    """A parameter of the unperturbed trial, in its unit; NaN where not known."""

    name: str
    unit: str
    value: float
    sd: float
    size: float

    def allowed(self, share: float) -> float:
        """Change that is tolerated, as a share of the size."""
        return max(share, self.sd / self.size if self.sd > 0 and self.size > 0 else 0.0)


@dataclass(frozen=True)
class SensitivityMaterial:
    """A sensitivity study as its page sees it.

    Parameters
    ----------
    trial, product : str
        Name of the trial; version of the product.
    verdict : {"ok", "caution", "refused"}
        Of the unperturbed trial.
    note : str
        What could not be studied; empty where all could.
    share : float
        Change of a parameter that is tolerated, of its size.
    seed : int
        Of everything that was drawn.
    parameters : tuple of ParameterEntry
        Those that count.
    titles : mapping of str to str
        Kinds as people read them.
    tables : mapping of str to DataFrame
        responses, perturbations, tolerates.
    """

    trial: str
    product: str
    verdict: Level
    note: str
    share: float
    seed: int
    parameters: tuple[ParameterEntry, ...]
    titles: Mapping[str, str]
    tables: Mapping[str, pd.DataFrame]
