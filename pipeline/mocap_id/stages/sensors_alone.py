"""Trials of inertial sensors without markers: how stages know them, and the trial that has shown chain and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mocap_id import store
from mocap_id.errors import RecordingError
from mocap_id.stages.trial_keys import Calibration, TrialKeys

if TYPE_CHECKING:
    from mocap_id.store import Table

FORMAT = "inertial sensors"
"""Format of the recording in the facts of planar.parquet."""


def without_markers(facts: Mapping[str, Any]) -> bool:
    """Return whether the facts of planar.parquet are those of a trial of inertial sensors alone."""
    return facts.get("format") == FORMAT


def shown_by(trial: TrialKeys) -> Calibration:
    """Return the trial that has shown the chain of a trial without markers."""
    assert trial.calibration is not None
    return trial.calibration


def read_states(calibration: Calibration) -> Table:
    """Return states.parquet of the trial that has shown the chain.

    Raises
    ------
    RecordingError
        The file is missing or damaged.
    """
    from mocap_id.store import parquet  # noqa: PLC0415  slow import; the record of a stage needs it not
    from mocap_id.store.schemas import STATES  # noqa: PLC0415

    path = calibration.states
    assert path is not None
    again = f"run `mocap-id run {calibration.trial}` again"
    try:
        table, _ = parquet.decode(path.read_bytes(), STATES)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}): {again}") from error
    except ValueError as error:
        raise RecordingError(f"{path} {error}: {again}") from error
    assert isinstance(table, store.Table)
    return table
