"""The recordings of a study, found in a folder and its sub-folders, and a first version of the study's file.

Recordings are C3D files, text files with markers (and their MOT files), and skeletons. Recordings that are not used are
listed with the reason. From top to bottom: patterns such as ``{subject}/{strategy}*.c3d``, which find person and
strategy in the path of a recording; recordings of reaches; the search; the file, and a file beside it with the people's
names and ids.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PurePosixPath

from mocap_id import recording
from mocap_id.anatomy.landmarks import ARM, Side, find_landmarks, find_roles
from mocap_id.errors import ConfigError, RecordingError, StoreError
from mocap_id.plain_files import suggest
from mocap_id.protocols.movement import recognise_movement
from mocap_id.recording import is_marker_text
from mocap_id.recording.model import Recording
from mocap_id.recording.sensor_logs import find_force_columns
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.recording.text_tables import read_table
from mocap_id.store.atomic import write_files

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
        strategy = UNNAMED
        if text is not None:
            # The words joined by hyphens, without the person's name and the trial's number.
            text = PurePosixPath(text).name
            if text.casefold().startswith(subject.casefold()) and text.casefold() != subject.casefold():
                text = text[len(subject) :]
            words = [word.lower() for word in re.findall(r"[^\W\d_]+|\d+", text)]
            while words and (words[-1].isdigit() or words[-1] in _COUNTERS) and len(words) > 1:
                words.pop()
            strategy = "-".join(words)[:40] if words and not words[-1].isdigit() else ""
        if not self._has_subject and strategy in _COUNTERS:
            strategy = UNNAMED  # of names such as trial1
        if bool(subject) != self._has_subject or not strategy:
            return None
        return PathLabels(subject.translate(_RESTORED), strategy, above.translate(_RESTORED).strip("/"))


def find_mixed_people(labels: Mapping[PurePosixPath, PathLabels]) -> dict[str, tuple[str, ...]]:
    """Return the names of people under which the paths name several people, with the latter.

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
    """Return the common pattern with the highest rating for these paths; of equal ratings, the first pattern.

    The rating is the fraction of paths that fit. It is halved for the two most general patterns, and 0 if the labels
    are wrong.
    """

    def rate(pattern: Pattern) -> float:
        matched = {path: label for path in paths if (label := pattern.match(path)) is not None}
        labels = [*matched.values()]
        people = pattern.text in _FLAT and all(_is_strategy(label.subject.casefold()) for label in labels)
        strategies = pattern.text in _BY_STRATEGY and any(not _is_strategy(label.strategy) for label in labels)
        levels = any(_LEVEL.fullmatch(label.strategy) for label in labels)
        if find_mixed_people(matched) or strategies or levels or people:  # people: such as slow_trial1, of one person
            return 0.0
        share = len(labels) / max(len(paths), 1)
        return share if "{strategy}" in pattern.text and pattern.text != _ONE_PERSON else share / 2

    return max(map(Pattern, COMMON_PATTERNS), key=rate)


def _is_strategy(text: str) -> bool:
    return any(_STRATEGY_WORDS.match(word) for word in text.split("-"))


_LANDMARKS = {"EL", "EM", "US", "RS"}
_SIDES: dict[Side, tuple[str, ...]] = {"right": ("right", "r"), "left": ("left", "l")}
_JOINTS = 0.4  # least share of the labels that name joints in a skeleton; MediaPipe adds eyes, ears and fingers
_OF_THE_BODY = ("sit-to-stand", "walking", "jumping")  # movements that are no reach, though the markers name an arm
_SESSION = re.compile(r"(?<![^\W_])(session|ses|visit|day)[\W_]*(\d+)", re.IGNORECASE)


def choose_sides(sides: tuple[str, ...], path: PurePosixPath) -> tuple[str, ...]:
    """Return the sides to analyse: the side that the path names, or else all ``sides`` of the recording."""
    words = re.findall(r"[^\W\d_]+", str(path.with_suffix("")).lower())
    named = tuple(side for side, names in _SIDES.items() if set(names) & set(words))
    return named if len(named) == 1 else sides or ("right",)


def read_reach(path: Path, forces: Path | None) -> tuple[bool, tuple[str, ...]] | None:
    """Return whether a recording of reaches is a skeleton, and the sides of its arms (none if the labels have no side).

    None if the recording is not a reach, or cannot be read.
    """
    if forces is not None:
        return None
    skeleton = read_joints(path)
    if skeleton is not None:
        return True, _find_arms(skeleton.labels)
    try:
        content = recording.read(path)
    except (RecordingError, ConfigError):
        return None
    landmarks = find_landmarks(content.labels)
    if content.plates or not set(landmarks.markers) >= _LANDMARKS:
        return None
    seen = recording.ThinnedFrames.of(content.positions, content.time, content.rate)
    if recognise_movement(content.labels, seen.positions, seen.rate)[0] in _OF_THE_BODY:
        return None
    return False, () if landmarks.side is None else (landmarks.side,)


def read_joints(path: Path) -> Recording | None:
    """Return the joint positions in a recording of a skeleton with an arm; None if it has none, or cannot be read."""
    if path.suffix.lower() == ".c3d":
        return None
    try:
        content = read_skeleton(path).recording
    except (RecordingError, ConfigError):
        return None
    return content if _find_arms(content.labels) else None


def _find_arms(labels: Sequence[str]) -> tuple[Side, ...]:
    """Return the sides of the arms among the joints of a skeleton; none if most labels are those of markers."""
    roles = {side: find_roles(labels, side) for side in _SIDES}
    joints = {number for found in roles.values() for number in found.values()}
    if len(joints) < _JOINTS * len(labels):
        return ()
    return tuple(side for side, found in roles.items() if {"near_shoulder", *ARM[:2]} <= found.keys())


def find_session(path: PurePosixPath) -> str:
    """Return the session that a path names, such as ``session1``; empty if the path names no session.

    >>> find_session(PurePosixPath("anna/Visit_02/left.csv"))
    'visit2'
    """
    match = _SESSION.search(str(path))
    return f"{match[1].lower()}{int(match[2])}" if match else ""


_RECORDINGS = (".c3d", ".trc")
_EXPORTS = (".tsv", ".csv", ".txt")  # many other files have these endings, so the first lines decide
_FORCE_SUFFIXES = ("", "_grf", "_forces", "_force", "-grf", "-forces", "_grfs")  # between a TRC file's name and .mot
_NO_TRIAL = re.compile(r"(^|[\W_])(static|cal|calib|calibration|t-?pose|anatomical|zero)([\W_\d]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class FoundRecording:
    """One recording with its labels in the study."""

    trial: str  # id
    subject: str  # id of the person
    name: str  # name of the person in the folder
    strategy: str  # empty for a reach
    markers: Path  # file with the markers or the skeleton
    forces: Path | None  # MOT file with the forces
    side: str = ""  # side of a reach
    session: str = ""  # session of a reach; empty if the path does not name one
    skeleton: bool = False  # whether the file contains a skeleton instead of markers


@dataclass(frozen=True)
class Discovery:
    """The recordings found in a folder."""

    pattern: str  # the path pattern that was used
    trials: tuple[FoundRecording, ...]
    left_out: Mapping[Path, str]  # reason for each file that is not used
    doubts: tuple[str, ...] = ()  # why an id may stand for two people
    tried: tuple[str, ...] = ()  # the patterns that were compared; empty if the user gave a pattern

    @property
    def reach(self) -> bool:
        return bool(self.trials[0].side)

    @property
    def names(self) -> Mapping[str, str]:
        """Name of each person in the folder, by id."""
        return {trial.subject: trial.name for trial in self.trials}


def discover(
    folder: Path, pattern: str | None = None, *, keep_names: bool = False, known: Mapping[str, str] | None = None
) -> Discovery:
    """Return the recordings in a folder and its sub-folders, and the reasons why files were left out.

    ``pattern`` is the text of a :class:`Pattern`; by default, the common pattern that fits best. With ``keep_names``,
    the names in the folder are the ids, instead of s01, s02 … People with ids ``known`` by name keep these ids.
    """
    if not folder.is_dir():
        raise ConfigError(
            f"{folder}: no such folder; expected a folder with the recordings of a study{suggest(folder)}"
        )
    # Hidden files are no recordings; 2 comes before 10.
    files = [path for path in folder.rglob("*") if path.is_file()]
    files = [path for path in files if not any(part.startswith(".") for part in path.relative_to(folder).parts)]
    files.sort(key=_sort_key)
    # Recordings that may be trials, and the reasons why other recordings are certainly not.
    recordings, left_out = list[Path](), dict[Path, str]()
    c3d = {path.with_suffix("") for path in files if path.suffix.lower() == ".c3d"}
    for path in files:
        ending = path.suffix.lower()
        is_export = ending in _EXPORTS and (is_marker_text(path) or read_joints(path) is not None)
        if ending not in _RECORDINGS and not is_export:
            continue
        if _NO_TRIAL.search(path.stem):
            left_out[path] = "the name is that of a static or calibration trial"
        elif ending != ".c3d" and path.with_suffix("") in c3d:
            left_out[path] = "the C3D file with the same name is used"
        else:
            recordings.append(path)
    # Recordings of reaches and others need separate studies: the majority decides.
    found = {path: read_reach(path, find_forces(path, files)) for path in recordings}
    reaches = {path: reach for path, reach in found.items() if reach is not None}
    if 2 * len(reaches) > len(recordings):
        left_out |= dict.fromkeys(found.keys() - reaches.keys(), "not a reach: no markers of an arm and no skeleton")
    else:
        left_out |= dict.fromkeys(
            reaches, "a reach, which needs a separate study: an arm or a skeleton, no force plate"
        )
        reaches = {}
    paths = {
        path: PurePosixPath(path.relative_to(folder).as_posix()) for path in recordings if path not in left_out
    }  # relative to the folder
    if not paths:
        raise ConfigError(
            f"{folder}: the folder contains no recording; expected C3D files, TRC files with their MOT, exports of "
            "QTM, Motive or Nexus, or skeletons of a depth camera or of markerless software (CSV, TRC)"
        )
    # Person and strategy of each recording that fits the pattern.
    chosen = Pattern(pattern) if pattern is not None else choose_pattern(list(paths.values()))
    matches = {path: chosen.match(relative) for path, relative in paths.items()}
    left_out |= {path: f"does not fit the pattern {chosen.text}" for path, match in matches.items() if match is None}
    if all(match is None for match in matches.values()):
        common = f"one of the patterns {', '.join(COMMON_PATTERNS)}"
        tried = common if pattern is None else f"the pattern {chosen.text}"
        raise ConfigError(
            f"{folder}: none of the {len(paths)} recordings fits {tried}; an example is {next(iter(paths.values()))}. "
            "Give the position of the names: --pattern '{subject}/{strategy}*', or '{strategy}*' for one person"
        )
    person = folder.resolve().name or "person"  # used if the pattern has no {subject}
    labels = {
        path: match if match.subject else PathLabels(person, match.strategy)
        for path, match in matches.items()
        if match is not None
    }
    # The id of each person: derived from the name, or the known id, or a new id s01, s02 …
    people = sorted(dict.fromkeys(label.subject for label in labels.values()), key=_sort_key)
    if keep_names:
        ids = {name: re.sub(r"[^\w.+-]+", "-", name).strip("-.+") for name in people}
        twice = sorted(name for name, count in Counter(ids.values()).items() if count > 1 or not name)
        if twice:
            raise ConfigError(
                f"--keep-names: several folders give the id `{twice[0]}`: rename one of them, or leave out the option"
            )
    else:
        ids = {name: known[name] for name in people if known and name in known}
        taken = {*(known or {}).values()}
        free = (number for number in map("s{:02d}".format, count(1)) if number not in taken)
        ids |= {name: next(free) for name in people if name not in ids}
    # A reach with both arms becomes one trial for each arm.
    trials: list[FoundRecording] = []
    counts: Counter[str] = Counter()
    for path, label in labels.items():
        name, subject, reach = label.subject, ids[label.subject], reaches.get(path)
        session = "" if reach is None else find_session(paths[path])
        for side in ("",) if reach is None else choose_sides(reach[1], paths[path]):
            stem = "-".join(filter(None, (subject, label.strategy) if reach is None else (subject, session, side)))
            counts[stem] += 1
            trial = f"{stem}-{counts[stem]}"
            if reach is None:
                trials.append(FoundRecording(trial, subject, name, label.strategy, path, find_forces(path, files)))
            else:
                trials.append(FoundRecording(trial, subject, name, "", path, None, side, session, reach[0]))
    trials.sort(key=lambda trial: (_sort_key(trial.subject), trial.subject))
    # Ids that may stand for several people.
    advice = "If so, give the position of the names with --pattern, or correct the ids in the file"
    mixed = find_mixed_people({paths[path]: label for path, label in labels.items()})
    doubts = [(name, f"the paths of its recordings contain {', '.join(people)}") for name, people in mixed.items()]
    above: dict[str, dict[str, None]] = {}
    for label in labels.values():
        above.setdefault(label.subject, {})[label.above] = None
    shared = {name: folders for name, folders in above.items() if len(folders) > 1}
    doubts += [(name, f"{name} is a name in the folders {', '.join(folders)}") for name, folders in shared.items()]
    sentences = tuple(f"{ids[subject]} may stand for several people: {why}. {advice}" for subject, why in doubts)
    return Discovery(chosen.text, tuple(trials), left_out, sentences, () if pattern is not None else COMMON_PATTERNS)


def find_forces(markers: Path, files: Iterable[Path]) -> Path | None:
    """Return the MOT file that belongs to a text file with markers; None if there is no such MOT file."""
    if markers.suffix.lower() == ".c3d":
        return None
    stems = [_fold(f"{markers.stem}{suffix}") for suffix in _FORCE_SUFFIXES]
    beside = [path for path in files if path.parent == markers.parent and path.suffix.lower() == ".mot"]
    fitting = sorted(path for path in beside if _fold(path.stem) in stems)
    fitting.sort(key=lambda path: stems.index(_fold(path.stem)))

    def has_forces(path: Path) -> bool:
        try:
            table = read_table(path)
        except RecordingError:  # its reader reports the error
            return True
        try:
            return bool(find_force_columns(path, table))
        except RecordingError:
            return False

    # A MOT file with the same name may also contain joint angles.
    return next((path for path in fitting if _fold(path.stem) != stems[0] or has_forces(path)), None)


def _fold(name: str) -> str:
    """Return a name without the differences of capital letters and of the encoding of accents."""
    return unicodedata.normalize("NFC", name).casefold()


def _sort_key(path: Path | str) -> tuple[tuple[int, int | str], ...]:
    """Return a sort key that puts 2 before 10."""
    parts = re.split(r"(\d+)", str(path).casefold())
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in parts)


SUBJECTS_FILE = "subjects.csv"
_PLAIN_SIGNS = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./-")
_HEAD = """\
# Made by `mocap-id init`; edit it as you like. Paths are relative to this file. Next: fill in what you know about the
# people (everything is optional), then run `mocap-id study {file}`.
"""
_SIT_TO_STAND = (
    "sit-to-stand",
    "{protocol: sit-to-stand}",
    "{height: 1.75, mass: 70.1, sex: female, landmarks_m: {shank: 0.41, thigh: 0.40}}, m and kg",
)
_REACH = ("reach", "{space: 3d, protocol: reach}", "{score: 2}, a clinical score such as Brooke's")


def write_draft(found: Discovery, file: Path, *, keep_names: bool = False, force: bool = False) -> list[Path]:
    """Write a study's file and, unless ``keep_names``, the file with names and ids; return the written paths.

    StoreError is raised if a file exists already, unless ``force``.
    """
    folder = file.absolute().parent

    def quote_path(path: Path) -> str:
        return _quote(Path(os.path.relpath(path.absolute(), folder)).as_posix())

    name, defaults, person = _REACH if found.reach else _SIT_TO_STAND
    lines = [
        _HEAD.format(file=file.name),
        f"study: {name}",
        "out: runs  # folder of the results",
        f"defaults: {defaults}  # keys of a trial's file, for all trials",
        f"subjects:  # each {person}",
        *(f"  {_quote(subject)}: {{}}" for subject in found.names),
        "trials:",
    ]
    for trial in found.trials:
        recorded = quote_path(trial.markers)
        if trial.forces is not None:
            recorded = f"{{markers: {recorded}, forces: {quote_path(trial.forces)}}}"
        elif trial.skeleton:
            recorded = f"{{skeleton: {recorded}}}"
        labels = {key: getattr(trial, key) for key in ("trial", "subject", "strategy", "session", "side")}
        keys = ", ".join(f"{key}: {_quote(value)}" for key, value in labels.items() if value)
        lines.append(f"  - {{{keys}, recording: {recorded}}}")
    contents = {file.name: ("\n".join(lines) + "\n").encode()}
    if not keep_names:
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows([("id", "name"), *found.names.items()])
        contents[SUBJECTS_FILE] = stream.getvalue().encode()
    existing = [file.parent / name for name in contents if (file.parent / name).exists()]
    if existing and not force:
        raise StoreError(
            f"{existing[0]} exists already: choose a different file with --out, or overwrite it with --force"
        )
    write_files(file.parent, contents)
    return [file.parent / name for name in contents]


def read_known_ids(file: Path) -> dict[str, str]:
    """Return the ids by name from subjects.csv in the folder of a study's file; empty if there is no subjects.csv."""
    subjects = file.parent / SUBJECTS_FILE
    try:
        rows = csv.DictReader(io.StringIO(subjects.read_text("utf-8")))
        return {row["name"]: row["id"] for row in rows}
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, KeyError, csv.Error) as error:
        raise ConfigError(
            f"{subjects} cannot be read ({type(error).__name__}); expected a CSV file with the columns id and name"
        ) from error


def _quote(text: str) -> str:
    """Return ``text``, quoted if YAML would not read it as text."""
    plain = (
        set(text) <= _PLAIN_SIGNS and text[:1].isalpha() and text.lower() not in ("yes", "no", "true", "false", "null")
    )
    return text if plain else json.dumps(text, ensure_ascii=False)
