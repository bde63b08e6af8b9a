"""The trials that the user names: files of trials or studies, folders that contain them, or patterns of names."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel

from mocap_id import plain_files
from mocap_id.config import Trial, load
from mocap_id.config.source import Source, read
from mocap_id.config.study import load_study
from mocap_id.config.trial import build_trial_model, compose
from mocap_id.errors import ConfigError
from mocap_id.store.ownership import OWNER_FILE, read_owner

_TRIAL_FILES = ("*.yaml", "*.yml")


@dataclass(frozen=True)
class UnreadableFile:
    """A named file that cannot be read as the file of a trial or a study."""

    file: Path
    error: ConfigError


def find_trials(named: Sequence[str], *, runs: bool = False) -> tuple[list[Trial], list[UnreadableFile]]:
    """Return the named trials, each once, and the files that cannot be read as trials.

    Parameters
    ----------
    named : sequence of str
        Files of trials or studies; folders with such files at any depth; patterns such as ``lab/*/trial.yaml`` (``**``
        matches folders at any depth).
    runs : bool
        Whether a folder also stands for the trials whose run folders it contains; their files may be elsewhere.

    Raises
    ------
    ConfigError
        A name matches nothing, or two trials have the same run folder.
    """
    trials: dict[Path, Trial] = {}
    unreadable: list[UnreadableFile] = []
    model = build_trial_model()  # once, because making it takes as long as reading a file
    for file, source in dict(one for name in named for one in _find_files(name, runs)).items():
        try:
            for trial in _read_trials(file, source, model):
                other = trials.setdefault(trial.out.resolve(), trial)
                if (other.file.resolve(), other.name) != (trial.file.resolve(), trial.name):
                    raise _SharedFolder(
                        f"{trial.file} and {other.file} share the folder {trial.out}: give one of them a different "
                        "`out:`"
                    )
        except _SharedFolder as error:
            raise ConfigError(str(error)) from error
        except ConfigError as error:
            unreadable.append(UnreadableFile(file, error))
    return list(trials.values()), unreadable


def find_readable_trials(named: Sequence[str]) -> list[Trial]:
    """Return the trials that :func:`find_trials` finds; raise ConfigError if a file cannot be read as a trial."""
    trials, unreadable = find_trials(named)
    if unreadable:
        raise ConfigError("\n".join(str(one.error) for one in unreadable))
    return trials


class _SharedFolder(ConfigError):
    """Two trials have the same run folder, so neither of them may be run."""


def _find_files(name: str, runs: bool) -> Iterator[tuple[Path, Source | None]]:
    """Yield the absolute path of each file that matches a name, and its content if it was read, else None."""
    path = Path(name).expanduser()
    files: dict[Path, Source | None]
    if path.is_dir():
        below = sorted(file for pattern in _TRIAL_FILES for file in path.absolute().rglob(pattern))
        files = dict(one for file in below for one in _read_if_trial(file))
        known = {file.resolve() for file in files}
        for record in sorted(path.absolute().rglob(OWNER_FILE)) if runs else ():
            owner = read_owner(record.parents[1])
            if owner is not None and owner.file not in known:
                files |= {owner.file: None}
    elif path.exists() or not glob.has_magic(name):
        files = {path.absolute(): None}
    else:
        matches = sorted(glob.glob(str(path), recursive=True))  # noqa: PTH207  the pattern may be absolute
        files = dict.fromkeys(Path(file).absolute() for file in matches)
    if not files:
        what = "this folder contains no trial's YAML file" if path.is_dir() else "no file has this name"
        raise ConfigError(
            f"{name}: {what}; expected a trial's or a study's YAML file, a folder of them, or a pattern"
            f"{plain_files.suggest(path)}"
        )
    yield from files.items()


def _read_if_trial(file: Path) -> Iterator[tuple[Path, Source | None]]:
    """Yield a YAML file with its content if it describes trials; with None if it is unreadable but named ``trial``."""
    try:
        source = read(file)
    except ConfigError:
        if file.stem == "trial":
            yield file, None
    else:
        keys = source.data.keys() if isinstance(source.data, dict) else set()
        if {"trial", "recording"} <= keys or {"trial", "imus"} <= keys or {"study", "subjects", "trials"} <= keys:
            yield file, source


def _read_trials(file: Path, source: Source | None, model: type[BaseModel]) -> Iterator[Trial]:
    """Yield the trial of a trial's file, or the trials of a study's file."""
    source = read(file) if source is None else source
    if isinstance(source.data, dict) and "study" in source.data:
        yield from (one.trial for one in load_study(file).trials)
    elif isinstance(source.data, dict):
        yield compose(source, model=model)
    else:
        yield load(file)  # raises ConfigError with a message about the content
