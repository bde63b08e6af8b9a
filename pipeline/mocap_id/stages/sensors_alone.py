"""Trials of inertial sensors without markers: how stages recognise them, and the trial that calibrates them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mocap_id.stages.trial_keys import Calibration, TrialKeys

FORMAT = "inertial sensors"
"""Format of the recording in the facts of planar.parquet."""


def without_markers(facts: Mapping[str, Any]) -> bool:
    """Return whether the facts of planar.parquet are those of a trial of inertial sensors alone."""
    return facts.get("format") == FORMAT


def shown_by(trial: TrialKeys) -> Calibration:
    """Return the calibration trial, which has the chain of a trial without markers."""
    assert trial.calibration is not None
    return trial.calibration
