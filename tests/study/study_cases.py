"""Cases of a study with chosen numbers, without running anything."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mocap_id.config.study import Landmarks, Person
from mocap_id.dynamics.prediction import Agreement
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.sit_to_stand import TrialResult, find_length_reference
from mocap_id.workflows.transfer import BodyErrors

SYMBOLS = ("m1", "mx1", "mx2", "my2", "I2")
UNITS = ("kg", "kg*m", "kg*m", "kg*m", "kg*m^2")


@dataclass
class Made:
    """One trial: what a test says of it, and the case that comes of it."""

    trial: str = "t1"
    subject: str = "s01"
    strategy: str = "normal"
    person: Person = field(default_factory=Person)
    shank: float | None = 0.40
    thigh: float | None = 0.42
    reprojection_mm: float = 2.0
    condition: float = 60.0
    value: tuple[float, ...] | None = (70.0, 1.0, 3.0, 4.0, 9.0)
    reference: tuple[float, ...] = (70.0, 2.0, 0.0, 5.0, 10.0)
    bodies: tuple[BodyErrors, ...] = ()
    failed: str | None = None
    five_times: dict[str, Any] | None = None

    def case(self) -> TrialResult:
        well = self.failed is None
        run = TrialRun(self.trial, 0 if well else 3, self.failed, self.failed, "key" if well else None, False, 0.1)
        trial: Any = SimpleNamespace(name=self.trial, subject=self.subject, strategy=self.strategy)
        identified: Any = SimpleNamespace(
            name=self.trial,
            source=Path("runs") / self.trial,
            dynamics={"in_fit": np.array([True, True, False])},
            facts={},
            parameters=np.ones(8),
        )
        reference, lengths, by_stature = find_length_reference(self.person, "winter")
        return TrialResult(
            trial=trial,
            run=run,
            reference=reference,
            reference_lengths=lengths,
            lengths_by_stature=by_stature,
            summary=self._summary() if well else None,
            identified=identified if well else None,
            bodies=self.bodies,
            parameters=self._parameters() if well else (),
            segments=2,
        )

    def _summary(self) -> dict[str, Any]:
        lengths = {"shank": self.shank, "thigh": self.thigh}
        return {
            "verdict": {"level": "caution", "reasons": [reason("joint-uncertain"), reason("parameters-weak")]},
            "segments": {"count": 4, "confidence": 0.9},
            "lengths_m": {name: {"value": value, "sd": 0.001} for name, value in lengths.items() if value is not None},
            "markers": {"reprojection_rms_mm": self.reprojection_mm, "missing_fraction": 0.01},
            "dynamics": {"condition_number": self.condition, "mass_kg": 70.0, "samples": 2, "clock_offset_s": None},
            "repetitions": [{"complete": True}, {"complete": False}],
            **({} if self.five_times is None else {"five_times": self.five_times}),
        }

    def _parameters(self) -> tuple[dict[str, Any], ...]:
        if self.value is None:
            return ()
        expressions = ("m1+m2", "mx1+p2x*m2", "mx2", "my2", "I2")
        verdicts = ("known",) * 4 + ("weak",)
        columns = (SYMBOLS, expressions, UNITS, self.value, (0.1,) * 5, verdicts, self.reference)
        names = ("parameter", "expression", "unit", "value", "sd", "verdict", "reference")
        return tuple(dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))


def reason(code: str) -> dict[str, Any]:
    """A reason of a summary's verdict."""
    return {"code": code, "message": f"about `{code}` <b>", "value": 1.0, "limit": 0.5, "level": "caution"}


def landmarks(shank: float | None, thigh: float | None, height: float | None = None) -> Person:
    """A person who was measured."""
    return Person(height=height, landmarks_m=Landmarks(shank=shank, thigh=thigh))


def body(name: str, bias: float, sd: float, torques: tuple[tuple[float, float], ...] = ()) -> BodyErrors:
    """A body whose every error is the same."""
    errors = {series: Agreement(bias, sd, 0.9) for series in ("Fx", "Fy", "tauz", "cop_x")}
    return BodyErrors(name, errors, tuple(Agreement(b, s, 0.9) for b, s in torques))
