"""How a trial of a study ended, with its place in the study."""

from __future__ import annotations

from dataclasses import dataclass

from mocap_id.config.study import StudyTrial
from mocap_id.workflows.trial_outcome import TrialOutcome


@dataclass(frozen=True, kw_only=True)
class StudyOutcome(TrialOutcome):
    """How a trial of a study ended."""

    trial: StudyTrial

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.name

    @property
    def subject(self) -> str:
        """Id of the person."""
        return self.trial.subject
