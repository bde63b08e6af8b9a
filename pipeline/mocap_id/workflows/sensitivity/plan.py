"""Which perturbations are tried: every kind at its levels on its targets, each with a stream of chance of its own."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.workflows.sensitivity.kinds import ALL, JOINTS, KINDS, Kind

SEED = 1


@dataclass(frozen=True)
class Wish:
    """A kind with levels and targets, as the settings ask for it; what is not given is the kind's own.

    Parameters
    ----------
    kind : str
        One of :data:`mocap_id.workflows.sensitivity.kinds.KINDS`.
    levels : tuple of float
    targets : tuple of str
    """

    kind: str
    levels: tuple[float, ...] = ()
    targets: tuple[str, ...] = ()


@dataclass(frozen=True)
class Perturbation:
    """One change to one trial.

    Parameters
    ----------
    kind : str
    target : str
        A joint, a component, a marker standard deviation, or empty.
    level : float
        In the kind's unit.
    seed : int
        Of the whole study.
    """

    kind: str
    target: str
    level: float
    seed: int = SEED

    @property
    def of(self) -> Kind:
        """Its kind."""
        return KINDS[self.kind]

    @property
    def name(self) -> str:
        """Kind, target and level, as in the tables: no other perturbation of a study has it."""
        return " ".join(part for part in (self.kind, self.target, f"{self.level:g}") if part)

    def rng(self) -> np.random.Generator:
        """Chance that depends on seed, kind and target alone: a higher level is the same draw, larger."""
        words = np.frombuffer(hashlib.sha256(f"{self.kind}/{self.target}".encode()).digest(), dtype=np.uint32)
        return np.random.default_rng([self.seed, *words.tolist()])


EVERYTHING = tuple(Wish(kind) for kind in KINDS)
"""What is tried where nothing is asked for."""


def plan(wishes: Sequence[Wish], joints: Sequence[str], seed: int = SEED) -> tuple[Perturbation, ...]:
    """The perturbations of a trial, none twice.

    Parameters
    ----------
    wishes : sequence of Wish
    joints : sequence of str
        Names of the trial's joints.
    seed : int

    Raises
    ------
    ConfigError
        A target is none of the trial's.
    """
    found = (
        Perturbation(wish.kind, target, float(level), seed)
        for wish in wishes
        for target in _targets(wish, joints)
        for level in wish.levels or KINDS[wish.kind].levels
    )
    return tuple(dict.fromkeys(found))


def _targets(wish: Wish, joints: Sequence[str]) -> Sequence[str]:
    kind = KINDS[wish.kind]
    if kind.free:
        return wish.targets or kind.targets
    known = tuple(_of_trial(kind, joints))
    wrong = [target for target in wish.targets if target not in known]
    if wrong:
        here = f"expected one of {', '.join(known)}" if known else "it acts on everything alike: leave `on` away"
        raise ConfigError(f"{kind.name}: there is no {wrong[0]!r} to perturb in this trial; {here}")
    if wish.targets:
        return wish.targets
    if len(joints) == 1 and kind.targets == JOINTS:
        return joints  # each and all are one
    return kind.usual or known or ("",)


def _of_trial(kind: Kind, joints: Sequence[str]) -> Iterator[str]:
    yield from (*joints, ALL) if kind.targets == JOINTS else kind.targets


def of_kinds(wishes: Iterable[Wish], kinds: Sequence[str]) -> tuple[Wish, ...]:
    """The wishes of some kinds alone; all of them where none is named."""
    return tuple(wish for wish in wishes if not kinds or wish.kind in kinds)
