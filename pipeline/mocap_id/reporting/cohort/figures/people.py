"""What the figures over people share: a row a person, and a place within it for each trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.numbers import NORMAL_95

_SPREAD = 0.6  # of a row's height, for the trials of one person


def places(trials: Sequence[str], of: Mapping[str, Sequence[str]], subjects: Sequence[str]) -> FloatArray:
    """Vertical place of each trial: the person's row, and within it the trials one below the other."""
    row = {trial: k for k, subject in enumerate(subjects) for trial in of[subject]}
    within = {trial: _within(k, len(of[subject])) for subject in subjects for k, trial in enumerate(of[subject])}
    return np.array([row[trial] + within[trial] for trial in trials])


def trials_of(material: CohortMaterial) -> dict[str, list[str]]:
    """Names of each person's trials."""
    return {
        subject: [trial.name for trial in material.trials if trial.subject == subject] for subject in material.subjects
    }


def rows(axes: Axes, subjects: Sequence[str], *, named: bool = True) -> None:
    """Name the rows, the first person on top, with a line between people."""
    names = [style.printable(subject, 16) for subject in subjects] if named else [""] * len(subjects)
    axes.set_yticks(range(len(subjects)), names)
    axes.set_ylim(len(subjects) - 0.5, -0.5)
    axes.grid(False, axis="y")
    for k in range(1, len(subjects)):
        axes.axhline(k - 0.5, color=style.GRID, lw=0.5)


def dots(axes: Axes, material: CohortMaterial, frame: pd.DataFrame, value: str, sd: str, *, factor: float = 1) -> None:
    """A dot with its 95 % interval for each trial of a frame (`trial`, `strategy`), coloured by strategy."""
    known = frame[np.isfinite(frame[value].to_numpy(dtype=np.float64))]
    for k, strategy in enumerate(material.strategies, start=1):
        own = known[known["strategy"] == strategy]
        if own.empty:
            continue
        y = places(own["trial"].tolist(), trials_of(material), material.subjects)
        spread = own[sd].to_numpy(dtype=np.float64)
        half = NORMAL_95 * factor * np.where(np.isfinite(spread), spread, 0.0)
        x = factor * own[value].to_numpy(dtype=np.float64)
        label = style.printable(strategy, 20)
        axes.errorbar(x, y, xerr=half, fmt="o", ms=3, capsize=1.5, lw=0.8, color=style.colour(k), label=label)


def _within(k: int, count: int) -> float:
    return 0.0 if count < 2 else _SPREAD * (k / (count - 1) - 0.5)
