"""The perturbations to run, from the user's options: each kind with each of its levels on each of its targets."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import Field

from mocap_id.config.parsing import parse, raise_mistakes, suggest_name
from mocap_id.config.source import Source, read
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Settings
from mocap_id.workflows.sensitivity.kinds import ALL, JOINTS, KINDS, Kind

SEED = 1


@dataclass(frozen=True)
class KindSelection:
    """A kind of perturbation with levels and targets; an empty tuple means the default levels or targets."""

    kind: str  # one of :data:`mocap_id.workflows.sensitivity.kinds.KINDS`
    levels: tuple[float, ...] = ()
    targets: tuple[str, ...] = ()


ALL_KINDS = tuple(KindSelection(kind) for kind in KINDS)
"""All kinds with their default levels and targets."""


@dataclass(frozen=True)
class SensitivityOptions:
    """The options of a sensitivity study."""

    selections: tuple[KindSelection, ...] = ALL_KINDS
    seed: int = SEED
    tolerance: float = 0.05  # tolerated change of a base parameter, as a fraction of its size

    def only(self, kinds: Sequence[str]) -> SensitivityOptions:
        """Return the options with only the selections of ``kinds``; the same options if ``kinds`` is empty.

        Raises
        ------
        ConfigError
            There is no such kind, or none of the kinds is selected.
        """
        for name in kinds:
            if name not in KINDS:
                raise ConfigError(
                    f"--only {name}: there is no perturbation of this kind: {suggest_name(name, list(KINDS))}"
                )
        selections = tuple(one for one in self.selections if not kinds or one.kind in kinds)
        if not selections:
            raise ConfigError(f"--only {', '.join(kinds)}: the settings file does not contain these kinds")
        return replace(self, selections=selections)


class _Entry(Settings):
    kind: str = Field(description="what is perturbed")
    levels: tuple[float, ...] = Field((), description="levels to try, in the kind's unit; if not given, its defaults")
    on: tuple[str | float, ...] = Field((), description="joints, components or marker sd; if not given, the defaults")

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(name if isinstance(name, str) else f"{name:g}" for name in self.on)


class _File(Settings):
    seed: int = Field(SEED, ge=0, description="seed of the random numbers")
    tolerance: float = Field(5.0, gt=0, description="tolerated change of a base parameter, % of its size")
    perturbations: tuple[_Entry, ...] = Field((), description="perturbations to try; all kinds if not given")


def read_options(file: Path) -> SensitivityOptions:
    """Read and check a settings file.

    Raises
    ------
    ConfigError
        The file has mistakes; the message has a line for each mistake: file, line, key, and the expected value.
    """
    source = read(file.absolute())
    if isinstance(source.data, list):
        moved = {("perturbations", *key): line for key, line in source.lines.items()}
        source = Source(source.file, {"perturbations": source.data}, {(): 1, **moved})
    parsed = parse(source, _File, "a list of perturbations, each with a `kind:`")
    raise_mistakes(
        line for number, entry in enumerate(parsed.perturbations) for line in _find_mistakes(entry, number, source)
    )
    selections = tuple(KindSelection(entry.kind, entry.levels, entry.targets) for entry in parsed.perturbations)
    return SensitivityOptions(selections or ALL_KINDS, parsed.seed, parsed.tolerance / 100)


def _find_mistakes(entry: _Entry, number: int, source: Source) -> Iterator[str]:
    """Yield a message for each mistake in an entry that the types of the settings do not exclude."""
    key = ("perturbations", number)
    kind = KINDS.get(entry.kind)
    if kind is None:
        where = source.where((*key, "kind"))
        yield f"{where}: there is no perturbation `{entry.kind}`: {suggest_name(entry.kind, list(KINDS))}"
        return
    for k, level in enumerate(entry.levels):
        if not kind.allowed(level):
            yield f"{source.where((*key, 'levels', k))}: {kind.name}: the level {level:g} is not {kind.expected}"
    for k, name in enumerate(entry.targets):
        where = source.where((*key, "on", k))
        if kind.free:
            if not _is_positive(name):
                yield f"{where}: {kind.name}: `on` is {name!r}; expected a marker's standard deviation above 0, m"
        elif not kind.targets:
            yield f"{where}: {kind.name} acts on everything: leave out `on`"
        elif kind.targets != JOINTS and name not in kind.targets:
            yield f"{where}: {kind.name}: there is no {name!r}: {suggest_name(name, list(kind.targets))}"


def _is_positive(text: str) -> bool:
    try:
        return float(text) > 0
    except ValueError:
        return False


@dataclass(frozen=True)
class Perturbation:
    """One perturbation of a trial: a kind at one level on one target."""

    kind: str
    target: str  # a joint, a component or a marker's standard deviation; empty if the kind acts on everything
    level: float  # in the kind's unit
    seed: int = SEED  # seed of the whole study

    @property
    def definition(self) -> Kind:
        """The definition of the perturbation's kind."""
        return KINDS[self.kind]

    @property
    def name(self) -> str:
        """Kind, target and level as one text, as in the tables; unique in a study."""
        return " ".join(part for part in (self.kind, self.target, f"{self.level:g}") if part)

    def rng(self) -> np.random.Generator:
        """Return a random generator that depends only on seed, kind and target, so that all levels get equal draws."""
        words = np.frombuffer(hashlib.sha256(f"{self.kind}/{self.target}".encode()).digest(), dtype=np.uint32)
        return np.random.default_rng([self.seed, *words.tolist()])


def plan(selections: Sequence[KindSelection], joints: Sequence[str], seed: int = SEED) -> tuple[Perturbation, ...]:
    """Return the perturbations of a trial that the selections describe, without duplicates.

    Parameters
    ----------
    selections : sequence of KindSelection
    joints : sequence of str
        Names of the trial's joints.
    seed : int

    Raises
    ------
    ConfigError
        The trial does not have one of the targets.
    """
    perturbations = (
        Perturbation(one.kind, target, float(level), seed)
        for one in selections
        for target in _choose_targets(one, joints)
        for level in one.levels or KINDS[one.kind].levels
    )
    return tuple(dict.fromkeys(perturbations))


def _choose_targets(selection: KindSelection, joints: Sequence[str]) -> Sequence[str]:
    kind = KINDS[selection.kind]
    if kind.free:
        return selection.targets or kind.targets
    possible = (*joints, ALL) if kind.targets == JOINTS else kind.targets
    wrong = [target for target in selection.targets if target not in possible]
    if wrong:
        expected = f"expected one of {', '.join(possible)}" if possible else "this kind has no target: leave out `on`"
        raise ConfigError(f"{kind.name}: there is no {wrong[0]!r} to perturb in this trial; {expected}")
    if selection.targets:
        return selection.targets
    if len(joints) == 1 and kind.targets == JOINTS:
        return joints  # with a single joint, "all" would be the same target
    return kind.usual or possible or ("",)
