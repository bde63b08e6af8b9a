"""A trial of a study with what came of it, and what its lengths are held against."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config.study import Person, Study, StudyTrial
from mocap_id.dynamics.allometry import TableName, table
from mocap_id.errors import Refused
from mocap_id.reporting.contents import SUMMARY_FILE
from mocap_id.store import Folder, Tree
from mocap_id.workflows.finished import Finished, finished
from mocap_id.workflows.performing import Performed
from mocap_id.workflows.transfer import Body, at_home

SEGMENTS = ("shank", "thigh")
"""Whose lengths are compared."""
LANDMARKS = "landmarks"


@dataclass(frozen=True)
class Reference:
    """What a person's lengths are held against.

    Parameters
    ----------
    kind : str
        ``landmarks``, or ``stature`` and the allometric table; empty where there is nothing.
    lengths : mapping of str to float or None
        Of shank and thigh, m.
    by_stature : mapping of str to float or None
        What the table says of them for this height, m.
    """

    kind: str
    lengths: Mapping[str, float | None]
    by_stature: Mapping[str, float | None]


@dataclass(frozen=True)
class Parameters:
    """The base parameters of a trial.

    Parameters
    ----------
    symbols : tuple of str
        The parameter that the others are regrouped into: m1, mx1, mx2 …
    expressions, units, verdicts : tuple of str
    value, sd, reference : (b,) arrays
        Identified, its standard deviation, and of the allometric body on the same chain; NaN where unknown.
    segments : int
        Of the chain, with the base.
    """

    symbols: tuple[str, ...]
    expressions: tuple[str, ...]
    units: tuple[str, ...]
    verdicts: tuple[str, ...]
    value: FloatArray
    sd: FloatArray
    reference: FloatArray
    segments: int


@dataclass(frozen=True)
class Case:
    """A trial of a study with what came of it.

    Parameters
    ----------
    trial : StudyTrial
    performed : Performed
    reference : Reference
        Of its lengths.
    summary : mapping or None
        summary.json; None for a trial that failed.
    done : Finished or None
        Its dynamics; None for one that failed or was refused.
    at_home : tuple of Body
        Errors of its own model, of the same on repetitions left out, and of the allometric body.
    parameters : Parameters or None
        None where nothing was identified.
    """

    trial: StudyTrial
    performed: Performed
    reference: Reference
    summary: Mapping[str, Any] | None
    done: Finished | None
    at_home: tuple[Body, ...]
    parameters: Parameters | None

    @property
    def subject(self) -> str:
        """The person's id."""
        return self.trial.subject

    @property
    def strategy(self) -> str:
        """How the person moves."""
        return self.trial.strategy

    def length(self, segment: str) -> float | None:
        """Of a segment, m; None where it is not known."""
        return self.length_and_sd(segment)[0]

    def length_and_sd(self, segment: str) -> tuple[float | None, float | None]:
        """Of a segment, m; None where they are not known."""
        entry = ((self.summary or {}).get("lengths_m") or {}).get(segment) or {}
        return entry.get("value"), entry.get("sd")


def case(study: Study, trial: StudyTrial, performed: Performed) -> Case:
    """Read what a trial left in its folder."""
    out, well = trial.trial.out, performed.exit_code == 0
    told = performed.exit_code in (0, Refused.exit_code)
    done = finished(out) if well else None
    identification: Any = trial.trial.settings["identify-dim"]
    return Case(
        trial=trial,
        performed=performed,
        reference=length_reference(study.subjects[trial.subject], identification.reference),
        summary=json.loads((out / SUMMARY_FILE).read_text("utf-8")) if told else None,
        done=done,
        at_home=() if done is None else at_home(done),
        parameters=parameters(out) if well else None,
    )


def length_reference(person: Person, name: TableName) -> Reference:
    """What a person's lengths are held against: landmarks where there are any, else stature."""
    people = table(name, person.sex)
    stature = {
        segment: None if person.height is None else getattr(people, segment).length * person.height
        for segment in SEGMENTS
    }
    measured = {segment: getattr(person.landmarks_m, segment) for segment in SEGMENTS}
    if any(length is not None for length in measured.values()):
        return Reference(LANDMARKS, measured, stature)
    return Reference("" if person.height is None else f"stature ({name})", stature, stature)


def parameters(out: Path) -> Parameters | None:
    """The base parameters in a run folder; None where none was identified."""
    tree = Folder(out).read("dynamics.h5")
    assert isinstance(tree, Tree)
    base: Any = tree.data["base"]
    full: Any = tree.data["full"]
    value = np.asarray(base["value"], dtype=np.float64)
    if np.isfinite(value).sum() <= 1:  # the mass alone is no model
        return None
    regrouping, reference = np.asarray(base["regrouping"]), np.asarray(full["reference"], dtype=np.float64)
    expressions = tuple(map(str, base["name"]))
    return Parameters(
        symbols=tuple(name.split("+")[0] for name in expressions),
        expressions=expressions,
        units=tuple(map(str, base["unit"])),
        verdicts=tuple(map(str, base["verdict"])),
        value=value,
        sd=np.asarray(base["sd"], dtype=np.float64),
        reference=regrouping @ reference,
        segments=len(reference) // 4,
    )
