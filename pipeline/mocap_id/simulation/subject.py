"""Somebody who does several trials: the same body, markers and skin in all of them."""

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
    """A person of a study.

    Parameters
    ----------
    name : str
    seed : int
        Of the body's proportions, of where each marker is glued and of how the skin below it slides.
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
    """The person of a number from 1 up in the cohort of a seed, whatever the cohort's size; women and men in turn."""
    source = np.random.SeedSequence([seed, number])
    rng = np.random.default_rng(source)
    sex = _SEXES[(number - 1) % len(_SEXES)]
    height = float(rng.uniform(*_HEIGHT[sex]))
    mass = float(rng.uniform(*_BODY_MASS_INDEX)) * height**2
    return Subject(f"s{number:02d}", int(source.generate_state(2)[1]), sex, height, mass)
