"""From what the user names to trials: files of trials or studies, folders that hold some, patterns of names."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mocap_id.config import Trial, load, load_study
from mocap_id.config.source import read
from mocap_id.errors import ConfigError

_TRIAL_FILES = ("*.yaml", "*.yml")


@dataclass(frozen=True)
class Unreadable:
    """A file that was named as a trial's or a study's and is none."""

    file: Path
    error: ConfigError


def find(named: Sequence[str]) -> tuple[list[Trial], list[Unreadable]]:
    """The trials that are meant, each once, and the files that cannot be read as one.

    Parameters
    ----------
    named : sequence of str
        Files of trials or studies; folders, for every trial's file below them; patterns such as ``lab/*/trial.yaml``
        (``**`` for folders within folders).

    Raises
    ------
    ConfigError
        A name fits nothing, or two trials share a run folder.
    """
    trials: dict[Path, Trial] = {}
    unreadable: list[Unreadable] = []
    for file in dict.fromkeys(file for name in named for file in _files(name)):
        try:
            for trial in _trials(file):
                other = trials.setdefault(trial.out.resolve(), trial)
                if (other.file, other.name) != (trial.file, trial.name):
                    raise _Shared(
                        f"{trial.file} and {other.file} share the folder {trial.out}: give one another `out:`"
                    )
        except _Shared as error:
            raise ConfigError(str(error)) from error
        except ConfigError as error:
            unreadable.append(Unreadable(file, error))
    return list(trials.values()), unreadable


class _Shared(ConfigError):
    """Two trials with one folder: none of the two can be trusted with it."""


def _files(name: str) -> Iterator[Path]:
    path = Path(name).expanduser()
    if path.is_dir():
        found = sorted(file for pattern in _TRIAL_FILES for file in path.rglob(pattern) if _looks_like_a_trial(file))
    elif path.exists() or not glob.has_magic(name):
        found = [path]
    else:
        found = [Path(file) for file in sorted(glob.glob(str(path), recursive=True))]  # noqa: PTH207  absolute too
    if not found:
        what = "no trial's YAML file lies below this folder" if path.is_dir() else "nothing has such a name"
        raise ConfigError(f"{name}: {what}; expected a trial's or a study's YAML file, a folder of such, or a pattern")
    yield from (file.absolute() for file in found)


def _looks_like_a_trial(file: Path) -> bool:
    """Whether a file below a folder is meant: others may be anybody's."""
    try:
        data = read(file).data
    except ConfigError:
        return file.stem == "trial"
    return isinstance(data, dict) and "trial" in data and "recording" in data


def _trials(file: Path) -> Iterator[Trial]:
    data = read(file).data
    if isinstance(data, dict) and "study" in data:
        yield from (one.trial for one in load_study(file).trials)
    else:
        yield load(file)
