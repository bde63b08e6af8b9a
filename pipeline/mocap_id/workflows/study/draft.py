"""A first version of a study's file, and a file beside it with the people's names and ids."""

from __future__ import annotations

import csv
import io
import json
import os
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


def write_draft(found: Discovery, file: Path, *, keep_names: bool = False, force: bool = False) -> list[Path]:
    """Write a study's file and, unless ``keep_names``, the file with names and ids; return the written paths.

    Raises
    ------
    StoreError
        A file exists already and ``force`` is False, or a file cannot be written.
    """
    contents = {file.name: _format_study(found, file).encode()}
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
    """Return the ids by name from subjects.csv in the folder of a study's file; empty if there is no subjects.csv.

    Raises
    ------
    ConfigError
        subjects.csv cannot be read, or does not have the columns id and name.
    """
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


def _format_study(found: Discovery, file: Path) -> str:
    """Return the YAML text of a study with the found recordings; paths are relative to the study's file."""
    name, defaults, person = _REACH if found.reach else _SIT_TO_STAND
    lines = [
        _HEAD.format(file=file.name),
        f"study: {name}",
        "out: runs  # folder of the results",
        f"defaults: {defaults}  # keys of a trial's file, for all trials",
        f"subjects:  # each {person}",
        *(f"  {_quote(subject)}: {{}}" for subject in found.names),
        "trials:",
        *(_format_trial(trial, file.absolute().parent) for trial in found.trials),
    ]
    return "\n".join(lines) + "\n"


def _format_trial(trial: FoundRecording, folder: Path) -> str:
    recording = _quote_path(trial.markers, folder)
    if trial.forces is not None:
        recording = f"{{markers: {recording}, forces: {_quote_path(trial.forces, folder)}}}"
    elif trial.skeleton:
        recording = f"{{skeleton: {recording}}}"
    labels = {name: getattr(trial, name) for name in ("trial", "subject", "strategy", "session", "side")}
    keys = ", ".join(f"{name}: {_quote(value)}" for name, value in labels.items() if value)
    return f"  - {{{keys}, recording: {recording}}}"


def _quote_path(path: Path, folder: Path) -> str:
    return _quote(Path(os.path.relpath(path.absolute(), folder)).as_posix())


def _quote(text: str) -> str:
    """Return ``text``, quoted if YAML would not read it as text."""
    plain = set(text) <= _PLAIN and text[:1].isalpha() and text.lower() not in ("yes", "no", "true", "false", "null")
    return text if plain else json.dumps(text, ensure_ascii=False)
