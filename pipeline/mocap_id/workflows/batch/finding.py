"""From what the user names to trials: files of trials or studies, folders that hold some, patterns of names."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel

from mocap_id.config import Trial, load
from mocap_id.config.source import Source, read
from mocap_id.config.study import load_study
from mocap_id.config.trial import compose, trial_model
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
    model = trial_model()  # once: making it takes as long as reading a file
    for file, source in dict(one for name in named for one in _files(name)).items():
        try:
            for trial in _trials(file, source, model):
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


def _files(name: str) -> Iterator[tuple[Path, Source | None]]:
    """Files that are meant, absolute, with what stands in those that had to be looked into."""
    path = Path(name).expanduser()
    found: Mapping[Path, Source | None]
    if path.is_dir():
        below = sorted(file for pattern in _TRIAL_FILES for file in path.absolute().rglob(pattern))
        found = dict(one for file in below for one in _if_a_trial(file))
    elif path.exists() or not glob.has_magic(name):
        found = {path.absolute(): None}
    else:
        every = sorted(glob.glob(str(path), recursive=True))  # noqa: PTH207  absolute too
        found = dict.fromkeys(Path(file).absolute() for file in every)
    if not found:
        what = "no trial's YAML file lies below this folder" if path.is_dir() else "nothing has such a name"
        raise ConfigError(f"{name}: {what}; expected a trial's or a study's YAML file, a folder of such, or a pattern")
    yield from found.items()


def _if_a_trial(file: Path) -> Iterator[tuple[Path, Source | None]]:
    """A file below a folder with its content, if it is meant: others may be anybody's."""
    try:
        source = read(file)
    except ConfigError:
        if file.stem == "trial":
            yield file, None
    else:
        if isinstance(source.data, dict) and "trial" in source.data and "recording" in source.data:
            yield file, source


def _trials(file: Path, source: Source | None, model: type[BaseModel]) -> Iterator[Trial]:
    source = read(file) if source is None else source
    if isinstance(source.data, dict) and "study" in source.data:
        yield from (one.trial for one in load_study(file).trials)
    elif isinstance(source.data, dict):
        yield compose(source, model=model)
    else:
        yield load(file)  # which says what is wrong
