"""Owner of a folder of results: the trial or study, and the recordings, that the results were made from.

The owner is recorded in the hidden folder of the results, so that another recording never replaces them in silence.
Paths in the record are relative: a tree of folders can be moved or copied. The recording's path is only stored as a
hash, because folders are often named after people.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from mocap_id import plain_files
from mocap_id.errors import StoreError
from mocap_id.store.atomic import hash_bytes, resolve_path, write_files

OWNER_FILE = ".mocap-id/owner.json"
"""Record of the owner of a folder."""
_LARGEST = 1 << 22  # bytes of a record; a study of 10,000 trials has 0.7 MB


@dataclass(frozen=True)
class Owner:
    """What results are made from."""

    name: str  # name of the trial or study
    file: Path  # the trial's or study's file, or the folder or page that the results are made from
    contents: tuple[str, ...]  # hashes that identify the recordings; one that is equal is enough
    recording: Path | None = None  # the recording, if there is only one


@dataclass(frozen=True)
class StoredOwner:
    """An owner as recorded in a folder of results."""

    name: str
    file: Path  # absolute
    contents: tuple[str, ...]
    recording: str  # name of the recording's file without folders; empty if there are several
    place: str  # hash of the recording's path relative to the folder; empty if there are several

    def describe(self) -> str:
        """Return the name, the file and the recording as text."""
        return _describe(self.name, self.file, self.recording)


def read_owner(folder: Path, output: str = "") -> StoredOwner | None:
    """Return the recorded owner of a folder, or of the output of this name in it; None if there is no valid record."""
    try:
        path = resolve_path(folder, _find_record(output))
        found: dict[str, Any] = json.loads(plain_files.read_bytes(path, links=False, largest=_LARGEST))
        names = [found[key] for key in ("name", "file", "recording", "place")]
        if not all(isinstance(text, str) for text in (*names, *found["contents"])):
            return None
        file = Path(os.path.normpath(folder.resolve() / found["file"]))
        return StoredOwner(found["name"], file, tuple(found["contents"]), found["recording"], found["place"])
    except (StoreError, OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def is_other(stored: StoredOwner, owner: Owner, folder: Path) -> bool:
    """Return whether two owners of a folder differ in the content of the recordings, their path and the trial's file.

    A trial stays the same if its settings or its recording are edited, or if its files are moved. Trials of one study
    have the same file, so that their names count too.
    """
    same_file = os.path.normcase(owner.file.resolve()) == os.path.normcase(stored.file)
    same_file = same_file and (owner.recording is None or owner.name == stored.name)
    same_place = bool(stored.place) and stored.place == _hash_place(owner, folder)
    return not (same_file or same_place or set(owner.contents) & set(stored.contents))


def check_owner(folder: Path, owner: Owner, output: str = "", *, path: Path | None = None) -> None:
    """Raise StoreError if a folder, or the output of this name in it, belongs to another recording.

    The message names ``path``, by default the path of the output.
    """
    stored = read_owner(folder, output)
    if stored is not None and is_other(stored, owner, folder):
        own = _describe(owner.name, owner.file, "" if owner.recording is None else str(owner.recording))
        raise StoreError(describe_conflict(path or folder / output, stored.describe(), own))


def describe_conflict(path: Path, stored: str, found: str) -> str:
    """Return the message for results of another recording or study; ``stored`` and ``found`` describe both."""
    stored = f"another recording with the name {stored}" if stored == found else stored
    return (
        f"{path} belongs to another recording or study: it contains the results of {stored}. The results of {found} "
        "would replace them: choose another folder (`out:` or `--out`), or delete this one if you no longer need it"
    )


def store_owner(folder: Path, owner: Owner, output: str = "") -> None:
    """Record the owner of a folder, or of the output of this name in it; StoreError if it cannot be written."""
    record = {
        "name": owner.name,
        "file": _make_relative(owner.file, folder),
        "recording": "" if owner.recording is None else owner.recording.name,
        "place": _hash_place(owner, folder),
        "contents": list(owner.contents),
    }
    text = json.dumps(record, indent=1).encode()
    path = folder / _find_record(output)
    try:
        if path.read_bytes() == text and not path.is_symlink():
            return
    except OSError:
        pass  # there is no record yet
    write_files(folder, {_find_record(output): text})


def hash_texts(texts: Sequence[str]) -> str:
    """Return a hash of several texts, for :attr:`Owner.contents`."""
    return hash_bytes(json.dumps(list(texts)).encode())


def hash_path(path: Path, folder: Path) -> str:
    """Return a hash of the path relative to a folder."""
    return hash_texts([_make_relative(path, folder)])


def _find_record(output: str) -> str:
    return f".mocap-id/owner-{output}.json" if output else OWNER_FILE


def _hash_place(owner: Owner, folder: Path) -> str:
    return "" if owner.recording is None else hash_path(owner.recording, folder)


def _make_relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, or absolute if it is on another drive; links are followed."""
    try:
        return PurePath(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def _describe(name: str, file: Path, recording: str) -> str:
    return f"`{name}` ({file}{f', recording {recording}' if recording else ''})"
