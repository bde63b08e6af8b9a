"""The recordings in a folder: C3D files, text files with their MOT, skeletons. Others are listed with the reason."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from mocap_id.errors import ConfigError
from mocap_id.recording import is_marker_text
from mocap_id.workflows.study.patterns import DEFAULTS, Pattern, Place, default
from mocap_id.workflows.study.reaches import FoundReach, find_reach, find_session

_ENDINGS = (".c3d", ".trc")
_EXPORTS = (".tsv", ".csv", ".txt")  # many other files end so: their first lines decide
_FORCES = ("", "_grf", "_forces", "_force", "-grf", "-forces", "_grfs")  # between a TRC file's name and .mot
_NO_TRIAL = re.compile(r"(^|[\W_])(static|cal|calib|calibration|t-?pose|anatomical|zero)([\W_\d]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class FoundRecording:
    """One recording and its place in the study."""

    trial: str  # id in the study's file
    subject: str  # id in the study's file
    name: str  # name of the person in the folder
    strategy: str  # word in the study's file
    markers: Path  # or the skeleton
    forces: Path | None
    side: str = ""  # of a reach
    session: str = ""  # of a reach, if the path names one
    skeleton: bool = False


@dataclass(frozen=True)
class Discovery:
    """The recordings of a folder."""

    pattern: str  # the pattern that gave people and strategies
    trials: tuple[FoundRecording, ...]
    left_out: Mapping[Path, str]  # files that are not trials of the study, and why
    tried: tuple[str, ...] = ()  # the patterns that were compared; none if one was given

    @property
    def reach(self) -> bool:
        """Whether the recordings are of reaches."""
        return bool(self.trials[0].side)

    @property
    def names(self) -> Mapping[str, str]:
        """Name of each subject in the folder, by id."""
        return {trial.subject: trial.name for trial in self.trials}


def discover(
    folder: Path, pattern: str | None = None, *, keep_names: bool = False, known: Mapping[str, str] | None = None
) -> Discovery:
    """Find the recordings in a folder and its sub-folders.

    Parameters
    ----------
    folder : Path
    pattern : str, optional
        As :class:`mocap_id.workflows.study.patterns.Pattern`; by default the common pattern that fits best.
    keep_names : bool
        Use the names in the folder as ids, instead of s01, s02 …
    known : mapping of str to str, optional
        Existing ids by name.

    Raises
    ------
    ConfigError
        There is no such folder, it contains no recording, or the pattern fits none.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; expected a folder with the recordings of a study")
    files = sorted((path for path in folder.rglob("*") if path.is_file() and not _hidden(path, folder)), key=_natural)
    recordings, left_out = _recordings(files)
    reaches = _reaches(recordings, files, left_out)
    recordings = [path for path in recordings if path not in left_out]
    if not recordings:
        raise ConfigError(
            f"{folder}: it contains no recording; expected C3D files, TRC files with their MOT, exports of QTM, Motive "
            "or Nexus, or skeletons of a depth camera or of markerless software (CSV, TRC)"
        )
    places = {path: PurePosixPath(path.relative_to(folder).as_posix()) for path in recordings}
    chosen = Pattern(pattern) if pattern is not None else default(list(places.values()))
    places_of = {path: chosen.place(place) for path, place in places.items()}
    left_out |= {path: f"does not fit the pattern {chosen.text}" for path, place in places_of.items() if place is None}
    fitting = {path: place for path, place in places_of.items() if place is not None}
    if not fitting:
        wanted = f"the pattern {pattern}" if pattern is not None else f"one of the patterns {', '.join(DEFAULTS)}"
        raise ConfigError(
            f"{folder}: none of the {len(recordings)} recordings fits {wanted}, such as {next(iter(places.values()))}. "
            "Say where the names are: --pattern '{subject}/{strategy}*', or '{strategy}*' for one person"
        )
    person = folder.resolve().name or "person"  # if the pattern has no {subject}
    fitting = {path: place if place.subject else Place(person, place.strategy) for path, place in fitting.items()}
    ids = _ids([place.subject for place in fitting.values()], keep_names, known or {})
    trials = _trials(fitting, {path: reaches[path] for path in fitting if path in reaches}, places, ids, files)
    order = {subject: k for k, subject in enumerate(sorted({one.subject for one in trials}, key=_natural))}
    ordered = tuple(sorted(trials, key=lambda one: order[one.subject]))
    return Discovery(chosen.text, ordered, left_out, () if pattern is not None else DEFAULTS)


def _recordings(files: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Return files that may be trials, and files that are certainly not."""
    found, left_out = [], {}
    c3d = {path.with_suffix("") for path in files if path.suffix.lower() == ".c3d"}
    for path in files:
        ending = path.suffix.lower()
        if ending not in _ENDINGS and not (ending in _EXPORTS and (is_marker_text(path) or _is_skeleton(path))):
            continue
        if _NO_TRIAL.search(path.stem):
            left_out[path] = "a static or calibration trial, by its name"
        elif ending != ".c3d" and path.with_suffix("") in c3d:
            left_out[path] = "the C3D file of the same name is used"
        else:
            found.append(path)
    return found, left_out


def _is_skeleton(path: Path) -> bool:
    found = find_reach(path, None)
    return found is not None and found.skeleton


def _reaches(recordings: Sequence[Path], files: Sequence[Path], left_out: dict[Path, str]) -> Mapping[Path, FoundReach]:
    """Return the reaches, and leave out the fewer of reaches and others, which need a study of their own."""
    found = {path: find_reach(path, find_forces(path, files)) for path in recordings}
    reaches = {path: reach for path, reach in found.items() if reach is not None}
    if 2 * len(reaches) > len(recordings):
        left_out |= dict.fromkeys(found.keys() - reaches.keys(), "no markers of an arm and no skeleton: not a reach")
        return reaches
    left_out |= dict.fromkeys(reaches, "markers of an arm or a skeleton, no force plate: a reach, for another study")
    return {}


def _trials(
    fitting: Mapping[Path, Place],
    reaches: Mapping[Path, FoundReach],
    places: Mapping[Path, PurePosixPath],
    ids: Mapping[str, str],
    files: Sequence[Path],
) -> list[FoundRecording]:
    counted: Counter[str] = Counter()

    def number(*words: str) -> str:
        stem = "-".join(filter(None, words))
        counted[stem] += 1
        return f"{stem}-{counted[stem]}"

    trials = []
    for path, place in fitting.items():
        subject, reach = ids[place.subject], reaches.get(path)
        if reach is None:
            trial = number(subject, place.strategy)
            forces = find_forces(path, files)
            trials.append(FoundRecording(trial, subject, place.subject, place.strategy, path, forces))
            continue
        session = find_session(places[path])
        for side in reach.of(places[path]):
            trial = number(subject, session, side)
            found = FoundRecording(trial, subject, place.subject, "", path, None)
            trials.append(replace(found, side=side, session=session, skeleton=reach.skeleton))
    return trials


def find_forces(markers: Path, files: Iterable[Path]) -> Path | None:
    """Return the MOT file that belongs to a text file with markers."""
    if markers.suffix.lower() == ".c3d":
        return None
    stems = [f"{markers.stem}{extra}".casefold() for extra in _FORCES]
    beside = [path for path in files if path.parent == markers.parent and path.suffix.lower() == ".mot"]
    fitting = [path for path in beside if path.stem.casefold() in stems]
    return min(fitting, key=lambda path: stems.index(path.stem.casefold()), default=None)


def _ids(names: Iterable[str], keep: bool, known: Mapping[str, str]) -> dict[str, str]:
    """Return the ids by name."""
    ordered = sorted(dict.fromkeys(names), key=_natural)
    if keep:
        ids = {name: re.sub(r"[^\w.+-]+", "-", name).strip("-.+") for name in ordered}
        twice = sorted(name for name, count in Counter(ids.values()).items() if count > 1 or not name)
        if twice:
            raise ConfigError(
                f"--keep-names: several folders give the id `{twice[0]}`: rename one, or leave out the option"
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


def _hidden(path: Path, folder: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(folder).parts)


def _natural(path: Path | str) -> tuple[tuple[int, int | str], ...]:
    """Sort key that puts 2 before 10."""
    parts = re.split(r"(\d+)", str(path).casefold())
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in parts)
