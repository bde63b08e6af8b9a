"""The averaged wrench of a robot study: which repetitions its band contains."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from mocap_id.workflows.study.robots import CAMERAS, average_wrench
from mocap_id_simulation.sit_to_stand import smoothstep

PERIODS = 8


def swing(envelope: bool) -> Any:
    """Return a trial of eight swings of 1 s, whose vertical force is 100 times the angle."""
    time = np.arange(0.0, PERIODS + 1e-9, 0.01)
    size = smoothstep(2 * time) * smoothstep(2 * (PERIODS - time)) if envelope else np.ones_like(time)
    angle = 0.5 * size * np.sin(2 * np.pi * time)
    speed = np.gradient(angle, time)
    starts = np.arange(PERIODS, dtype=float)
    events = pd.DataFrame({"start": starts, "end": starts + 1.0, "complete": True})
    wrench = {name: 100 * angle for part in ("", "_model") for name in (f"Fx{part}", f"Fy{part}", f"tauz{part}")}
    result = SimpleNamespace(
        folder=SimpleNamespace(table=lambda _: events),
        time=time,
        sign=1.0,
        identified=SimpleNamespace(q=angle[:, None], dq=speed[:, None], dynamics=pd.DataFrame(wrench)),
    )
    return SimpleNamespace(by_method={CAMERAS: result}, method_of_reference=None, cell=("elbow", "fast"))


@pytest.mark.parametrize(("envelope", "count"), [(True, PERIODS - 2), (False, PERIODS)])
def test_run_in_and_run_out_are_not_in_the_band(envelope: bool, count: int) -> None:
    averaged = average_wrench([swing(envelope)])
    assert averaged is not None
    assert averaged.repetitions == count
    assert averaged.measured.std(axis=0).max() < 0.1  # N; 17 with the run-in
