"""Explanations of verdict codes, errors and exit codes, by name."""

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
    """Explanation of one code.

    Parameters
    ----------
    kind : str
        ``verdict`` or ``exit``.
    code : str
        ``segments-unsure``, or ``exit-4``.
    levels : tuple of str
        Possible levels: refused, caution, note; none for an exit code.
    title, meaning, action : str
    judged : str
        The criterion; for an exit code, the error.
    """

    kind: str
    code: str
    levels: tuple[str, ...]
    title: str
    meaning: str
    judged: str
    action: str


def entries() -> Mapping[str, Entry]:
    """Return the explanations of all codes, verdicts first."""
    verdicts = (_verdict(code) for code in sorted(EXPLANATIONS))
    return {entry.code: entry for entry in (*verdicts, *map(_exit, EXIT_CODES))}


def explain(code: str) -> Entry:
    """Explain a code.

    Parameters
    ----------
    code : str
        Code of a verdict (``segments-unsure``; case and underscores are ignored), an exit code (``4``, ``exit-4``), or
        the name of an error (``StoreError``).

    Raises
    ------
    ConfigError
        The code is unknown; the message names similar ones.
    """
    known = entries()
    name = code.strip().lower().replace("_", "-").replace(" ", "-")
    found = known.get(_aliases().get(name, name), known.get(name))
    if found is None:
        close = difflib.get_close_matches(name, [*known, *_aliases()], n=3, cutoff=0.5)
        near = f"the nearest are {', '.join(close)}" if close else "`mocap-id explain` lists all"
        raise ConfigError(f"there is no code `{code}`: {near}")
    return found


def _aliases() -> dict[str, str]:
    """Return other names of exit codes: numbers, and errors with and without hyphens."""
    named = {entry.name: number for number, entry in EXIT_CODES.items() if entry.name}
    hyphened = {re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower(): number for name, number in named.items()}
    plain = {name.lower(): number for name, number in named.items()}
    numbers = {str(number): number for number in EXIT_CODES}
    return {alias: f"exit-{number}" for alias, number in {**hyphened, **plain, **numbers}.items()}


def _verdict(code: str) -> Entry:
    entry = EXPLANATIONS[code]
    judged = f"by `{entry.stage}`. {entry.criterion}"
    levels = tuple(_LEVELS.get(level, level) for level in entry.levels)
    return Entry("verdict", code, levels, entry.title, entry.meaning, judged, entry.action)


def _exit(number: int) -> Entry:
    entry = EXIT_CODES[number]
    judged = "" if entry.name is None else f"{entry.name} of mocap_id.errors"
    return Entry("exit", f"exit-{number}", (), entry.title, entry.meaning, judged, entry.action)
