"""Patterns such as ``{subject}/{strategy}*.c3d``, which find person and strategy in the path of a recording."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from mocap_id.errors import ConfigError

UNNAMED = "movement"
"""The strategy if a pattern has no ``{strategy}``."""
_STRATEGY_WORDS = re.compile(
    "normal|natural|comfort|self|select|prefer|usual|dynamic|momentum|fast|quick|stab|slow|forced"
)
"""Words for strategies; they distinguish folders named after strategies from folders named after people."""
_COUNTERS = ("trial", "take", "rep", "repetition", "run", "test", "t", "r", "n")
"""Words before the number of a trial, which do not belong to the strategy."""
_NUMBERED = re.compile(rf"[\s_.-]+(?:{'|'.join(_COUNTERS)})?[\s_.-]*\d+$", re.IGNORECASE)
_LEVEL = re.compile("(session|ses|visit|day|data|raw|recordings?|c3d|trc|mocap|markers|export)(-.*)?")
"""Folders between a person and the recordings, which are not strategies."""
_PLAIN = ("{subject}/{strategy}*", "{subject}/{strategy}/*", "{subject}/**/{strategy}*")
_BY_STRATEGY = ("{strategy}/{subject}*", "{strategy}/{subject}/*")
_FLAT = ("{subject}_{strategy}*", "{subject}-{strategy}*", "{subject} {strategy}*")
_ONE_PERSON = "{strategy}*"
COMMON_PATTERNS = (*_FLAT, *_BY_STRATEGY, *_PLAIN, "{subject}/**/*", _ONE_PERSON)
"""The common patterns, in the order in which they are tried."""
_PIECES = {
    "{subject}": r"(?P<subject>[^/]+?)",
    "{strategy}": r"(?P<strategy>[^/]*[^\W\d_][^/]*?)",
    "**/": r"(?:[^/]+/)*",
    "*": r"[^/]*",
}


@dataclass(frozen=True)
class PathLabels:
    """Person and strategy of a recording, read from its path."""

    subject: str  # name of the person in the path; empty if the pattern has no ``{subject}``
    strategy: str  # words joined by hyphens


class Pattern:
    """A path pattern, relative to the folder with the recordings.

    ``{subject}``, ``{strategy}`` and ``*`` match a part of one name, and ``**/`` matches any number of folders. A
    pattern with an ending (``*.c3d``) fits only this ending; a pattern without an ending fits any recording.

    Raises
    ------
    ConfigError
        The text has neither ``{subject}`` nor ``{strategy}``, has one of them twice, or has another name in braces.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        unknown = set(re.findall(r"\{[^}]*\}?", text)) - {"{subject}", "{strategy}"}
        people, strategies = text.count("{subject}"), text.count("{strategy}")
        if unknown or people > 1 or strategies > 1 or not people + strategies:
            raise ConfigError(
                f"--pattern {text}: expected {{subject}}, {{strategy}} or both, each at most once, and no other name "
                "in braces, such as '{subject}/{strategy}*.c3d', or '{strategy}*' for one person"
            )
        pieces = re.split(r"(\{subject\}|\{strategy\}|\*\*/|\*)", text)
        # A name before * takes as many characters as it can; its number is removed later.
        source = "".join(_PIECES.get(piece, re.escape(piece)) for piece in pieces)
        greedy = source.replace("+?)[^/]*", "+)[^/]*").replace("*?)[^/]*", "*)[^/]*")
        self._regex = re.compile(greedy, re.IGNORECASE)
        self._numbered = "{subject}*" in text
        self._has_subject = people > 0
        self._has_ending = bool(re.search(r"\.\w+$", text))

    def match(self, path: PurePosixPath) -> PathLabels | None:
        """Return person and strategy of a path; None if the pattern does not fit."""
        match = self._regex.fullmatch(str(path) if self._has_ending else str(path.with_suffix("")))
        if match is None:
            return None
        groups = match.groupdict()
        subject, text = groups.get("subject", ""), groups.get("strategy")
        subject = (_NUMBERED.sub("", subject) if self._numbered else subject).strip(" _-.")
        strategy = UNNAMED if text is None else _clean_strategy(PurePosixPath(text).name, subject)
        if not self._has_subject and strategy in _COUNTERS:
            strategy = UNNAMED  # of names such as trial1
        return PathLabels(subject, strategy) if bool(subject) == self._has_subject and strategy else None


def choose_pattern(paths: Sequence[PurePosixPath]) -> Pattern:
    """Return the common pattern with the highest rating for these paths; of equal ratings, the first pattern."""
    return max(map(Pattern, COMMON_PATTERNS), key=lambda pattern: _rate(pattern, paths))


def _rate(pattern: Pattern, paths: Sequence[PurePosixPath]) -> float:
    """Return the rating of a pattern: the fraction of paths that fit.

    The rating is halved for the two most general patterns, and 0 if the labels are wrong.
    """
    labels = [label for label in map(pattern.match, paths) if label is not None]
    if pattern.text in _BY_STRATEGY and any(not _is_strategy(label.strategy) for label in labels):
        return 0.0
    if any(_LEVEL.fullmatch(label.strategy) for label in labels):
        return 0.0
    if pattern.text in _FLAT and all(_is_strategy(label.subject.casefold()) for label in labels):
        return 0.0  # names such as slow_trial1, of one person
    share = len(labels) / max(len(paths), 1)
    return share if "{strategy}" in pattern.text and pattern.text != _ONE_PERSON else share / 2


def _is_strategy(text: str) -> bool:
    return any(_STRATEGY_WORDS.match(word) for word in text.split("-"))


def _clean_strategy(text: str, subject: str) -> str:
    """Return the words of a strategy joined by hyphens, without the person's name and the trial's number."""
    if text.casefold().startswith(subject.casefold()) and text.casefold() != subject.casefold():
        text = text[len(subject) :]
    words = [word.lower() for word in re.findall(r"[^\W\d_]+|\d+", text)]
    while words and (words[-1].isdigit() or words[-1] in _COUNTERS) and len(words) > 1:
        words.pop()
    return "-".join(words)[:40] if words and not words[-1].isdigit() else ""
