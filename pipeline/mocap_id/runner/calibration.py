"""The trial whose chain another trial uses: its chain is brought up to date first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mocap_id.config import Trial, load
from mocap_id.errors import RecordingError
from mocap_id.stages import Stage

if TYPE_CHECKING:
    from mocap_id.runner.execution import Outcome


def update_calibration(
    trial: Trial, stages: Sequence[Stage], run_to: Callable[[Trial, str, Sequence[Stage]], Outcome]
) -> None:
    """Run the stages of a trial's calibration up to `fit-joints`, unless they are up to date.

    Raises
    ------
    RecordingError
        The calibration was refused, so it has no chain.
    ConfigError, NumericalError, StoreError
        As for :func:`mocap_id.runner.run_to`.
    """
    if trial.keys.calibration is None:
        return
    other = load(trial.keys.calibration.trial, stages)
    refused = run_to(other, "fit-joints", stages).refused
    if refused is not None:
        raise RecordingError(
            f"{other.file}: the calibration of {trial.file} was refused ({refused}); choose a trial in which every "
            "joint moves"
        )
