"""The perturbations of a study: every kind at its levels on its targets, each with its own random stream."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.workflows.sensitivity.kinds import ALL, JOINTS, KINDS, Kind

SEED = 1


@dataclass(frozen=True)
class KindSelection:
    """A kind with levels and targets; the kind's own where none are given."""

    kind: str  # one of :data:`mocap_id.workflows.sensitivity.kinds.KINDS`
    levels: tuple[float, ...] = ()
    targets: tuple[str, ...] = ()


@dataclass(frozen=True)
class Perturbation:
    """One change to one trial."""

    kind: str
    target: str  # a joint, a component, a marker standard deviation, or empty
    level: float  # in the kind's unit
    seed: int = SEED  # seed of the whole study

    @property
    def definition(self) -> Kind:
        """The definition of its kind."""
        return KINDS[self.kind]

    @property
    def name(self) -> str:
        """Kind, target and level, as in the tables; unique in a study."""
        return " ".join(part for part in (self.kind, self.target, f"{self.level:g}") if part)

    def rng(self) -> np.random.Generator:
        """Return a generator that depends only on seed, kind and target: a higher level scales the same draw."""
        words = np.frombuffer(hashlib.sha256(f"{self.kind}/{self.target}".encode()).digest(), dtype=np.uint32)
        return np.random.default_rng([self.seed, *words.tolist()])


ALL_KINDS = tuple(KindSelection(kind) for kind in KINDS)
"""All kinds with their own levels and targets."""


def plan(selections: Sequence[KindSelection], joints: Sequence[str], seed: int = SEED) -> tuple[Perturbation, ...]:
    """Return the perturbations of a trial, none twice.

    Parameters
    ----------
    selections : sequence of KindSelection
    joints : sequence of str
        Names of the trial's joints.
    seed : int

    Raises
    ------
    ConfigError
        The trial does not have a target.
    """
    found = (
        Perturbation(one.kind, target, float(level), seed)
        for one in selections
        for target in _targets(one, joints)
        for level in one.levels or KINDS[one.kind].levels
    )
    return tuple(dict.fromkeys(found))


def _targets(selection: KindSelection, joints: Sequence[str]) -> Sequence[str]:
    kind = KINDS[selection.kind]
    if kind.free:
        return selection.targets or kind.targets
    known = tuple(_of_trial(kind, joints))
    wrong = [target for target in selection.targets if target not in known]
    if wrong:
        here = f"expected one of {', '.join(known)}" if known else "it acts on everything: leave out `on`"
        raise ConfigError(f"{kind.name}: there is no {wrong[0]!r} to perturb in this trial; {here}")
    if selection.targets:
        return selection.targets
    if len(joints) == 1 and kind.targets == JOINTS:
        return joints  # one joint is all joints
    return kind.usual or known or ("",)


def _of_trial(kind: Kind, joints: Sequence[str]) -> Iterator[str]:
    yield from (*joints, ALL) if kind.targets == JOINTS else kind.targets


def of_kinds(selections: Iterable[KindSelection], kinds: Sequence[str]) -> tuple[KindSelection, ...]:
    """Return the selections of some kinds; all selections if no kind is named."""
    return tuple(one for one in selections if not kinds or one.kind in kinds)
