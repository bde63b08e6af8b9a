"""Results of curls with chosen numbers, without running anything."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.arms import ANGLES, ArmTrial


def curls(subject: str, condition: str, number: int, count: int | None, sway: float = 1.0) -> ArmTrial:
    """One trial; it failed if ``count`` is None."""
    name, well = f"{subject}-{condition}-{number}", count is not None
    run = TrialRun(name, 0 if well else 3, None if well else "no markers", None, "key" if well else None, False, 0.1)
    trial: Any = SimpleNamespace(name=name, subject=subject, condition=condition, number=number)
    ranges = [{"range_rad": np.radians(sway), "floor_rad": np.radians(0.5)}, None]
    facts = {
        "count": count,
        "partial": 1,
        "after_end": 0,
        "end": {"time_s": 20.0, "rule": "stopped"},
        "tempo_s": [2.0, None],
        "torque": [{"peak_Nm": 15.0, "person_peak_Nm": None}, None],
        "compensation": dict.fromkeys(ANGLES, ranges),
    }
    summary = {"verdict": {"level": "ok", "reasons": []}}
    return ArmTrial(
        trial=trial, run=run, reference="AC", summary=summary if well else None, facts=facts if well else {}
    )


def cohort(counts: dict[str, Sequence[Sequence[int | None]]]) -> list[ArmTrial]:
    """Return the trials of several conditions: for each person the counts of the trials."""
    return [
        curls(f"p{person}", condition, number, count, sway=1.0 + (condition == "2"))
        for condition, people in counts.items()
        for person, trials in enumerate(people, start=1)
        for number, count in enumerate(trials, start=1)
    ]
