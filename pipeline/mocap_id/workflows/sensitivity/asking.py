"""What the user asks for: the settings file, and the kinds named on the command line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field, ValidationError

from mocap_id.config.explain import explain, nearest
from mocap_id.config.source import Source, read
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Settings
from mocap_id.workflows.sensitivity.kinds import JOINTS, KINDS
from mocap_id.workflows.sensitivity.plan import EVERYTHING, SEED, Wish, of_kinds


class _Entry(Settings):
    kind: str = Field(description="what is perturbed")
    levels: tuple[float, ...] = Field((), description="sizes to try, in the kind's unit; its own where not given")
    on: tuple[str | float, ...] = Field((), description="joints, components or marker sd; the kind's own if not given")


class _File(Settings):
    seed: int = Field(SEED, ge=0, description="of everything that is drawn")
    tolerance: float = Field(5.0, gt=0, description="change of a base parameter that is tolerated, % of its size")
    perturbations: tuple[_Entry, ...] = Field((), description="what to try; everything where not given")


@dataclass(frozen=True)
class Asked:
    """What to try and what to tolerate.

    Parameters
    ----------
    wishes : tuple of Wish
    seed : int
    tolerance : float
        Change of a base parameter that is tolerated, as a share of its size.
    """

    wishes: tuple[Wish, ...] = EVERYTHING
    seed: int = SEED
    tolerance: float = 0.05

    def only(self, kinds: Sequence[str]) -> Asked:
        """The same for some kinds alone.

        Raises
        ------
        ConfigError
            There is no such kind, or the settings file asks for none of them.
        """
        for name in kinds:
            if name not in KINDS:
                raise ConfigError(f"--only {name}: there is no such kind of perturbation: {nearest(name, list(KINDS))}")
        wishes = of_kinds(self.wishes, kinds)
        if not wishes:
            raise ConfigError(f"--only {', '.join(kinds)}: the settings file asks for no perturbation of that kind")
        return Asked(wishes, self.seed, self.tolerance)


def read_asked(file: Path) -> Asked:
    """Read and check a settings file.

    Raises
    ------
    ConfigError
        One line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read(file.absolute())
    if isinstance(source.data, list):
        moved = {("perturbations", *place): line for place, line in source.lines.items()}
        source = Source(source.file, {"perturbations": source.data}, {(): 1, **moved})
    if not isinstance(source.data, dict):
        raise ConfigError(f"{source.where(())}: expected a list of perturbations, each with a `kind:`")
    try:
        parsed = _File.model_validate_json(json.dumps(source.data), strict=True)
    except ValidationError as error:
        raise ConfigError(explain(error, _File, source)) from error
    mistakes = [line for number, entry in enumerate(parsed.perturbations) for line in _mistakes(entry, number, source)]
    if mistakes:
        raise ConfigError("\n".join(mistakes))
    wishes = tuple(Wish(entry.kind, entry.levels, _names(entry)) for entry in parsed.perturbations)
    return Asked(wishes or EVERYTHING, parsed.seed, parsed.tolerance / 100)


def _names(entry: _Entry) -> tuple[str, ...]:
    return tuple(name if isinstance(name, str) else f"{name:g}" for name in entry.on)


def _mistakes(entry: _Entry, number: int, source: Source) -> Iterator[str]:
    """What the types do not show."""
    place = ("perturbations", number)
    kind = KINDS.get(entry.kind)
    if kind is None:
        where = source.where((*place, "kind"))
        yield f"{where}: there is no perturbation `{entry.kind}`: {nearest(entry.kind, list(KINDS))}"
        return
    for k, level in enumerate(entry.levels):
        if not kind.allowed(level):
            yield f"{source.where((*place, 'levels', k))}: {kind.name}: the level {level:g} is not {kind.expected}"
    for k, name in enumerate(_names(entry)):
        where = source.where((*place, "on", k))
        if kind.free:
            if not _is_sd(name):
                yield f"{where}: {kind.name}: `on` is {name!r}, expected a marker's standard deviation above 0, m"
        elif not kind.targets:
            yield f"{where}: {kind.name} acts on everything alike: leave `on` away"
        elif kind.targets != JOINTS and name not in kind.targets:
            yield f"{where}: {kind.name}: there is no {name!r}: {nearest(name, list(kind.targets))}"


def _is_sd(name: str) -> bool:
    try:
        return float(name) > 0
    except ValueError:
        return False
