"""The first version of a study's file, and who is who beside it."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from mocap_id.errors import ConfigError, StoreError
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.study.discovery import Discovery, Found

SUBJECTS_FILE = "subjects.csv"
_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./-")
_HEAD = """\
# Made by `mocap-id init`; yours to edit. Paths are relative to this file. Next: fill in what you know of the people
# (all of it optional), then run `mocap-id study {file}`.
"""


def draft(found: Discovery, file: Path) -> str:
    """The YAML text of the study that a folder holds.

    Parameters
    ----------
    found : Discovery
    file : Path
        Where it will stand: paths are relative to that.
    """
    lines = [
        _HEAD.format(file=file.name),
        "study: sit-to-stand",
        "out: runs  # folder of the results",
        "defaults: {protocol: sit-to-stand}  # keys of a trial's file, for all trials",
        "subjects:  # each {height: 1.75, mass: 70.1, sex: female, landmarks_m: {shank: 0.41, thigh: 0.40}}, m and kg",
        *(f"  {_quoted(subject)}: {{}}" for subject in found.names),
        "trials:",
        *(_trial(trial, file.absolute().parent) for trial in found.trials),
    ]
    return "\n".join(lines) + "\n"


def write(found: Discovery, file: Path, *, keep_names: bool = False, force: bool = False) -> list[Path]:
    """Write the study's file and, unless ids are names, who is who.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    StoreError
        One of them is there already and may not be overwritten, or cannot be written.
    """
    contents = {file.name: draft(found, file).encode()}
    if not keep_names:
        contents[SUBJECTS_FILE] = _mapping(found.names)
    there = [file.parent / name for name in contents if (file.parent / name).exists()]
    if there and not force:
        raise StoreError(f"{there[0]} is there already: choose another with --out, or overwrite it with --force")
    with explained(file):
        file.parent.mkdir(parents=True, exist_ok=True)
    replace_together(file.parent, contents)
    return [file.parent / name for name in contents]


def known_names(file: Path) -> dict[str, str]:
    """Ids of the people of an earlier subjects.csv, by name, so that they stay who they are; none without one.

    Raises
    ------
    ConfigError
        It is none of ours.
    """
    try:
        rows = list(csv.DictReader(io.StringIO((file.parent / SUBJECTS_FILE).read_text("utf-8"))))
        return {row["name"]: row["id"] for row in rows}
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, KeyError, csv.Error) as error:
        raise ConfigError(f"{file.parent / SUBJECTS_FILE}: expected the columns id and name") from error


def _trial(trial: Found, folder: Path) -> str:
    recording = _quoted(_relative(trial.markers, folder))
    if trial.forces is not None:
        recording = f"{{markers: {recording}, forces: {_quoted(_relative(trial.forces, folder))}}}"
    return (
        f"  - {{trial: {_quoted(trial.trial)}, subject: {_quoted(trial.subject)}, "
        f"strategy: {_quoted(trial.strategy)}, recording: {recording}}}"
    )


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.absolute(), folder)).as_posix()


def _quoted(text: str) -> str:
    """A YAML scalar that is text whatever it looks like."""
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
