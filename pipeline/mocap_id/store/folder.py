"""Run folder of a trial, through which all artefacts are read and written, and sets of artefacts."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import utime
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, BinaryIO

from filelock import SoftFileLock, Timeout

from mocap_id import plain_files, store
from mocap_id.errors import StoreError
from mocap_id.store.atomic import (
    LOCK,
    MARKER,
    Content,
    HashedStream,
    converting_errors,
    create_lock,
    hash_bytes,
    hash_file,
    remove_leftovers,
    replace_together,
    resolve_path,
    write_files,
)
from mocap_id.store.provenance import (
    INVALID_RECORD,
    SCHEMAS,
    Document,
    Origin,
    Provenance,
    Record,
    TreeSchema,
    convert_as_stored,
)

if TYPE_CHECKING:
    from mocap_id.store.artefacts import Artefact, Facts, LongTable, Table, Tree

_HIDDEN = ".mocap-id"


class ArtefactSet:
    """Base of classes with an attribute ``artefacts``: artefacts by file name, of which some may be absent."""

    artefacts: Mapping[str, Artefact]

    def table(self, file: str) -> Table | None:
        """Return the Parquet artefact ``file``; None if it is absent or has a row for every frame and marker."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, store.Table) else None

    def long(self, file: str) -> LongTable | None:
        """Return the Parquet artefact ``file``, which has a row for every frame and marker; None if it is absent."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, store.LongTable) else None

    def tree(self, file: str) -> Tree | None:
        """Return the HDF5 artefact ``file``; None if it is absent."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, store.Tree) else None

    def facts(self, file: str) -> Facts:
        """Return the facts of an artefact; empty if it is absent."""
        artefact = self.artefacts.get(file)
        return artefact.facts if artefact is not None else {}

    @property
    def in_space(self) -> bool:
        """Whether the trial has `space: 3d`."""
        return self.facts("planar.parquet").get("space") == "3d"


class ArtefactReader:
    """Base of classes with a method ``read``, which returns the artefact of a file or raises an exception."""

    def read(self, file: str) -> Artefact:
        """Return an artefact."""
        raise NotImplementedError

    def table(self, file: str) -> Table:
        """Return a Parquet artefact."""
        artefact = self.read(file)
        assert isinstance(artefact, store.Table)
        return artefact

    def long(self, file: str) -> LongTable:
        """Return a Parquet artefact with a row for every frame and marker."""
        artefact = self.read(file)
        assert isinstance(artefact, store.LongTable)
        return artefact

    def tree(self, file: str) -> Tree:
        """Return an HDF5 artefact."""
        artefact = self.read(file)
        assert isinstance(artefact, store.Tree)
        return artefact


class Folder(ArtefactReader):
    """The run folder of a trial; it and its parent folders are created when it is locked.

    Each artefact is read once and kept in memory. Outputs of a stage are passed to later stages in the form that
    reading their files would give: types by the schema, facts as JSON, read-only arrays. A stage therefore gets the
    same inputs in a whole run and by its own command.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read: dict[str, tuple[Artefact, Provenance]] = {}
        self._verified: dict[str, Record] = {}

    @contextlib.contextmanager
    def locked(self, wait: float = 0.0) -> Iterator[Folder]:
        """Lock the folder for one run; wait up to ``wait`` seconds for another run to end.

        Raises StoreError if another run has locked the folder, or if it cannot be created or written.
        """
        with converting_errors(self.path):
            made = [folder for folder in (self.path / _HIDDEN, self.path, *self.path.parents) if not folder.exists()]
            (self.path / _HIDDEN).mkdir(parents=True, exist_ok=True)
        path = resolve_path(self.path, f"{_HIDDEN}/{LOCK}")
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise StoreError(f"{path} is not a lock of mocap-id: delete it and run again")
        with converting_errors(self.path):
            lock = create_lock(self.path / _HIDDEN)
            try:
                try:
                    lock.acquire(timeout=wait)
                except FileNotFoundError:  # the other run wrote nothing and removed the folder
                    (self.path / _HIDDEN).mkdir(parents=True, exist_ok=True)
                    lock.acquire(timeout=wait)
            except Timeout as error:
                message = f"{self.path} is in use by another run: wait for it, or choose another folder with `out:`"
                if isinstance(lock, SoftFileLock):
                    message += f". If none is running, a run was killed on another computer: delete {lock.lock_file}"
                raise StoreError(message) from error
        try:
            remove_leftovers(self.path)
            yield self
        finally:
            self._remove_created(made)
            lock.release()

    def is_present(self) -> bool:
        """Return whether the folder exists; StoreError if its permissions forbid reading it."""
        try:
            (self.path / _HIDDEN / LOCK).exists()
            return self.path.is_dir()
        except OSError as error:
            message = f"{self.path} cannot be read ({error.strerror}): change its permissions"
            raise StoreError(message) from error

    def read(self, file: str) -> Artefact:
        """Read an artefact, with read-only arrays; StoreError if it is missing or damaged."""
        artefact = self._load(file)[0]
        return replace(artefact, facts=json.loads(json.dumps(artefact.facts)))  # a copy that may be changed

    def provenance(self, file: str) -> Provenance:
        """Return the provenance of an artefact; StoreError if the artefact is missing or damaged."""
        return self._load(file)[1]

    def key(self, file: str) -> str:
        """Return the cache key of an artefact; StoreError if the artefact is missing or damaged."""
        record = None if file in self._read else self._find_read_record(file)
        return self.provenance(file).origin.key if record is None else record.origin.key

    def exists(self, file: str) -> bool:
        """Return whether a file exists, damaged or not."""
        return file in self._read or (self.path / file).is_file()

    def keep(self, outputs: Iterable[Artefact | Document], origin: Origin) -> list[Artefact | Document]:
        """Keep a stage's outputs in memory as they would be read from their files, and return them for :meth:`store`.

        Raises ValueError if an artefact does not match its schema.
        """
        from mocap_id.store import artefacts, hdf5, parquet  # noqa: PLC0415  slow, and often nothing is computed

        kept: list[Artefact | Document] = []
        for output in outputs:
            if isinstance(output, Document):
                kept.append(output)
                continue
            typed = hdf5.conform_tree(output) if isinstance(output, artefacts.Tree) else parquet.conform_table(output)
            facts, reasons = convert_as_stored(output.facts, output.reasons)
            kept.append(artefacts.freeze(replace(typed, facts=facts, reasons=reasons)))
        for output in kept:
            if not isinstance(output, Document):
                schema = output.schema
                provenance = Provenance(schema.file, schema.version, origin, output.facts, output.reasons)
                self._read[schema.file] = output, provenance
        return kept

    def size(self, file: str) -> int | None:
        """Return the size of an artefact in memory, bytes; None if it is not in memory."""
        return self._read[file][0].nbytes if file in self._read else None

    def release(self, files: Iterable[str]) -> None:
        """Remove artefacts from memory; the next access reads them from the disk."""
        for file in files:
            self._read.pop(file, None)

    def write(self, outputs: Iterable[Artefact | Document], origin: Origin) -> None:
        """Keep a stage's outputs in memory and write them to files; errors as for :meth:`keep` and :meth:`store`."""
        kept = self.keep(outputs, origin)
        try:
            self.store(kept, origin)
        except BaseException:
            self.release(output.schema.file for output in kept if not isinstance(output, Document))
            raise

    def store(self, outputs: Iterable[Artefact | Document], origin: Origin) -> None:
        """Write the outputs returned by :meth:`keep`, all of them or none; StoreError if the folder cannot be written.

        Documents of an earlier run of the stage that are not among these outputs are deleted.
        """
        from mocap_id.store import artefacts, hdf5, parquet  # noqa: PLC0415

        contents: dict[str, Content] = {}
        documents: dict[str, str] = {}
        checksums: dict[str, tuple[int, str]] = {}

        def write(artefact: Artefact, stream: BinaryIO) -> None:
            hashed = HashedStream(stream)
            if isinstance(artefact, artefacts.Tree):
                hashed.write(hdf5.encode_tree(artefact, origin))
            else:
                parquet.write(artefact, origin, hashed)
            checksums[artefact.schema.file] = artefact.schema.version, hashed.hash()

        for output in outputs:
            if isinstance(output, Document):
                contents[output.file] = output.content
                documents[output.file] = hash_bytes(output.content)
            else:
                contents[output.schema.file] = partial(write, output)
        before = self.documents(origin.stage)
        record = Record(origin, documents, checksums)
        # The record is written last, when the checksums are known.
        contents[record_file(origin.stage)] = lambda stream: stream.write(record.encode())
        replace_together(self.path, contents, void=record_file(origin.stage))
        self.remove({file for file in self._find_unchanged(before) if file not in documents})
        for file in contents:
            self._verified.pop(file, None)

    def origin(self, stage: str, files: Sequence[str]) -> Origin | None:
        """Return the origin of a stage's outputs; None unless all exist, are intact and come from one computation.

        A name in ``files`` without a schema is a document. Raises StoreError if an artefact is damaged.
        """
        record = self._read_record(stage)
        if record is None or not all((self.path / file).is_file() for file in files):
            return None
        if any(not self._verify(file, record) for file in files if file in SCHEMAS):
            return None
        sound = len(self._find_unchanged(record.documents)) == len(record.documents)
        return record.origin if sound and {*record.artefacts, *record.documents} >= set(files) else None

    def documents(self, stage: str) -> Mapping[str, str]:
        """Return the hashes, by file name, of the documents that a stage wrote last; empty without a valid record."""
        record = self._read_record(stage)
        return record.documents if record else {}

    def remove(self, files: Iterable[str]) -> None:
        """Delete those of ``files`` that exist in this folder."""
        for file in files:
            path = resolve_path(self.path, file)
            with converting_errors(path):
                path.unlink(missing_ok=True)
            self._read.pop(file, None)
            self._verified.pop(file, None)

    def remove_outputs(self, stage: str, files: Iterable[str]) -> None:
        """Delete everything that a stage wrote, except documents that the user has edited."""
        self.remove([*files, *self._find_unchanged(self.documents(stage)), record_file(stage)])

    def update_times(self, files: Iterable[str], inputs: Iterable[Path]) -> None:
        """Set the times of files so that none is older than its inputs; otherwise `make` would make them again."""
        newest = max((path.stat().st_mtime_ns for path in inputs), default=0)
        for path in (self.path / file for file in files):
            if path.stat().st_mtime_ns < newest:
                stamp = max(newest, time.time_ns())
                with converting_errors(path):
                    utime(path, ns=(stamp, stamp))

    def remove_if_empty(self) -> None:
        """Delete the folder if nothing is left in it; call this only while holding its lock."""
        with contextlib.suppress(OSError):
            for path in self._list_bookkeeping():
                path.unlink(missing_ok=True)
            (self.path / _HIDDEN).rmdir()
            for folder in (*filter(Path.is_dir, self.path.iterdir()), self.path):
                folder.rmdir()

    def _remove_created(self, made: Sequence[Path]) -> None:
        """Delete the folders that a run created, innermost first, if the run wrote nothing."""
        own = self._list_bookkeeping()
        if made and not any(path.is_file() and path not in own for path in self.path.rglob("*")):
            with contextlib.suppress(OSError):  # another program may have written there meanwhile
                for path in own:
                    path.unlink(missing_ok=True)
                for folder in made:
                    folder.rmdir()

    def _list_bookkeeping(self) -> list[Path]:
        """Return the paths of the files that only say who uses the folder."""
        return [self.path / name for name in (f"{_HIDDEN}/{LOCK}", f"{_HIDDEN}/{MARKER}", OWNER_FILE)]

    def _find_read_record(self, file: str) -> Record | None:
        """Return the present record that lists an artefact, or None; StoreError if the artefact is damaged."""
        for path in sorted((self.path / _HIDDEN).glob("*.json")) if file not in self._verified else ():
            record = self._read_record(path.stem)
            if record is not None and self._verify(file, record):
                break
        return self._verified.get(file)

    def _verify(self, file: str, record: Record) -> bool:
        """Return whether an artefact exists and a record lists it; StoreError if the artefact is damaged."""
        if file in self._verified:
            return True
        checksum = record.artefacts.get(file)
        if checksum is None or checksum[0] != SCHEMAS[file].version or not (self.path / file).exists():
            return False
        if self._hash(file) != checksum[1]:
            raise StoreError(
                f"{self.path / file} is damaged or was edited: its bytes differ from the bytes that were written. "
                "Delete it and run again"
            )
        self._verified[file] = record
        return True

    def _load(self, file: str) -> tuple[Artefact, Provenance]:
        if file not in self._read:
            from mocap_id.store import artefacts, hdf5, parquet  # noqa: PLC0415

            self._find_read_record(file)
            path, schema = self.path / file, SCHEMAS[file]
            try:
                with plain_files.open_file(path, links=False) as stream:
                    artefact: Artefact
                    if isinstance(schema, TreeSchema):
                        artefact, provenance = hdf5.decode_tree(stream.read(), schema)
                    else:
                        artefact, provenance = parquet.decode_table(stream, schema)
                self._read[file] = artefacts.freeze(artefact), provenance
            except ValueError as error:
                raise StoreError(f"{path} {error}. Delete it and run again") from error
            except FileNotFoundError as error:
                raise StoreError(
                    f"{path} is missing: `mocap-id run TRIAL.yaml` makes it, unless the trial is refused"
                ) from error
            except OSError as error:
                raise StoreError(f"{path} cannot be read ({error.strerror}): delete it and run again") from error
        return self._read[file]

    def _read_record(self, stage: str) -> Record | None:
        try:
            record = Record.decode(plain_files.read_bytes(resolve_path(self.path, record_file(stage)), links=False))
            # A document is in this folder, but it is not an artefact or a record.
            sound = not any(
                resolve_path(self.path, file).is_dir() or file in SCHEMAS or file.startswith(_HIDDEN)
                for file in record.documents
            )
        except (StoreError, *INVALID_RECORD):
            return None  # without a record, the documents count as not written
        return record if sound else None

    def _find_unchanged(self, documents: Mapping[str, str]) -> list[str]:
        """Return the names of documents that nobody has edited since they were written."""
        return [file for file, content in documents.items() if self._hash(file) == content]

    def _hash(self, file: str) -> str | None:
        """Return the hash of a file; None if it cannot be read."""
        try:
            return hash_file(resolve_path(self.path, file), links=False)
        except (StoreError, OSError, ValueError):
            return None


def record_file(stage: str) -> str:
    """Return the file name of a stage's record in a run folder."""
    return f"{_HIDDEN}/{stage}.json"


OWNER_FILE = ".mocap-id/owner.json"
"""Record of the owner of a folder."""
_LARGEST = 1 << 22  # bytes of a record; a study of 10,000 trials has 0.7 MB


@dataclass(frozen=True)
class Owner:
    """What results are made from."""

    name: str  # name of the trial or study
    file: Path  # the trial's or study's file, or the folder or page that the results are made from
    contents: tuple[str, ...]  # hashes that identify the recordings; one that is equal is enough
    recording: Path | None = None  # the recording, if there is only one; without folders in a record
    place: str = ""  # only in a record: hash of the recording's path relative to the folder

    def describe(self) -> str:
        """Return the name, the file and the recording as text."""
        return f"`{self.name}` ({self.file}{'' if self.recording is None else f', recording {self.recording}'})"


def read_owner(folder: Path, output: str = "") -> Owner | None:
    """Return the recorded owner of a folder, or of the output of this name in it; None if there is no valid record.

    Its file is absolute.
    """
    try:
        path = resolve_path(folder, _find_record(output))
        found: dict[str, Any] = json.loads(plain_files.read_bytes(path, links=False, largest=_LARGEST))
        names = [found[key] for key in ("name", "file", "recording", "place")]
        if not all(isinstance(text, str) for text in (*names, *found["contents"])):
            return None
        file = Path(os.path.normpath(folder.resolve() / found["file"]))
        recording = Path(found["recording"]) if found["recording"] else None
        return Owner(found["name"], file, tuple(found["contents"]), recording, found["place"])
    except (StoreError, OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def is_other(stored: Owner, owner: Owner, folder: Path) -> bool:
    """Return whether two owners of a folder differ in the content of the recordings, their path and the trial's file.

    A trial stays the same if its settings or its recording are edited, or if its files are moved. Trials of one study
    have the same file, so that their names count too.
    """
    same_file = os.path.normcase(owner.file.resolve()) == os.path.normcase(stored.file)
    same_file = same_file and (owner.recording is None or owner.name == stored.name)
    same_place = bool(stored.place) and stored.place == _hash_place(owner, folder)
    return not (same_file or same_place or set(owner.contents) & set(stored.contents))


def check_owner(folder: Path, owner: Owner, output: str = "", *, path: Path | None = None) -> None:
    """Raise StoreError with ``path`` if a folder, or the output of this name in it, belongs to another recording."""
    stored = read_owner(folder, output)
    if stored is not None and is_other(stored, owner, folder):
        raise StoreError(describe_conflict(path or folder / output, stored.describe(), owner.describe()))


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
