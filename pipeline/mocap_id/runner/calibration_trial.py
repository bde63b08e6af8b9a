"""Update of the trial that is the calibration of another trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mocap_id.config import Trial, load
from mocap_id.errors import RecordingError
from mocap_id.stages import Stage

if TYPE_CHECKING:
    from mocap_id.runner.execution import Outcome

_LONGEST = 600.0  # s; waiting time if another run updates the calibration


def update_calibration(trial: Trial, stages: Sequence[Stage], run_to: Callable[..., Outcome]) -> None:
    """Run the stages of a trial's calibration that the trial needs, unless they are up to date.

    If several trials do this at the same time, one runs the stages and the others wait.

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
    last = "fit-joints" if trial.keys.calibration.states is None else "ukf-smooth"
    refused = run_to(other, last, stages, wait=_LONGEST).refused
    if refused is not None:
        raise RecordingError(
            f"{other.file}: the calibration of {trial.file} was refused ({refused}); choose a trial in which every "
            "joint moves"
        )
