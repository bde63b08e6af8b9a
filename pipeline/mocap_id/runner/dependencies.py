"""What a stage's outputs depend on: its slice of the configuration, the user's files, artefacts; and the cache key."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from mocap_id.config import Trial
from mocap_id.errors import RecordingError, Refused
from mocap_id.stages import Stage
from mocap_id.store import dumps, hash_bytes, hash_file


def user_files(trial: Trial, stage: Stage) -> dict[str, Path]:
    """The user's files that a stage reads, by their key in the YAML (``recording.markers``)."""
    return {role: path for key in stage.uses for role, path in _paths(getattr(trial.keys, key), key)}


def parameters(trial: Trial, stage: Stage) -> dict[str, Any]:
    """The stage's slice of the configuration: the trial's keys that it reads and its settings; files by name alone."""
    used = {key: _plain(getattr(trial.keys, key)) for key in stage.uses}
    return {**used, stage.name: _plain(trial.settings[stage.name])}


def cache_key(
    stage: Stage, settings: Mapping[str, Any], hashes: Mapping[str, str], refused: Refused | None = None
) -> str:
    """Hash of the stage, its version, its slice and the hashes of its inputs, with the refusal that it tells of."""
    refusal = None if refused is None else [refused.code, refused.message]
    return hash_bytes(dumps([stage.name, stage.version, settings, hashes, refusal]).encode())


_SETTLED_NS = 2 * 10**9
"""A file that was written less than that ago may be written to again under the same stamp."""


class FileHashes:
    """Hashes of the user's files, each read once."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self._known: dict[Path, str] = {}
        self._stamps: dict[Path, tuple[int, ...]] = {}

    def of(self, stage: Stage) -> dict[str, str]:
        """Hashes of the files that a stage reads, by key.

        Raises
        ------
        RecordingError
            One is missing or cannot be read.
        """
        return {role: self._hash(role, path) for role, path in user_files(self.trial, stage).items()}

    def unchanged(self, stage: Stage) -> None:
        """Make sure that the files are still those whose hashes are known, now that the stage has read them.

        Raises
        ------
        RecordingError
            One was written to, or is gone: what the stage has made is of nobody knows which content.
        """
        for role, path in user_files(self.trial, stage).items():
            if path in self._stamps and self._stamps[path] == _stamp(path):
                continue  # nobody has touched it
            if self._read(role, path) != self._known.get(path):
                raise RecordingError(
                    f"{path}: changed while it was being read, named as `{role}` in {self.trial.file}; nothing was "
                    "written: wait until it is complete, then run again"
                )

    def _hash(self, role: str, path: Path) -> str:
        if path not in self._known:
            now, stamp = time.time_ns(), _stamp(path)
            self._known[path] = self._read(role, path)
            if stamp and now - max(stamp[-2:]) > _SETTLED_NS:
                self._stamps[path] = stamp
        return self._known[path]

    def _read(self, role: str, path: Path) -> str:
        named = f"named as `{role}` in {self.trial.file}"
        try:
            return hash_file(path)
        except FileNotFoundError as error:
            raise RecordingError(f"{path}: no such file, {named}") from error
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read ({error.strerror}), {named}") from error


def _stamp(path: Path) -> tuple[int, ...]:
    """What every writing changes about a file, times last; empty where there is none."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _paths(value: Any, key: str) -> Iterator[tuple[str, Path]]:
    if isinstance(value, Path):
        yield key, value
    elif isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from _paths(getattr(value, name), f"{key}.{name}")
    elif isinstance(value, tuple):
        for number, item in enumerate(value):
            yield from _paths(item, f"{key}[{number}]")


def _plain(value: Any) -> Any:
    """JSON values; of a path only the file's name, so that a moved recording stays the same recording."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, BaseModel):
        return {name: _plain(getattr(value, name)) for name in type(value).model_fields}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
