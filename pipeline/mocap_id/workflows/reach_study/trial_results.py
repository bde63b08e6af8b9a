"""The result of one trial of a reach study."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mocap_id.arrays import NORMAL_95
from mocap_id.config.study import Study, StudyTrial
from mocap_id.reporting.numbers import all_known, known
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.estimates import Estimate
from mocap_id.workflows.study.study_outcome import StudyOutcome, event_facts
from mocap_id.workflows.trial_outcome import read_summary

SIDES = ("right", "left")


@dataclass(frozen=True, kw_only=True)
class ReachResult(StudyOutcome):
    """The result of one trial of a reach study."""

    score: float | None  # clinical score of the person
    reach: Mapping[str, Any]  # facts of events.parquet; empty without any

    @property
    def session(self) -> str:
        """Session of the recording; empty if not given."""
        return self.trial.session

    @property
    def side(self) -> str:
        """Side of the arm; that of the configuration, or right, for a trial that failed."""
        mirrored = self.value("mirrored")
        return self.trial.trial.keys.side or "right" if mirrored is None else SIDES[bool(mirrored)]

    @property
    def why(self) -> str:
        """Why the volume is unknown; empty if it is known or the trial failed."""
        return "" if math.isfinite(MEASURES["volume"].of(self).value) else self.value("workspace", "why") or ""


@dataclass(frozen=True)
class Measure:
    """A measure of reach."""

    unit: str
    meaning: str
    of: Callable[[ReachResult], Estimate]


def _number(trial: ReachResult, *keys: str) -> float:
    found = known(trial.value("workspace", *keys))
    return math.nan if found is None else found


def _volume(*above: str) -> Callable[[ReachResult], Estimate]:
    def estimate(trial: ReachResult) -> Estimate:
        interval = all_known(trial.value("workspace", *above, "interval_m3")) or [math.nan] * 2
        return Estimate(_number(trial, *above, "volume_m3"), *interval)

    return estimate


def _elevation(trial: ReachResult) -> Estimate:
    value, sd = (_number(trial, "ranges", "shoulder_elevation", key) for key in ("high_deg", "high_sd_deg"))
    return Estimate(value, value - NORMAL_95 * sd, value + NORMAL_95 * sd)


MEASURES: Mapping[str, Measure] = {
    "volume": Measure("m^3", "reachable volume, joints independent of each other", _volume()),
    "visited": Measure("m^3", "reachable volume of the recorded combinations of angles", _volume("visited")),
    "surface": Measure(
        "1",
        "reached share of the hemisphere in front of the shoulder",
        lambda trial: Estimate(_number(trial, "surface", "box", "total")),
    ),
    "elevation": Measure("deg", "highest elevation of the upper arm", _elevation),
    "height": Measure(
        "m",
        "highest wrist above the shoulder",
        lambda trial: Estimate(_number(trial, "heights", "highest_m")),
    ),
}
"""What is compared between people, sides and sessions; the first is that of the thesis."""


def read_reach_result(study: Study, trial: StudyTrial, run: TrialRun) -> ReachResult:
    """Read the result of a trial from its run folder."""
    facts, summary = event_facts(trial, run, "reach"), read_summary(trial.trial.out, run)
    return ReachResult(trial=trial, run=run, score=study.subjects[trial.subject].score, summary=summary, reach=facts)
