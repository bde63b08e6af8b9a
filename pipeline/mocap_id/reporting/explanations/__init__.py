"""Explanations of every reason code and exit code: what it means and what to do.

The texts are in the TOML files of this folder. An entry is named by its code; ``levels`` are the levels of the verdict
at which the code can occur, most severe first.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from mocap_id import errors
from mocap_id.verdict import Level

FILES = ("recording", "chain", "landmarks", "space", "inertial", "contact", "parameters", "transfer")
"""Files with the explanations of reason codes, by topic."""

LEVELS: Mapping[Level, tuple[str, str]] = {
    "ok": ("Good", "Every check passed. Use the numbers below with their intervals."),
    "caution": (
        "Usable with care",
        "The trial was processed, but the reasons listed here limit what can be concluded from it.",
    ),
    "refused": (
        "Refused",
        "The method cannot process this recording. This is a finding about the recording, not a program failure. The "
        "report gives the reason, what to change, and the results that are still valid.",
    ),
}
"""Headline and first sentences of the report for each level of a verdict."""


@dataclass(frozen=True)
class Explanation:
    """Explanation of one reason code."""

    levels: tuple[Level, ...]  # levels of the verdict at which the code can occur, most severe first
    stage: str  # stage or command that checks this
    title: str
    meaning: str  # consequences for the results
    action: str  # what to do
    criterion: str  # measured quantity and limit; limits without a setting are constants in the code


@dataclass(frozen=True)
class ExitCode:
    """Explanation of one exit code."""

    title: str
    meaning: str  # what happened, and what was written
    action: str  # what to do
    error: type[errors.MocapIdError] | None = None  # exception that leads to the exit code

    @property
    def name(self) -> str | None:
        """Class name of the error."""
        return None if self.error is None else self.error.__name__


def read_texts(file: str) -> dict[str, dict[str, Any]]:
    """Return the entries of a TOML file of this folder by code, with each text on one line."""
    entries = tomllib.loads(files(__name__).joinpath(f"{file}.toml").read_text("utf-8"))
    return {
        code: {key: " ".join(value.split()) if isinstance(value, str) else tuple(value) for key, value in entry.items()}
        for code, entry in entries.items()
    }


EXPLANATIONS: Mapping[str, Explanation] = {
    code: Explanation(**entry) for file in FILES for code, entry in read_texts(file).items()
}
"""Explanations of the reasons of all stages and workflows, by reason code."""

EXIT_CODES: Mapping[int, ExitCode] = {
    int(code): ExitCode(**{**entry, "error": getattr(errors, entry["error"]) if "error" in entry else None})
    for code, entry in read_texts("exit_codes").items()
}
"""Explanation of every exit code of every command."""


def as_markdown() -> str:
    """Return the explanations of all reason codes in Markdown, for docs/verdict.md."""
    order: tuple[Level, ...] = ("refused", "caution", "ok")
    names = {"refused": "refused", "caution": "caution", "ok": "note"}
    entries = sorted(EXPLANATIONS.items(), key=lambda item: (order.index(item[1].levels[0]), item[0]))
    parts = (
        f"### `{code}`: {entry.title}\n\n"
        f"*{' or '.join(names[level] for level in entry.levels)}*\n\n"
        f"{entry.meaning}\n\n**What to do.** {entry.action}\n"
        for code, entry in entries
    )
    return "\n".join(parts)
