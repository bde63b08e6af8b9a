"""Search for the explanation of a verdict code, an error or an exit code."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass

from mocap_id.errors import ConfigError
from mocap_id.reporting.explanations import EXIT_CODES, EXPLANATIONS

_LEVELS = {"ok": "note"}


@dataclass(frozen=True)
class Entry:
    """The explanation of one code."""

    kind: str  # ``verdict`` or ``exit``
    code: str  # such as ``segments-unsure`` or ``exit-4``
    levels: tuple[str, ...]  # possible levels: refused, caution, note; empty for an exit code
    title: str
    meaning: str
    judged: str  # the criterion; for an exit code, the class of the error
    action: str  # what to do


def list_entries() -> Mapping[str, Entry]:
    """Return the explanations of all codes by code, verdicts first."""
    verdicts = (_make_verdict(code) for code in sorted(EXPLANATIONS))
    return {entry.code: entry for entry in (*verdicts, *map(_make_exit, EXIT_CODES))}


def explain(code: str) -> Entry:
    """Return the explanation of a code.

    Parameters
    ----------
    code : str
        Code of a verdict (``segments-unsure``; case and underscores are ignored), an exit code (``4``, ``exit-4``), or
        the name of an error (``StoreError``).

    Raises
    ------
    ConfigError
        The code is unknown; the message names similar codes.
    """
    known = list_entries()
    name = code.strip().lower().replace("_", "-").replace(" ", "-")
    aliases = _find_aliases()
    entry = known.get(aliases.get(name, name), known.get(name))
    if entry is None:
        close = difflib.get_close_matches(name, [*known, *aliases], n=3, cutoff=0.5)
        near = f"the nearest are {', '.join(close)}" if close else "`mocap-id explain` lists all codes"
        raise ConfigError(f"there is no code `{code}`: {near}")
    return entry


def _find_aliases() -> dict[str, str]:
    """Return exit codes such as ``exit-4`` by alias: the number, or the name of the error with or without hyphens."""
    named = {entry.name: number for number, entry in EXIT_CODES.items() if entry.name}
    hyphened = {re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower(): number for name, number in named.items()}
    plain = {name.lower(): number for name, number in named.items()}
    numbers = {str(number): number for number in EXIT_CODES}
    return {alias: f"exit-{number}" for alias, number in {**hyphened, **plain, **numbers}.items()}


def _make_verdict(code: str) -> Entry:
    entry = EXPLANATIONS[code]
    judged = f"by `{entry.stage}`. {entry.criterion}"
    levels = tuple(_LEVELS.get(level, level) for level in entry.levels)
    return Entry("verdict", code, levels, entry.title, entry.meaning, judged, entry.action)


def _make_exit(number: int) -> Entry:
    entry = EXIT_CODES[number]
    judged = "" if entry.name is None else f"{entry.name} of mocap_id.errors"
    return Entry("exit", f"exit-{number}", (), entry.title, entry.meaning, judged, entry.action)
