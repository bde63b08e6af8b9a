"""The data class of an explanation."""

from __future__ import annotations

from dataclasses import dataclass

from mocap_id.verdict import Level


@dataclass(frozen=True)
class Explanation:
    """Explanation of one reason code.

    Parameters
    ----------
    levels : tuple of str
        Levels at which the code can occur, most severe first.
    title : str
        Headline.
    meaning : str
        Consequences for the results.
    action : str
        What to do.
    stage : str
        Stage or command that checks this.
    criterion : str
        Measured quantity and limit. Limits without a setting are constants in the code.
    """

    levels: tuple[Level, ...]
    title: str
    meaning: str
    action: str
    stage: str
    criterion: str
