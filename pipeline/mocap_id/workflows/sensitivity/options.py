"""Options of a sensitivity study: the settings file, and the kinds named on the command line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field

from mocap_id.config.parsing import parse, raise_mistakes, suggest_name
from mocap_id.config.source import Source, read
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Settings
from mocap_id.workflows.sensitivity.kinds import JOINTS, KINDS
from mocap_id.workflows.sensitivity.plan import ALL_KINDS, SEED, KindSelection, of_kinds


class _Entry(Settings):
    kind: str = Field(description="what is perturbed")
    levels: tuple[float, ...] = Field((), description="levels to try, in the kind's unit; the kind's own if not given")
    on: tuple[str | float, ...] = Field((), description="joints, components or marker sd; the kind's own if not given")


class _File(Settings):
    seed: int = Field(SEED, ge=0, description="seed of everything that is drawn")
    tolerance: float = Field(5.0, gt=0, description="tolerated change of a base parameter, % of its size")
    perturbations: tuple[_Entry, ...] = Field((), description="what to try; everything if not given")


@dataclass(frozen=True)
class SensitivityOptions:
    """The perturbations to try, and the tolerated change."""

    selections: tuple[KindSelection, ...] = ALL_KINDS
    seed: int = SEED
    tolerance: float = 0.05  # tolerated change of a base parameter, as a share of its size

    def only(self, kinds: Sequence[str]) -> SensitivityOptions:
        """Return the same options for some kinds only.

        Raises
        ------
        ConfigError
            There is no such kind, or the settings file has none of them.
        """
        for name in kinds:
            if name not in KINDS:
                raise ConfigError(
                    f"--only {name}: there is no such kind of perturbation: {suggest_name(name, list(KINDS))}"
                )
        selections = of_kinds(self.selections, kinds)
        if not selections:
            raise ConfigError(f"--only {', '.join(kinds)}: the settings file has no perturbation of this kind")
        return SensitivityOptions(selections, self.seed, self.tolerance)


def read_options(file: Path) -> SensitivityOptions:
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
    parsed = parse(source, _File, "a list of perturbations, each with a `kind:`")
    raise_mistakes(
        line for number, entry in enumerate(parsed.perturbations) for line in _mistakes(entry, number, source)
    )
    selections = tuple(KindSelection(entry.kind, entry.levels, _names(entry)) for entry in parsed.perturbations)
    return SensitivityOptions(selections or ALL_KINDS, parsed.seed, parsed.tolerance / 100)


def _names(entry: _Entry) -> tuple[str, ...]:
    return tuple(name if isinstance(name, str) else f"{name:g}" for name in entry.on)


def _mistakes(entry: _Entry, number: int, source: Source) -> Iterator[str]:
    """Return messages about mistakes that the types do not show."""
    place = ("perturbations", number)
    kind = KINDS.get(entry.kind)
    if kind is None:
        where = source.where((*place, "kind"))
        yield f"{where}: there is no perturbation `{entry.kind}`: {suggest_name(entry.kind, list(KINDS))}"
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
            yield f"{where}: {kind.name} acts on everything: leave out `on`"
        elif kind.targets != JOINTS and name not in kind.targets:
            yield f"{where}: {kind.name}: there is no {name!r}: {suggest_name(name, list(kind.targets))}"


def _is_sd(name: str) -> bool:
    try:
        return float(name) > 0
    except ValueError:
        return False
