"""What the figures over people share: a row a person, and a place within it for each trial."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.figure import Item, Points, Rule
from mocap_id.reporting.numbers import NORMAL_95

_SPREAD = 0.6  # of a row's height, for the trials of one person


def places(material: CohortMaterial, trials: Sequence[str]) -> FloatArray:
    """Vertical place of each trial: the person's row, and within it the trials one below the other."""
    place: dict[str, float] = {}
    for row, subject in enumerate(material.subjects):
        own = [trial.name for trial in material.trials if trial.subject == subject]
        place |= {name: row + _within(k, len(own)) for k, name in enumerate(own)}
    return np.array([place[trial] for trial in trials], dtype=np.float64)


def names(material: CohortMaterial) -> tuple[str, ...]:
    """What the rows go by."""
    return tuple(style.printable(subject, 16) for subject in material.subjects)


def between(material: CohortMaterial) -> list[Item]:
    """Lines between people."""
    return [Rule("y", k - 0.5, style.GRID) for k in range(1, len(material.subjects))]


def dots(material: CohortMaterial, frame: pd.DataFrame, value: str, sd: str, *, factor: float = 1) -> list[Item]:
    """A dot with its 95 % interval for each trial of a frame (`trial`, `strategy`), coloured by strategy."""
    known = frame[np.isfinite(frame[value].to_numpy(dtype=np.float64))]
    items: list[Item] = []
    for k, strategy in enumerate(material.strategies, start=1):
        own = known[known["strategy"] == strategy]
        if own.empty:
            continue
        trials, spread = own["trial"].tolist(), own[sd].to_numpy(dtype=np.float64)
        half = NORMAL_95 * factor * np.where(np.isfinite(spread), spread, 0.0)
        x = factor * own[value].to_numpy(dtype=np.float64)
        label, told = style.printable(strategy, 20), tuple(style.printable(trial, 30) for trial in trials)
        items.append(Points(x, places(material, trials), style.colour(k), label, size=3.5, half=half, names=told))
    return items


def _within(k: int, count: int) -> float:
    return 0.0 if count < 2 else _SPREAD * (k / (count - 1) - 0.5)
