"""The form of an explanation."""

from __future__ import annotations

from dataclasses import dataclass

from mocap_id.verdict import Level


@dataclass(frozen=True)
class Explanation:
    """A code in plain words.

    Parameters
    ----------
    levels : tuple of str
        The levels that it may come with, the gravest first.
    title : str
        What happened, as a headline.
    meaning : str
        What follows from it for the numbers.
    action : str
        What to do.
    """

    levels: tuple[Level, ...]
    title: str
    meaning: str
    action: str
