"""Search for the explanation of a verdict code, an error or an exit code."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass

from mocap_id.errors import ConfigError
from mocap_id.reporting.explanations import EXIT_CODES, EXPLANATIONS


@dataclass(frozen=True)
class CodeEntry:
    """The explanation of one code."""

    kind: str  # ``verdict`` or ``exit``
    code: str  # such as ``segments-unsure`` or ``exit-4``
    levels: tuple[str, ...]  # possible levels: refused, caution, note; empty for an exit code
    title: str
    meaning: str
    judged: str  # the criterion; for an exit code, the class of the error
    action: str  # what to do


def list_entries() -> Mapping[str, CodeEntry]:
    """Return the explanations of all codes by code, verdicts first."""
    found = {}
    for code, one in sorted(EXPLANATIONS.items()):
        levels = tuple("note" if level == "ok" else level for level in one.levels)
        judged = f"by `{one.stage}`. {one.criterion}"
        found[code] = CodeEntry("verdict", code, levels, one.title, one.meaning, judged, one.action)
    for number, entry in EXIT_CODES.items():
        code, judged = f"exit-{number}", "" if entry.name is None else f"{entry.name} of mocap_id.errors"
        found[code] = CodeEntry("exit", code, (), entry.title, entry.meaning, judged, entry.action)
    return found


def explain_code(code: str) -> CodeEntry:
    """Return the explanation of a verdict's code, an exit code (``4``, ``exit-4``) or the name of an error.

    Case and underscores are ignored. The ConfigError for an unknown code names similar codes.
    """
    known = list_entries()
    name = code.strip().lower().replace("_", "-").replace(" ", "-")
    # An exit code is also known by the name of its error, with or without hyphens, and by its number.
    named = {entry.name: f"exit-{number}" for number, entry in EXIT_CODES.items() if entry.name}
    hyphened = {re.sub(r"(?<=[a-z])(?=[A-Z])", "-", error).lower(): exit_code for error, exit_code in named.items()}
    plain = {error.lower(): exit_code for error, exit_code in named.items()}
    aliases = {**hyphened, **plain, **{str(number): f"exit-{number}" for number in EXIT_CODES}}
    entry = known.get(aliases.get(name, name), known.get(name))
    if entry is None:
        close = difflib.get_close_matches(name, [*known, *aliases], n=3, cutoff=0.5)
        near = f"the nearest are {', '.join(close)}" if close else "`mocap-id explain` lists all codes"
        raise ConfigError(f"there is no code `{code}`: {near}")
    return entry
