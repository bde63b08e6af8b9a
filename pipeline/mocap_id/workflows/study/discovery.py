"""The recordings of a study, found in a folder and its sub-folders.

These are C3D files, text files with markers (and their MOT files), and skeletons. Recordings that are not used are
listed with the reason.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from mocap_id.errors import ConfigError, RecordingError
from mocap_id.plain_files import suggest
from mocap_id.recording import is_marker_text
from mocap_id.recording.mot_plates import find_force_columns
from mocap_id.recording.text_tables import read_table
from mocap_id.workflows.study.patterns import COMMON_PATTERNS, PathLabels, Pattern, choose_pattern, find_mixed_people
from mocap_id.workflows.study.reaches import Reach, find_session, read_reach

_RECORDINGS = (".c3d", ".trc")
_EXPORTS = (".tsv", ".csv", ".txt")  # many other files have these endings, so the first lines decide
_FORCE_SUFFIXES = ("", "_grf", "_forces", "_force", "-grf", "-forces", "_grfs")  # between a TRC file's name and .mot
_NO_TRIAL = re.compile(r"(^|[\W_])(static|cal|calib|calibration|t-?pose|anatomical|zero)([\W_\d]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class FoundRecording:
    """One recording with its labels in the study."""

    trial: str  # id of the trial
    subject: str  # id of the person
    name: str  # name of the person in the folder
    strategy: str  # strategy of the movement; empty for a reach
    markers: Path  # file with the markers or the skeleton
    forces: Path | None  # MOT file with the forces; None if there is none
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
        """Whether the recordings are of reaches."""
        return bool(self.trials[0].side)

    @property
    def names(self) -> Mapping[str, str]:
        """Name of each person in the folder, by id."""
        return {trial.subject: trial.name for trial in self.trials}


def discover(
    folder: Path, pattern: str | None = None, *, keep_names: bool = False, known: Mapping[str, str] | None = None
) -> Discovery:
    """Return the recordings in a folder and its sub-folders, and the reasons why files were left out.

    Parameters
    ----------
    folder : Path
    pattern : str, optional
        Text of a :class:`mocap_id.workflows.study.patterns.Pattern`; by default, the common pattern that fits best.
    keep_names : bool
        Use the names in the folder as ids, instead of s01, s02 …
    known : mapping of str to str, optional
        Existing ids by name; these people keep their ids.

    Raises
    ------
    ConfigError
        There is no such folder, it contains no recording, or no recording fits the pattern.
    """
    if not folder.is_dir():
        raise ConfigError(
            f"{folder}: no such folder; expected a folder with the recordings of a study{suggest(folder)}"
        )
    files = sorted(
        (path for path in folder.rglob("*") if path.is_file() and not _is_hidden(path, folder)), key=_sort_key
    )
    recordings, left_out = _find_recordings(files)
    reaches = _find_reaches(recordings, files, left_out)
    paths = {
        path: PurePosixPath(path.relative_to(folder).as_posix()) for path in recordings if path not in left_out
    }  # relative to the folder
    if not paths:
        raise ConfigError(
            f"{folder}: the folder contains no recording; expected C3D files, TRC files with their MOT, exports of "
            "QTM, Motive or Nexus, or skeletons of a depth camera or of markerless software (CSV, TRC)"
        )
    chosen = Pattern(pattern) if pattern is not None else choose_pattern(list(paths.values()))
    labels = _read_labels(folder, paths, chosen, left_out, given=pattern is not None)
    ids = _make_ids([label.subject for label in labels.values()], keep_names, known or {})
    trials = _make_trials(labels, {path: reaches[path] for path in labels if path in reaches}, paths, ids, files)
    trials.sort(key=lambda trial: (_sort_key(trial.subject), trial.subject))
    named = {paths[path]: label for path, label in labels.items()}
    doubts = tuple(f"{ids[subject]} may stand for several people: {why}" for subject, why in _doubt_people(named))
    return Discovery(chosen.text, tuple(trials), left_out, doubts, () if pattern is not None else COMMON_PATTERNS)


def _doubt_people(labels: Mapping[PurePosixPath, PathLabels]) -> Iterator[tuple[str, str]]:
    """Yield the names of people whose recordings may be of several people, each with the reason."""
    advice = "If so, give the position of the names with --pattern, or correct the ids in the file"
    for subject, people in find_mixed_people(labels).items():
        yield subject, f"the paths of its recordings contain {', '.join(people)}. {advice}"
    above: dict[str, dict[str, None]] = {}
    for label in labels.values():
        above.setdefault(label.subject, {})[label.above] = None
    for subject, folders in above.items():
        if len(folders) > 1:
            yield subject, f"{subject} is a name in the folders {', '.join(folders)}. {advice}"


def _find_recordings(files: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Return the recordings that may be trials, and the reasons why other recordings are certainly not, by file."""
    recordings, left_out = [], {}
    c3d = {path.with_suffix("") for path in files if path.suffix.lower() == ".c3d"}
    for path in files:
        ending = path.suffix.lower()
        if ending not in _RECORDINGS and not (ending in _EXPORTS and (is_marker_text(path) or _is_skeleton(path))):
            continue
        if _NO_TRIAL.search(path.stem):
            left_out[path] = "the name is that of a static or calibration trial"
        elif ending != ".c3d" and path.with_suffix("") in c3d:
            left_out[path] = "the C3D file with the same name is used"
        else:
            recordings.append(path)
    return recordings, left_out


def _is_skeleton(path: Path) -> bool:
    reach = read_reach(path, None)
    return reach is not None and reach.skeleton


def _find_reaches(recordings: Sequence[Path], files: Sequence[Path], left_out: dict[Path, str]) -> Mapping[Path, Reach]:
    """Return the recordings of reaches by file if they are the majority, or else an empty mapping.

    The recordings of the minority are added to ``left_out``.
    """
    found = {path: read_reach(path, find_forces(path, files)) for path in recordings}
    reaches = {path: reach for path, reach in found.items() if reach is not None}
    if 2 * len(reaches) > len(recordings):
        left_out |= dict.fromkeys(found.keys() - reaches.keys(), "not a reach: no markers of an arm and no skeleton")
        return reaches
    left_out |= dict.fromkeys(reaches, "a reach, which needs a separate study: an arm or a skeleton, no force plate")
    return {}


def _read_labels(
    folder: Path, paths: Mapping[Path, PurePosixPath], pattern: Pattern, left_out: dict[Path, str], *, given: bool
) -> dict[Path, PathLabels]:
    """Return person and strategy of each recording that fits the pattern; add the other recordings to ``left_out``."""
    matches = {path: pattern.match(relative) for path, relative in paths.items()}
    left_out |= {path: f"does not fit the pattern {pattern.text}" for path, match in matches.items() if match is None}
    labels = {path: match for path, match in matches.items() if match is not None}
    if not labels:
        expected = f"the pattern {pattern.text}" if given else f"one of the patterns {', '.join(COMMON_PATTERNS)}"
        raise ConfigError(
            f"{folder}: none of the {len(paths)} recordings fits {expected}; an example is "
            f"{next(iter(paths.values()))}. Give the position of the names: --pattern '{{subject}}/{{strategy}}*', or "
            "'{strategy}*' for one person"
        )
    person = folder.resolve().name or "person"  # used if the pattern has no {subject}
    return {path: label if label.subject else PathLabels(person, label.strategy) for path, label in labels.items()}


def _make_trials(
    labels: Mapping[Path, PathLabels],
    reaches: Mapping[Path, Reach],
    paths: Mapping[Path, PurePosixPath],
    ids: Mapping[str, str],
    files: Sequence[Path],
) -> list[FoundRecording]:
    """Return the trials of the recordings; a reach with both arms becomes one trial for each arm."""
    counts: Counter[str] = Counter()

    def name_trial(*words: str) -> str:
        stem = "-".join(filter(None, words))
        counts[stem] += 1
        return f"{stem}-{counts[stem]}"

    trials = []
    for path, label in labels.items():
        name, subject, reach = label.subject, ids[label.subject], reaches.get(path)
        if reach is None:
            trial, forces = name_trial(subject, label.strategy), find_forces(path, files)
            trials.append(FoundRecording(trial, subject, name, label.strategy, path, forces))
            continue
        session = find_session(paths[path])
        for side in reach.choose_sides(paths[path]):
            trial = name_trial(subject, session, side)
            trials.append(FoundRecording(trial, subject, name, "", path, None, side, session, reach.skeleton))
    return trials


def find_forces(markers: Path, files: Iterable[Path]) -> Path | None:
    """Return the MOT file that belongs to a text file with markers; None if there is no such MOT file."""
    if markers.suffix.lower() == ".c3d":
        return None
    stems = [_fold(f"{markers.stem}{suffix}") for suffix in _FORCE_SUFFIXES]
    beside = [path for path in files if path.parent == markers.parent and path.suffix.lower() == ".mot"]
    fitting = sorted(path for path in beside if _fold(path.stem) in stems)
    fitting.sort(key=lambda path: stems.index(_fold(path.stem)))
    # A MOT file with the same name may also contain joint angles.
    return next((path for path in fitting if _fold(path.stem) != stems[0] or _has_forces(path)), None)


def _has_forces(path: Path) -> bool:
    """Return whether a table has ground forces; also True for an unreadable file, whose reader reports the error."""
    try:
        table = read_table(path)
    except RecordingError:
        return True
    try:
        return bool(find_force_columns(path, table))
    except RecordingError:
        return False


def _fold(name: str) -> str:
    """Return a name without the differences of capital letters and of the encoding of accents."""
    return unicodedata.normalize("NFC", name).casefold()


def _make_ids(names: Iterable[str], keep_names: bool, known: Mapping[str, str]) -> dict[str, str]:
    """Return the id of each person by name: the known ids, and new ids s01, s02 … or derived from the names."""
    ordered = sorted(dict.fromkeys(names), key=_sort_key)
    if keep_names:
        ids = {name: re.sub(r"[^\w.+-]+", "-", name).strip("-.+") for name in ordered}
        twice = sorted(name for name, count in Counter(ids.values()).items() if count > 1 or not name)
        if twice:
            raise ConfigError(
                f"--keep-names: several folders give the id `{twice[0]}`: rename one of them, or leave out the option"
            )
        return ids
    taken, number = set(known.values()), 0
    ids = {name: known[name] for name in ordered if name in known}
    for name in ordered:
        while name not in ids:
            number += 1
            candidate = f"s{number:02d}"
            if candidate not in taken:
                ids[name] = candidate
    return ids


def _is_hidden(path: Path, folder: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(folder).parts)


def _sort_key(path: Path | str) -> tuple[tuple[int, int | str], ...]:
    """Return a sort key that puts 2 before 10."""
    parts = re.split(r"(\d+)", str(path).casefold())
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in parts)
