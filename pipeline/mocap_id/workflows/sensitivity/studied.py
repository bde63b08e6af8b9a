"""A trial that was perturbed, and what came of it: what tables, figure and page are made from."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mocap_id.workflows.sensitivity.asking import Asked
from mocap_id.workflows.sensitivity.responses import Result
from mocap_id.workflows.sensitivity.tolerance import Tolerance, tolerances
from mocap_id.workflows.sensitivity.trying import Tried


@dataclass(frozen=True)
class Studied:
    """A sensitivity study.

    Parameters
    ----------
    trial : str
        Its name.
    asked : Asked
    own : Result
        Of the unperturbed trial.
    tried : tuple of Tried
    note : str
        What could not be studied on this trial; empty where all could.
    """

    trial: str
    asked: Asked
    own: Result
    tried: tuple[Tried, ...]
    note: str

    @property
    def counted(self) -> tuple[str, ...]:
        """The parameters that tolerance goes by: the base parameters, or lengths where nothing was identified."""
        known = [one for one in self.own.parameters.values() if math.isfinite(one.value)]
        return tuple(one.name for one in known if bool(one.verdict) == bool(self.own.samples))

    @property
    def tolerates(self) -> tuple[Tolerance, ...]:
        """What the trial tolerates of each kind on each target."""
        return tolerances(self.own, self.tried, self.counted, self.asked.tolerance)
