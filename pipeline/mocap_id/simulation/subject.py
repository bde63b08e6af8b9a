"""Persons who perform several trials with the same body, markers and skin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

Sex: TypeAlias = Literal["female", "male"]
_SEXES: tuple[Sex, ...] = ("female", "male")
_HEIGHT = {"female": (1.52, 1.76), "male": (1.64, 1.92)}  # m
_BODY_MASS_INDEX = (19.0, 29.0)  # kg/m²


@dataclass(frozen=True)
class Subject:
    """A person of a simulated study.

    Parameters
    ----------
    name : str
    seed : int
        Seed of the body's proportions, the markers' positions and the sliding of the skin.
    sex : {"female", "male"}
    height : float
        m.
    mass : float
        kg.
    """

    name: str
    seed: int
    sex: Sex
    height: float
    mass: float


def draw_subject(seed: int, number: int) -> Subject:
    """Draw person ``number`` (from 1) of a cohort, alternately female and male, independent of the cohort's size."""
    source = np.random.SeedSequence([seed, number])
    rng = np.random.default_rng(source)
    sex = _SEXES[(number - 1) % len(_SEXES)]
    height = float(rng.uniform(*_HEIGHT[sex]))
    mass = float(rng.uniform(*_BODY_MASS_INDEX)) * height**2
    return Subject(f"s{number:02d}", int(source.generate_state(2)[1]), sex, height, mass)
