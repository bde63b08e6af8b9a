"""Patterns such as ``{subject}/{strategy}*.c3d``, which find person and strategy in the path of a recording."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
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
COMMON_PATTERNS = (*_FLAT, *_BY_STRATEGY, *_PLAIN, "{subject}/**/*", _ONE_PERSON, "**/{subject}/{strategy}*")
"""The common patterns, in the order in which they are tried."""
_PERSON = re.compile(
    r"(?<![^\W_])(subject|subj|sub|participant|person|patient|pat|pt|proband|vp|id|p|s)([\s_.-]?)(\d+)(?![^\W_])",
    re.IGNORECASE,
)
"""Words that are a person only together with the number that follows: subject_01, P 2, sub-03."""
_KEPT = str.maketrans("_-. ", "\ue000\ue001\ue002\ue003")
_RESTORED = str.maketrans("\ue000\ue001\ue002\ue003", "_-. ")
"""Signs between such a word and its number, which a pattern must not separate; private characters stand for them."""
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
    above: str = ""  # folders above the person that the pattern does not name


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
        self._below_any = text.partition("{subject}")[0].strip("*/") == ""
        self._has_ending = bool(re.search(r"\.\w+$", text))

    def match(self, path: PurePosixPath) -> PathLabels | None:
        """Return person and strategy of a path; None if the pattern does not fit."""
        whole = str(path) if self._has_ending else str(path.with_suffix(""))
        joined = _PERSON.sub(lambda found: found[1] + found[2].translate(_KEPT) + found[3], whole)
        match = self._regex.fullmatch(joined)
        if match is None:
            return None
        groups = match.groupdict()
        subject, text = groups.get("subject", ""), groups.get("strategy")
        above = joined[: match.start("subject")] if self._has_subject and self._below_any else ""
        subject = (_NUMBERED.sub("", subject) if self._numbered else subject).strip(" _-.")
        strategy = UNNAMED if text is None else _clean_strategy(PurePosixPath(text).name, subject)
        if not self._has_subject and strategy in _COUNTERS:
            strategy = UNNAMED  # of names such as trial1
        if bool(subject) != self._has_subject or not strategy:
            return None
        return PathLabels(subject.translate(_RESTORED), strategy, above.translate(_RESTORED).strip("/"))


def find_mixed_people(labels: Mapping[PurePosixPath, PathLabels]) -> dict[str, tuple[str, ...]]:
    """Return the names of people under which the paths name several people, with the latter.

    Examples
    --------
    >>> find_mixed_people({PurePosixPath(f"a/p{k}/normal.c3d"): PathLabels("a", "normal") for k in (1, 2)})
    {'a': ('p1', 'p2')}
    """
    found: dict[str, dict[str, str]] = {}
    for path, label in labels.items():
        person = next(filter(None, map(_PERSON.search, path.with_suffix("").parts)), None)
        if person is not None:
            found.setdefault(label.subject, {}).setdefault(f"{person[1]}{int(person[3])}".casefold(), person[0])
    return {subject: tuple(people.values()) for subject, people in found.items() if len(people) > 1}


def choose_pattern(paths: Sequence[PurePosixPath]) -> Pattern:
    """Return the common pattern with the highest rating for these paths; of equal ratings, the first pattern."""
    return max(map(Pattern, COMMON_PATTERNS), key=lambda pattern: _rate(pattern, paths))


def _rate(pattern: Pattern, paths: Sequence[PurePosixPath]) -> float:
    """Return the rating of a pattern: the fraction of paths that fit.

    The rating is halved for the two most general patterns, and 0 if the labels are wrong.
    """
    matched = {path: label for path in paths if (label := pattern.match(path)) is not None}
    labels = [*matched.values()]
    if find_mixed_people(matched):
        return 0.0
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
