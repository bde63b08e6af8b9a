"""The data of a robot study's page: how each trial ended, the tables, and series for the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mocap_id.arrays import FloatArray

if TYPE_CHECKING:
    import pandas as pd

    from mocap_id.reporting.results.trial_entries import TrialEntry
    from mocap_id.reporting.robot.tables import Quantity


@dataclass(frozen=True)
class StateTraces:
    """Joint states of a trial in the robot's frame, (T, 3): by each method, and the truth if known."""

    trial: str
    time: FloatArray
    curves: Mapping[str, FloatArray]
    truth: FloatArray | None


@dataclass(frozen=True)
class Recovery:
    """How skeleton and states of one trial were found.

    Parameters
    ----------
    trial, joint, speed : str
    paths : mapping of str to (F, 2) array
        Path of each marker in the plane, m.
    segment : mapping of str to int
        Segment of each marker, 0 = base.
    local : mapping of str to (2,) array
        Coordinates of each marker in its segment's frame, m.
    centre : (2,) array
        Centre of the joint, plane frame, m.
    traces : StateTraces
    """

    trial: str
    joint: str
    speed: str
    paths: Mapping[str, FloatArray]
    segment: Mapping[str, int]
    local: Mapping[str, FloatArray]
    centre: FloatArray
    traces: StateTraces


@dataclass(frozen=True)
class AveragedWrench:
    """Wrench over the repetitions of one cell's trials, in the robot's frame.

    Parameters
    ----------
    cell : str
    repetitions : int
    phase : (P,) array
        % of a repetition.
    measured : (R, P, 3) array
        Fx, Fy, tauz, N and N·m.
    models, errors : mapping of str to (R, P, 3) array
        By the thesis's labels; errors are model less measured.
    """

    cell: str
    repetitions: int
    phase: FloatArray
    measured: FloatArray
    models: Mapping[str, FloatArray]
    errors: Mapping[str, FloatArray]


@dataclass(frozen=True)
class RobotStudyData:
    """The data of a robot study's page.

    Parameters
    ----------
    study : str
    trials : tuple of TrialEntry
    overview : DataFrame
        The table `trials`.
    tables : tuple of (str, DataFrame, sequence of Quantity)
        Title, rows and quantities of each of the thesis's tables.
    recoveries : tuple of Recovery
    averaged : AveragedWrench or None
    traces : StateTraces or None
    """

    study: str
    trials: tuple[TrialEntry, ...]
    overview: pd.DataFrame
    tables: tuple[tuple[str, pd.DataFrame, Sequence[Quantity]], ...]
    recoveries: tuple[Recovery, ...]
    averaged: AveragedWrench | None
    traces: StateTraces | None
