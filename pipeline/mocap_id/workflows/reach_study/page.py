"""The page of a reach study from its results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.reporting.reach_study.page_data import Shape
from mocap_id.reporting.study.page_data import CohortData
from mocap_id.workflows.reach_study.trial_results import ReachResult


def page(data: CohortData, trials: Sequence[ReachResult]) -> bytes:
    """Return the page as UTF-8."""
    from mocap_id.reporting.reach_study.page import reach_cohort_page  # noqa: PLC0415  it loads the page's templates

    known = [trial for trial in trials if trial.reach.get("mesh")]
    drawn = {(trial.subject, trial.side, trial.session): trial for trial in known}  # the last of each
    return reach_cohort_page(data, tuple(map(shape, drawn.values())))


def shape(trial: ReachResult) -> Shape:
    """Return the surface of a trial's reachable volume."""
    from mocap_id.reporting.space.figures.reach import wires  # noqa: PLC0415  as above

    mesh, mirrored = trial.reach["mesh"], [1, 1, -1 if trial.side == "left" else 1]
    shoulder = np.array(trial.reach["shoulder_m"])
    surface = shoulder + wires(mesh["theta_deg"], mesh["psi_deg"], mesh["box_m"])
    arm = shoulder + np.array(trial.reach["view"]["arm_m"])
    return Shape(trial.subject, trial.side, trial.session, surface * mirrored, arm * mirrored)
