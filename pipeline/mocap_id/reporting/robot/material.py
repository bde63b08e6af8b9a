"""What a robot study's page is made from: how each trial went, its tables, and series for the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting.cohort.material import TrialEntry


@dataclass(frozen=True)
class Traces:
    """States of a trial in the robot's sense: (T, 3) by each method, and the truth where it is known."""

    trial: str
    time: FloatArray
    curves: Mapping[str, FloatArray]
    truth: FloatArray | None


@dataclass(frozen=True)
class Recovery:
    """From markers to states in one trial.

    Parameters
    ----------
    trial, joint, speed : str
    paths : mapping of str to (F, 2) array
        Way of each marker in the plane, m.
    segment : mapping of str to int
        0 = base.
    local : mapping of str to (2,) array
        Coordinates in the segment's frame, m.
    centre : (2,) array
        Of the joint, plane frame, m.
    traces : Traces
    """

    trial: str
    joint: str
    speed: str
    paths: Mapping[str, FloatArray]
    segment: Mapping[str, int]
    local: Mapping[str, FloatArray]
    centre: FloatArray
    traces: Traces


@dataclass(frozen=True)
class Averaged:
    """Wrench over repetitions of one cell's trials, in the robot's sense.

    Parameters
    ----------
    cell : str
    repetitions : int
    phase : (P,) array
        % of a repetition.
    measured : (R, P, 3) array
        Fx, Fy, tauz, N and N·m.
    models, errors : mapping of str to (R, P, 3) array
        By the thesis's names; errors are model less measured.
    """

    cell: str
    repetitions: int
    phase: FloatArray
    measured: FloatArray
    models: Mapping[str, FloatArray]
    errors: Mapping[str, FloatArray]


@dataclass(frozen=True)
class Shown:
    """A table of the study: its title, frame, and the quantities in its order, each with its unit."""

    name: str
    title: str
    frame: pd.DataFrame
    quantities: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class RobotMaterial:
    """A robot study as its page sees it."""

    study: str
    product: str
    trials: tuple[TrialEntry, ...]
    overview: pd.DataFrame
    tables: tuple[Shown, ...]
    recoveries: tuple[Recovery, ...]
    averaged: Averaged | None
    traces: Traces | None
