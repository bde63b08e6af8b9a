"""The result of one trial of a reach study, and the page of the study."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import NORMAL_95
from mocap_id.config.study import Study, StudyTrial
from mocap_id.reporting.numbers import to_numbers
from mocap_id.reporting.reach_study.figures import Shape
from mocap_id.reporting.study.page_data import CohortData
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.statistics import Estimate
from mocap_id.workflows.study.study_outcome import Measure, StudyOutcome, read_event_facts
from mocap_id.workflows.trial_outcome import number_or_nan, read_summary

SIDES = ("right", "left")


@dataclass(frozen=True, kw_only=True)
class ReachResult(StudyOutcome):
    """The result of one trial of a reach study."""

    score: float | None  # clinical score of the person; None if not given
    reach: Mapping[str, Any]  # facts of events.parquet about the reach; empty if the trial failed or was refused

    @property
    def session(self) -> str:
        """Session of the recording; empty if not given."""
        return self.trial.session

    @property
    def side(self) -> str:
        """Side of the arm; for a trial that failed, the side in its configuration, or right if not given."""
        mirrored = self.value("mirrored")
        return self.trial.trial.keys.side or "right" if mirrored is None else SIDES[bool(mirrored)]

    @property
    def why(self) -> str:
        """Reason why the volume is unknown; empty if the volume is known or the trial failed."""
        return "" if math.isfinite(MEASURES["volume"].of(self).value) else self.value("workspace", "why") or ""


ReachMeasure: TypeAlias = Measure[ReachResult, Estimate]


def _read_number(trial: ReachResult, *keys: str) -> float:
    return number_or_nan(trial.value("workspace", *keys))


def _volume(*keys: str) -> Callable[[ReachResult], Estimate]:
    """Return a function of a trial that returns the volume at ``keys`` of the workspace, with its interval."""

    def estimate(trial: ReachResult) -> Estimate:
        interval = to_numbers(trial.value("workspace", *keys, "interval_m3")) or [math.nan] * 2
        return Estimate(_read_number(trial, *keys, "volume_m3"), *interval)

    return estimate


def _read_elevation(trial: ReachResult) -> Estimate:
    value, sd = (_read_number(trial, "ranges", "shoulder_elevation", key) for key in ("high_deg", "high_sd_deg"))
    return Estimate(value, value - NORMAL_95 * sd, value + NORMAL_95 * sd)


MEASURES: Mapping[str, ReachMeasure] = {
    "volume": Measure("m^3", "reachable volume, joints independent of each other", _volume()),
    "visited": Measure("m^3", "reachable volume of the recorded combinations of angles", _volume("visited")),
    "surface": Measure(
        "1",
        "reached fraction of the hemisphere in front of the shoulder",
        lambda trial: Estimate(_read_number(trial, "surface", "box", "total")),
    ),
    "elevation": Measure("deg", "highest elevation of the upper arm", _read_elevation),
    "height": Measure(
        "m", "highest wrist above the shoulder", lambda trial: Estimate(_read_number(trial, "heights", "highest_m"))
    ),
}
"""Measures that are compared between people, sides and sessions; the thesis uses `volume`."""


def read_reach_result(study: Study, trial: StudyTrial, run: TrialRun) -> ReachResult:
    """Read the result of a trial from its run folder."""
    facts, summary = read_event_facts(trial, run, "reach"), read_summary(trial.trial.out, run)
    return ReachResult(trial=trial, run=run, score=study.subjects[trial.subject].score, summary=summary, reach=facts)


def make_page(data: CohortData, trials: Sequence[ReachResult]) -> bytes:
    """Return the page of the study as UTF-8; the page draws the last trial of each person, side and session."""
    from mocap_id.reporting.reach_study.page import render_reach_page  # noqa: PLC0415  it loads the page's templates

    with_surface = [trial for trial in trials if trial.reach.get("mesh")]
    drawn = {(trial.subject, trial.side, trial.session): trial for trial in with_surface}
    return render_reach_page(data, tuple(map(make_shape, drawn.values())))


def make_shape(trial: ReachResult) -> Shape:
    """Return the surface of a trial's reachable volume; the surface of a left arm is mirrored back to the left."""
    from mocap_id.reporting.figures.reach import make_wires  # noqa: PLC0415  as above

    mesh, mirror = trial.reach["mesh"], [1, 1, -1 if trial.side == "left" else 1]
    shoulder = np.array(trial.reach["shoulder_m"])
    surface = shoulder + make_wires(mesh["theta_deg"], mesh["psi_deg"], mesh["box_m"])
    arm = shoulder + np.array(trial.reach["view"]["arm_m"])
    return Shape(trial.subject, trial.side, trial.session, surface * mirror, arm * mirror)
