"""Parts of figures with a row for each person and, within the row, a position for each trial."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Item, Points, Rule
from mocap_id.reporting.study.page_data import CohortData

_SPREAD = 0.6  # fraction of a row's height over which the trials of a person are spread


def place_trials(data: CohortData, trials: Sequence[str], subjects: Sequence[str] = ()) -> FloatArray:
    """Return the vertical position of each trial: in the row of the person, a person's trials in their order.

    The rows are in the order of ``subjects``; if it is empty, in the order in which people occur in the trials.
    """
    rows: dict[str, float] = {}
    frame = data.tables["trials"]
    for row, subject in enumerate(subjects or data.subjects):
        own = frame[frame["subject"] == subject]["trial"]
        rows |= {name: row + offset for name, offset in zip(own, spread_evenly(len(own), _SPREAD), strict=True)}
    return np.array([rows[trial] for trial in trials], dtype=np.float64)


def spread_evenly(count: int, width: float) -> FloatArray:
    """Return ``count`` evenly spaced positions, centred at zero, over a width; zero for a single position."""
    return width * (np.arange(count) / (count - 1) - 0.5) if count > 1 else np.zeros(count)


def name_rows(data: CohortData) -> tuple[str, ...]:
    """Return the labels of the rows: the ids of the people."""
    return tuple(style.clean(subject, 16) for subject in data.subjects)


def draw_separators(data: CohortData) -> list[Item]:
    """Return the lines between the rows of two people."""
    return [Rule("y", k - 0.5, style.GRID) for k in range(1, len(data.subjects))]


def draw_dots(data: CohortData, frame: pd.DataFrame, value: str, sd: str, *, factor: float = 1) -> list[Item]:
    """Return a dot with a 95 % interval for each row of a data frame, coloured by strategy.

    ``value`` and ``sd`` are column names; the frame also has `trial` and `strategy`. Values are times ``factor``.
    """
    known = frame[np.isfinite(frame[value].to_numpy(dtype=np.float64))]
    items: list[Item] = []
    for k, strategy in enumerate(data.strategies, start=1):
        own = known[known["strategy"] == strategy]
        if own.empty:
            continue
        trials, spread = own["trial"].tolist(), own[sd].to_numpy(dtype=np.float64)
        half = NORMAL_95 * factor * np.where(np.isfinite(spread), spread, 0.0)
        x = factor * own[value].to_numpy(dtype=np.float64)
        label, names = style.clean(strategy, 20), tuple(style.clean(trial, 30) for trial in trials)
        items.append(
            Points(x, place_trials(data, trials), style.pick_colour(k), label, size=3.5, half=half, names=names)
        )
    return items
