"""Results of reaches with chosen numbers, without running anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.arms import ArmTrial


@dataclass
class Reach:
    """One trial: what a test says of it, and the result that comes of it."""

    subject: str = "p1"
    side: str = "right"
    session: str = "a"
    score: float | None = 1.0
    volume: float | None = 0.3
    error: float = 0.02
    failed: str | None = None

    @property
    def name(self) -> str:
        return f"{self.subject}-{self.side}-{self.session}"

    def result(self) -> ArmTrial:
        well = self.failed is None
        run = TrialRun(self.name, 0 if well else 3, self.failed, self.failed, "key" if well else None, False, 0.1)
        keys = SimpleNamespace(side=self.side)
        trial: Any = SimpleNamespace(
            name=self.name, subject=self.subject, session=self.session, trial=SimpleNamespace(keys=keys)
        )
        summary = {
            "verdict": {"level": "ok", "reasons": []},
            "mirrored": self.side == "left",
            "workspace": self.entry(),
        }
        reach = (
            {"mesh": mesh_of(self.volume), "shoulder_m": [0, 0, 0.17], "view": {"arm_m": np.eye(3).tolist()}}
            if well and self.volume
            else {}
        )
        return ArmTrial(trial=trial, run=run, score=self.score, summary=summary if well else None, facts=reach)

    def entry(self) -> dict[str, Any]:
        if self.volume is None:
            return {"volume_m3": None, "interval_m3": None, "why": "no forearm"}
        v, e = self.volume, self.error
        return {
            "volume_m3": v,
            "interval_m3": [v - e, v + e],
            "why": None,
            "visited": {"volume_m3": 0.8 * v, "interval_m3": [0.8 * v - e, 0.8 * v + e]},
            "ranges": {"shoulder_elevation": {"high_deg": 400 * v, "high_sd_deg": 2.0}},
            "surface": {"box": {"total": 2 * v}},
            "heights": {"highest_m": v, "levels": {"waist": True, "mouth": v > 0.1, "overhead": None}},
        }


def mesh_of(volume: float) -> dict[str, Any]:
    """A half ball to the side and the front, in the form of ``events.parquet``."""
    theta, psi = np.linspace(5.0, 175.0, 18), np.linspace(0.0, 350.0, 36)
    radius = (3 * volume / (2 * np.pi)) ** (1 / 3)
    row = [round(radius, 3) if angle <= 180 else None for angle in psi]
    return {"theta_deg": theta.tolist(), "psi_deg": psi.tolist(), "box_m": [row] * 18, "visited_m": [row] * 18}


def results(reaches: Sequence[Reach]) -> list[ArmTrial]:
    return [one.result() for one in reaches]


THESIS = (  # table 7.1
    *(Reach(f"healthy{k}", score=None, volume=volume) for k, volume in enumerate((0.374, 0.328, 0.234), start=1)),
    Reach("patient4", score=5.0, volume=0.00148, error=0.001),
    Reach("patient1", score=1.0, volume=0.358),
    Reach("patient2", score=2.0, volume=0.270),
    Reach("patient3", score=3.0, volume=0.178),
)
