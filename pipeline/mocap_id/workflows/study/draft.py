"""A first version of a study's file, and the list of names and ids beside it."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from mocap_id.errors import ConfigError, StoreError
from mocap_id.store.atomic import write_files
from mocap_id.workflows.study.discovery import Discovery, FoundRecording

SUBJECTS_FILE = "subjects.csv"
_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./-")
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


def draft(found: Discovery, file: Path) -> str:
    """Return the YAML text of a study of the recordings in a folder.

    Parameters
    ----------
    found : Discovery
    file : Path
        The study's file, to which paths are relative.
    """
    name, defaults, person = _REACH if found.reach else _SIT_TO_STAND
    lines = [
        _HEAD.format(file=file.name),
        f"study: {name}",
        "out: runs  # folder of the results",
        f"defaults: {defaults}  # keys of a trial's file, for all trials",
        f"subjects:  # each {person}",
        *(f"  {_quoted(subject)}: {{}}" for subject in found.names),
        "trials:",
        *(_trial(trial, file.absolute().parent) for trial in found.trials),
    ]
    return "\n".join(lines) + "\n"


def write(found: Discovery, file: Path, *, keep_names: bool = False, force: bool = False) -> list[Path]:
    """Write the study's file and, unless the ids are names, the list of names and ids.

    Returns
    -------
    list of Path
        The written files.

    Raises
    ------
    StoreError
        A file exists already, or cannot be written.
    """
    contents = {file.name: draft(found, file).encode()}
    if not keep_names:
        contents[SUBJECTS_FILE] = _mapping(found.names)
    existing = [file.parent / name for name in contents if (file.parent / name).exists()]
    if existing and not force:
        raise StoreError(f"{existing[0]} exists already: choose another with --out, or overwrite it with --force")
    write_files(file.parent, contents)
    return [file.parent / name for name in contents]


def known_names(file: Path) -> dict[str, str]:
    """Return the ids of an existing subjects.csv by name, so that people keep their ids; none without the file.

    Raises
    ------
    ConfigError
        The file has other columns.
    """
    try:
        rows = list(csv.DictReader(io.StringIO((file.parent / SUBJECTS_FILE).read_text("utf-8"))))
        return {row["name"]: row["id"] for row in rows}
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, KeyError, csv.Error) as error:
        raise ConfigError(f"{file.parent / SUBJECTS_FILE}: expected the columns id and name") from error


def _trial(trial: FoundRecording, folder: Path) -> str:
    recording = _quoted(_relative(trial.markers, folder))
    if trial.forces is not None:
        recording = f"{{markers: {recording}, forces: {_quoted(_relative(trial.forces, folder))}}}"
    elif trial.skeleton:
        recording = f"{{skeleton: {recording}}}"
    labels = {name: getattr(trial, name) for name in ("trial", "subject", "strategy", "session", "side")}
    keys = ", ".join(f"{name}: {_quoted(value)}" for name, value in labels.items() if value)
    return f"  - {{{keys}, recording: {recording}}}"


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.absolute(), folder)).as_posix()


def _quoted(text: str) -> str:
    """Return a YAML scalar that is always read as text."""
    plain = set(text) <= _PLAIN and text[:1].isalpha() and text.lower() not in ("yes", "no", "true", "false", "null")
    return text if plain else json.dumps(text, ensure_ascii=False)


def _mapping(names: Mapping[str, str]) -> bytes:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerows(_rows(names))
    return stream.getvalue().encode()


def _rows(names: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    yield "id", "name"
    yield from names.items()
