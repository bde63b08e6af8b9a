"""``cohort.html``: one file that opens anywhere, with nothing to fetch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.cohort import tables
from mocap_id.reporting.cohort.figures import drawings
from mocap_id.reporting.cohort.material import CohortMaterial, Fate, TrialEntry
from mocap_id.reporting.embedding import embedded
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.numbers import UNKNOWN, show, show_fixed
from mocap_id.reporting.page import Advice, Prose, advice, environment, prose, sentence
from mocap_id.reporting.sections import Glance
from mocap_id.reporting.tables import Grid

_FAILED = ("Failed", "It could not be computed.")
_COLOURS: dict[Fate, str] = {"ok": "ok", "caution": "caution", "refused": "refused", "failed": "refused"}


@dataclass(frozen=True)
class Told:
    """How one trial went, in words."""

    name: str
    about: str
    level: str
    headline: str
    lead: Prose
    reasons: tuple[Advice, ...]
    report: str | None


@dataclass(frozen=True)
class Part:
    """A section of the page: figures first, then tables, and those of every person, folded away."""

    anchor: str
    title: str
    figures: tuple[str, ...]
    grids: tuple[Grid, ...]
    of_people: tuple[Grid, ...]


def page(material: CohortMaterial) -> bytes:
    """The page as UTF-8."""
    figures = drawings(material)
    html = (
        environment()
        .get_template("cohort.html.j2")
        .render(
            study=style.printable(material.study),
            product=material.product,
            level=_level(material),
            headline=_headline(material),
            lead=_lead(material),
            glance=_glance(material),
            trials=[told(trial) for trial in material.trials],
            overview=tables.trials(material),
            parts=_parts(material),
            figures=figures,
            embedded=embedded(figures),
        )
    )
    return html.encode("utf-8")


def _parts(material: CohortMaterial) -> tuple[Part, ...]:
    lengths = (tables.lengths(material), tables.strategies(material))
    models = (tables.models(material), tables.doubtful(material))
    variation, varied = tables.variation(material), tables.variation_of_people(material)
    strategies, predicted = tables.strategies_of_people(material), tables.models_of_people(material)
    return (
        Part("lengths", "Segment lengths", ("lengths",), lengths, (strategies,)),
        Part("models", "Forces and torques by every model", ("pressure",), models, (predicted,)),
        Part("parameters", "Inertial parameters", ("parameters",), (variation,), (varied,)),
    )


def told(trial: TrialEntry) -> Told:
    """How a trial went, in words."""
    headline, lead = _FAILED if trial.fate == "failed" else LEVELS[trial.fate]
    words = sentence(style.printable(trial.message)) if trial.message and trial.fate == "failed" else lead
    return Told(
        name=trial.name,
        about=f"{trial.subject}, {trial.strategy}",
        level=_COLOURS[trial.fate],
        headline=headline,
        lead=prose(words),
        reasons=tuple(advice(reason) for reason in trial.reasons),
        report=trial.report,
    )


def _through(material: CohortMaterial) -> int:
    return sum(trial.fate in ("ok", "caution") for trial in material.trials)


def _level(material: CohortMaterial) -> str:
    return "ok" if all(trial.fate == "ok" for trial in material.trials) else "caution"


def _headline(material: CohortMaterial) -> str:
    return f"{_through(material)} of {len(material.trials)} trials went through"


def _lead(material: CohortMaterial) -> str:
    counted = {fate: sum(trial.fate == fate for trial in material.trials) for fate in _COLOURS}
    words = {"ok": "good", "caution": "usable with care", "refused": "refused", "failed": "failed"}
    told = ", ".join(f"{count} {words[fate]}" for fate, count in counted.items() if count)
    return f"{told[:1].upper()}{told[1:]}. Tables and figures are about those that went through."


def _glance(material: CohortMaterial) -> list[Glance]:
    trials = material.tables["trials"]
    found = (
        Glance("people", str(len(material.subjects)), f"{len(material.trials)} trials"),
        Glance("strategies", str(len(material.strategies)), ", ".join(material.strategies)),
        Glance("repetitions", _sum(trials["complete"]), "complete"),
        Glance("re-projection", _median(trials["reprojection"], 1e3, "mm"), "median of the trials' rms"),
        Glance("CoP, own model", _median(trials["cop_x_own_rms"], 1e3, "mm"), "median of the trials' rms error"),
        Glance("CoP, held out", _median(trials["cop_x_held_out_rms"], 1e3, "mm"), "on repetitions left out"),
        Glance("CoP, allometric", _median(trials["cop_x_reference_rms"], 1e3, "mm"), "same samples as own"),
        Glance("condition number", show(_middle(trials["condition_number"])), "median"),
    )
    return [number for number in found if number.value != UNKNOWN]


def _median(column: pd.Series[float], factor: float, unit: str) -> str:
    return show_fixed(factor * _middle(column), 1, unit)


def _middle(column: pd.Series[float]) -> float:
    known = column.to_numpy(dtype=np.float64)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


def _sum(column: pd.Series[int]) -> str:
    return str(int(column.sum())) if column.notna().any() else UNKNOWN
