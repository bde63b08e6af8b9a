"""The data of a robot study's page: how each trial ended, the tables, and series for the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mocap_id.arrays import FloatArray

if TYPE_CHECKING:
    import pandas as pd

    from mocap_id.reporting.results.study_page import TrialEntry
    from mocap_id.reporting.robot_study.tables import Quantity


@dataclass(frozen=True)
class StateTraces:
    """Joint states of a trial in the robot's frame, (T, 3): by each method, and the truth if known."""

    trial: str
    time: FloatArray
    curves: Mapping[str, FloatArray]
    truth: FloatArray | None


@dataclass(frozen=True)
class Recovery:
    """How skeleton and states of one trial were found."""

    trial: str
    joint: str
    speed: str
    paths: Mapping[str, FloatArray]  # (F, 2) path of each marker in the plane, m
    segment: Mapping[str, int]  # segment of each marker, 0 = base
    local: Mapping[str, FloatArray]  # (2,) coordinates of each marker in its segment's frame, m
    centre: FloatArray  # (2,) centre of the joint, plane frame, m
    traces: StateTraces


@dataclass(frozen=True)
class AveragedWrench:
    """Wrench over the repetitions of one cell's trials, in the robot's frame."""

    cell: str
    repetitions: int
    phase: FloatArray  # (P,) % of a repetition
    measured: FloatArray  # (R, P, 3) Fx, Fy, tauz, N and N·m
    models: Mapping[str, FloatArray]  # (R, P, 3) by the thesis's labels
    errors: Mapping[str, FloatArray]  # (R, P, 3) model minus measurement


@dataclass(frozen=True)
class RobotStudyData:
    """The data of a robot study's page."""

    study: str
    trials: tuple[TrialEntry, ...]
    overview: pd.DataFrame  # the table `trials`
    # title, rows and quantities of each of the thesis's tables
    tables: tuple[tuple[str, pd.DataFrame, Sequence[Quantity]], ...]
    recoveries: tuple[Recovery, ...]
    averaged: AveragedWrench | None
    traces: StateTraces | None
