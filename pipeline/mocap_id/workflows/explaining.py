"""What a verdict's code, an error or an exit code means, by its name."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass

from mocap_id.errors import ConfigError
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.explanations.exits import EXITS
from mocap_id.reporting.explanations.judged import JUDGED

_LEVELS = {"ok": "note"}


@dataclass(frozen=True)
class Entry:
    """One code explained.

    Parameters
    ----------
    kind : str
        ``verdict`` or ``exit``.
    code : str
        ``segments-unsure``, or ``exit-4``.
    levels : tuple of str
        That it may come with: refused, caution, note; none for an exit code.
    title, meaning, action : str
    judged : str
        By what; for an exit code, by which error.
    """

    kind: str
    code: str
    levels: tuple[str, ...]
    title: str
    meaning: str
    judged: str
    action: str


def answers() -> Mapping[str, Entry]:
    """Every code, those of verdicts first."""
    verdicts = (_verdict(code) for code in sorted(EXPLANATIONS))
    return {answer.code: answer for answer in (*verdicts, *map(_exit, EXITS))}


def explain(code: str) -> Entry:
    """A code's answer.

    Parameters
    ----------
    code : str
        Of a verdict (``segments-unsure``; case and underscores do not matter), an exit code (``4``, ``exit-4``), or an
        error's name (``StoreError``).

    Raises
    ------
    ConfigError
        There is no such code; the message names the nearest.
    """
    known = answers()
    asked = code.strip().lower().replace("_", "-").replace(" ", "-")
    found = known.get(_alias(asked), known.get(asked))
    if found is None:
        close = difflib.get_close_matches(asked, [*known, *_aliases()], n=3, cutoff=0.5)
        near = f"the nearest are {', '.join(close)}" if close else "`mocap-id explain` lists all"
        raise ConfigError(f"there is no code `{code}`: {near}")
    return found


def _aliases() -> dict[str, str]:
    """Other names of exit codes: numbers, and errors with and without hyphens."""
    named = {entry.name: number for number, entry in EXITS.items() if entry.name}
    hyphened = {re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower(): number for name, number in named.items()}
    plain = {name.lower(): number for name, number in named.items()}
    numbers = {str(number): number for number in EXITS}
    return {alias: f"exit-{number}" for alias, number in {**hyphened, **plain, **numbers}.items()}


def _alias(asked: str) -> str:
    return _aliases().get(asked, asked)


def _verdict(code: str) -> Entry:
    entry = EXPLANATIONS[code]
    where, measure = JUDGED[code]
    levels = tuple(_LEVELS.get(level, level) for level in entry.levels)
    return Entry("verdict", code, levels, entry.title, entry.meaning, f"by `{where}`. {measure}", entry.action)


def _exit(number: int) -> Entry:
    entry = EXITS[number]
    judged = "" if entry.name is None else f"{entry.name} of mocap_id.errors"
    return Entry("exit", f"exit-{number}", (), entry.title, entry.meaning, judged, entry.action)
