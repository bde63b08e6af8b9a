"""Dependencies of a stage's outputs (part of the configuration, user files, artefacts), and their cache key."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from mocap_id import plain_files
from mocap_id.config import Trial
from mocap_id.errors import ConfigError, RecordingError, Refused
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.trial_keys import list_sensors
from mocap_id.store import dumps, hash_bytes, hash_file
from mocap_id.store.folder import Owner


def find_user_files(trial: Trial, stage: Stage) -> dict[str, Path]:
    """Return the user files that a stage reads, by their YAML key such as ``recording.markers``."""
    return {
        role: path for key in stage.keys_of(trial.keys) for role, path in _find_paths(getattr(trial.keys, key), key)
    }


def find_owner(trial: Trial, files: FileHashes) -> Owner:
    """Return the owner of a trial's run folder; without a readable recording, only its path and the trial count."""
    keys = trial.keys
    recording = next(iter(list_sensors(keys.imus).values())).file if keys.recording is None else keys.recording.motion
    contents: tuple[str, ...]
    try:
        contents = (files.read("recording", recording),)
    except RecordingError:
        contents = ()
    return Owner(trial.name, trial.file, contents, recording)


def collect_parameters(trial: Trial, stage: Stage) -> dict[str, Any]:
    """Return the keys of the trial that a stage reads, and its settings; paths are replaced by file names."""
    used = {key: _to_json(getattr(trial.keys, key)) for key in stage.keys_of(trial.keys)}
    return {**used, stage.name: _to_json(trial.settings[stage.name])}


def compute_cache_key(trial: Trial, stage: Stage, hashes: Mapping[str, str], refused: Refused | None = None) -> str:
    """Return a hash of a stage's name and version, its settings, its inputs' hashes and the refusal that it reports."""
    refusal = None if refused is None else [refused.code, refused.message]
    settings = collect_parameters(trial, stage)
    return hash_bytes(dumps([stage.name, stage.version, settings, hashes, refusal]).encode())


_SETTLED_NS = 2 * 10**9
"""Smallest age of a reliable time stamp, ns: a file modified more recently may change again without a new one."""


class FileHashes:
    """Hashes of the user files; each file is read once."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self._known: dict[Path, str] = {}
        self._stamps: dict[Path, tuple[int, ...]] = {}

    def of(self, stage: Stage) -> dict[str, str]:
        """Return the hashes of the files that a stage reads, by YAML key; RecordingError if one cannot be read."""
        return {role: self.read(role, path) for role, path in find_user_files(self.trial, stage).items()}

    def check_unchanged(self, stage: Stage) -> None:
        """Raise RecordingError if a file of a stage changed during the run, so that its result must be discarded."""
        for role, path in find_user_files(self.trial, stage).items():
            if path in self._stamps and self._stamps[path] == _read_stamp(path):
                continue
            if self._read(role, path) != self._known.get(path):
                raise RecordingError(
                    f"{path}: changed while it was being read (`{role}` in {self.trial.file}); nothing was written. "
                    "Wait until the file is complete, then run again"
                )

    def read(self, role: str, path: Path) -> str:
        """Return the hash of the file under the YAML key ``role``; RecordingError if missing or not readable."""
        if path not in self._known:
            now, stamp = time.time_ns(), _read_stamp(path)
            self._known[path] = self._read(role, path)
            if stamp and now - max(stamp[-2:]) > _SETTLED_NS:
                self._stamps[path] = stamp
        return self._known[path]

    def _read(self, role: str, path: Path) -> str:
        named = f"named as `{role}` in {self.trial.file}"
        try:
            return hash_file(path)
        except FileNotFoundError as error:
            raise RecordingError(f"{path}: no such file, {named}{plain_files.suggest(path)}") from error
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read ({error.strerror}), {named}") from error


def _read_stamp(path: Path) -> tuple[int, ...]:
    """Return file properties that change with every write, the times last; empty if the file does not exist."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _find_paths(value: Any, key: str) -> Iterator[tuple[str, Path]]:
    if isinstance(value, Path):
        yield key, value
    elif isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from _find_paths(getattr(value, name), f"{key}.{name}")
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _find_paths(item, f"{key}.{name}")
    elif isinstance(value, tuple):
        for number, item in enumerate(value):
            yield from _find_paths(item, f"{key}[{number}]")


def _to_json(value: Any) -> Any:
    """Convert a value to JSON values; a path becomes its file name, so that a moved recording counts as unchanged."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, BaseModel):
        return {name: _to_json(getattr(value, name)) for name in type(value).model_fields}
    if isinstance(value, Mapping):
        return {str(key): _to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(item) for item in value]
    return value


def make_rules(trials: Sequence[Trial], command: str, stages: Sequence[Stage] = STAGES) -> str:
    """Return Makefile rules that make the outputs of the last stage of every trial with the commands of the stages.

    The trials have different run folders; ``command`` calls mocap-id. Raises ConfigError if two trials share a run
    folder, or if a path contains characters that make cannot handle.
    """
    folders: dict[Path, Trial] = {}
    for trial in trials:
        other = folders.setdefault(trial.out.resolve(), trial)
        if other is not trial:
            raise ConfigError(
                f"{trial.file} and {other.file} share the folder {trial.out}: give one of them a different `out:`"
            )
    goals = " ".join(_format_path(trial.out / file) for trial in trials for file in stages[-1].outputs)
    lines = [
        "# Made by `mocap-id stages --make`. `%` replaces the dot of a file name: every version of GNU make runs a",
        "# pattern rule with several targets only once.",
        ".SUFFIXES:",
        ".SECONDARY:",
        ".PHONY: all",
        f"all: {goals}",
    ]
    for trial in trials:
        for stage in stages:
            needed = [trial.file, *find_user_files(trial, stage).values(), *(trial.out / file for file in stage.inputs)]
            targets = " ".join(_format_path(trial.out / file, pattern=True) for file in stage.outputs)
            lines += ["", f"{targets}: {' '.join(_format_path(path) for path in needed)}"]
            lines.append(f"\t{command} {stage.name} {_format_path(trial.file)}")
    return "\n".join(lines) + "\n"


def _format_path(path: Path, *, pattern: bool = False) -> str:
    """Return a path for a Makefile, relative to the working folder if it is inside.

    With ``pattern``, ``%`` replaces the dot of the file name. Raises ConfigError if make cannot handle the path.
    """
    here, plain = Path.cwd(), Path(os.path.normpath(path))  # make compares names: a/../b is not b
    path = plain if plain.resolve() == path.resolve() else path
    text = str(path.relative_to(here) if path.is_relative_to(here) else path)
    if re.search(r"[\s%:#$*?\[\]\\;|&<>()'\"`~=!{}]", text):
        raise ConfigError(f"{text}: make cannot handle blanks or special characters in a path: rename it")
    return re.sub(r"\.(?=[^./]*$)", "%", text) if pattern else text
