"""The data for the page of a robot study: how each trial ended, the tables, and series for the figures."""

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
    """States of a trial in the robot's frame: angle, velocity and acceleration, rad, rad/s and rad/s²."""

    trial: str
    time: FloatArray  # (T,) s
    curves: Mapping[str, FloatArray]  # (T, 3) states by method
    truth: FloatArray | None  # (T, 3) true states; None if unknown


@dataclass(frozen=True)
class Recovery:
    """Markers, joint centre and states of one trial."""

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
    """Wrench over the R repetitions of the trials of one cell, in the robot's frame, N and N·m."""

    cell: str  # joint, orientation and speed, a row of the thesis's tables
    repetitions: int
    phase: FloatArray  # (P,) % of a repetition
    measured: FloatArray  # (R, P, 3) Fx, Fy, tauz
    models: Mapping[str, FloatArray]  # (R, P, 3) modelled wrench, by the labels of the thesis
    errors: Mapping[str, FloatArray]  # (R, P, 3) model minus measurement


@dataclass(frozen=True)
class RobotStudyData:
    """The data for the page of a robot study."""

    study: str
    trials: tuple[TrialEntry, ...]
    overview: pd.DataFrame  # the table `trials`
    # title, rows and quantities of each of the thesis's tables
    tables: tuple[tuple[str, pd.DataFrame, Sequence[Quantity]], ...]
    recoveries: tuple[Recovery, ...]
    averaged: AveragedWrench | None  # None without a complete repetition
    traces: StateTraces | None  # None if no trial has results
