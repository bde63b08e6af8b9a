"""The folder of one trial: the only place that reads and writes artefacts."""

from __future__ import annotations

import contextlib
import copy
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import utime
from pathlib import Path
from typing import BinaryIO

from filelock import SoftFileLock, Timeout

from mocap_id import plain_files
from mocap_id.errors import StoreError
from mocap_id.store.artefacts import Artefact, Document
from mocap_id.store.atomic import Content, explained, remove_leftovers, replace_together, within
from mocap_id.store.digest import hash_bytes, hash_file
from mocap_id.store.encoding import conformed, decoded, sealed_writer
from mocap_id.store.locking import LOCK, MARKER, lock_in
from mocap_id.store.provenance import Origin, Provenance
from mocap_id.store.record import UNREADABLE, Record, Seal
from mocap_id.store.schemas import SCHEMAS

_HIDDEN = ".mocap-id"


class Folder:
    """A trial's run folder.

    Artefacts are read once and kept. What a stage gave is handed on as it would be read from its file: typed by its
    schema, facts as JSON, arrays that nobody can write to. A stage run alone and the same stage within a whole run
    therefore see the same.

    Parameters
    ----------
    path : Path
        Made, with its parents, when it is locked.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read: dict[str, tuple[Artefact, Provenance]] = {}
        self._untouched: dict[str, Record] = {}

    @contextlib.contextmanager
    def locked(self) -> Iterator[Folder]:
        """Hold the folder for one run.

        Raises
        ------
        StoreError
            Another run holds it, or it cannot be made or written.
        """
        with explained(self.path):
            made = [folder for folder in (self.path / _HIDDEN, self.path, *self.path.parents) if not folder.exists()]
            (self.path / _HIDDEN).mkdir(parents=True, exist_ok=True)
        place = within(self.path, f"{_HIDDEN}/{LOCK}")
        if place.is_symlink() or (place.exists() and not place.is_file()):
            raise StoreError(f"{place} is no file of ours: delete it and run again")
        with explained(self.path):
            lock = lock_in(self.path / _HIDDEN)
            try:
                lock.acquire(timeout=0)
            except Timeout as error:
                message = f"{self.path} is in use by another run: wait for it, or choose another folder with `out:`"
                if isinstance(lock, SoftFileLock):
                    message += f". If no run goes on, one was killed on another computer: delete {lock.lock_file}"
                raise StoreError(message) from error
        try:
            remove_leftovers(self.path)
            yield self
        finally:
            self._tidy(made)
            lock.release()

    def there(self) -> bool:
        """Whether there is such a folder; StoreError where one may not look."""
        try:
            (self.path / _HIDDEN / LOCK).exists()
            return self.path.is_dir()
        except OSError as error:
            message = f"{self.path} cannot be looked into ({error.strerror}): change its permissions"
            raise StoreError(message) from error

    def read(self, file: str) -> Artefact:
        """An artefact, checked, whose arrays are read-only; StoreError where it is missing or damaged."""
        artefact = self._load(file)[0]
        return replace(artefact, facts=copy.deepcopy(artefact.facts))

    def provenance(self, file: str) -> Provenance:
        """What an artefact says about itself; StoreError where it is missing or damaged."""
        return self._load(file)[1]

    def key(self, file: str) -> str:
        """Key of the computation that an artefact comes from; StoreError where it is missing or damaged."""
        record = None if file in self._read else self._as_written(file)
        return self.provenance(file).origin.key if record is None else record.origin.key

    def exists(self, file: str) -> bool:
        """Whether there is such a file, sound or not."""
        return file in self._read or (self.path / file).is_file()

    def keep(self, outputs: Iterable[Artefact | Document], origin: Origin) -> list[Artefact | Document]:
        """Hold what a stage gave in memory, as it would be read from its files; the outputs for :meth:`store`.

        Raises
        ------
        ValueError
            An artefact breaks its schema.
        """
        kept = [output if isinstance(output, Document) else conformed(output) for output in outputs]
        for output in kept:
            if not isinstance(output, Document):
                schema = output.schema
                told = Provenance(schema.file, schema.version, origin, output.facts, output.reasons)
                self._read[schema.file] = output, told
        return kept

    def release(self, files: Iterable[str]) -> None:
        """Let go of artefacts in memory; who asks for one again gets it from the disk."""
        for file in files:
            self._read.pop(file, None)

    def write(self, outputs: Iterable[Artefact | Document], origin: Origin) -> None:
        """:meth:`keep` and :meth:`store` in one."""
        kept = self.keep(outputs, origin)
        try:
            self.store(kept, origin)
        except BaseException:
            self.release(output.schema.file for output in kept if not isinstance(output, Document))
            raise

    def store(self, outputs: Iterable[Artefact | Document], origin: Origin) -> None:
        """Write what :meth:`keep` gave: all of it appears together.

        Documents of an earlier run of the stage that this one did not make are deleted.

        Raises
        ------
        StoreError
            The folder cannot be written.
        """
        contents: dict[str, Content] = {}
        documents: dict[str, str] = {}
        seals: dict[str, Seal] = {}
        for output in outputs:
            if isinstance(output, Document):
                contents[output.file] = output.content
                documents[output.file] = hash_bytes(output.content)
            else:
                contents[output.schema.file] = sealed_writer(output, origin, seals)
        before = self.documents(origin.stage)
        record = Record(origin, documents, seals)
        contents[record_file(origin.stage)] = partial(_write_record, record)  # the last, when the seals are known
        replace_together(self.path, contents, void=record_file(origin.stage))
        self.remove({file for file in self._ours(before) if file not in documents})
        for file in contents:
            self._untouched.pop(file, None)

    def origin(self, stage: str, files: Sequence[str]) -> Origin | None:
        """Where a stage's outputs come from, if all of them are there, sound and of one and the same computation.

        Parameters
        ----------
        stage : str
            Name of the stage.
        files : sequence of str
            Its artefacts by file name (a name without a schema is a document).

        Raises
        ------
        StoreError
            One of them is damaged.
        """
        record = self._record(stage)
        if record is None or not all((self.path / file).is_file() for file in files):
            return None
        if any(not self._verified(file, record) for file in files if file in SCHEMAS):
            return None
        sound = len(self._ours(record.documents)) == len(record.documents)
        return record.origin if sound and {*record.artefacts, *record.documents} >= set(files) else None

    def documents(self, stage: str) -> Mapping[str, str]:
        """Documents that a stage wrote last, with the hashes of their bytes; none where there is no readable record."""
        record = self._record(stage)
        return record.documents if record else {}

    def remove(self, files: Iterable[str]) -> None:
        """Delete files of this folder; those that are not there are no matter."""
        for file in files:
            path = within(self.path, file)
            with explained(path):
                path.unlink(missing_ok=True)
            self._forget(file)

    def forget(self, stage: str, files: Iterable[str]) -> None:
        """Delete everything that a stage wrote."""
        self.remove([*files, *self._ours(self.documents(stage)), record_file(stage)])

    def freshen(self, files: Iterable[str], inputs: Iterable[Path]) -> None:
        """Make files no older than what they were made from, so that `make` agrees that they are up to date."""
        newest = max((path.stat().st_mtime_ns for path in inputs), default=0)
        for path in (self.path / file for file in files):
            if path.stat().st_mtime_ns < newest:
                stamp = max(newest, time.time_ns())
                with explained(path):
                    utime(path, ns=(stamp, stamp))

    def dissolve(self) -> None:
        """Take the folder away, if nothing is left in it; call it only while holding the folder's lock."""
        with contextlib.suppress(OSError):
            for name in (LOCK, MARKER):
                (self.path / _HIDDEN / name).unlink(missing_ok=True)
            (self.path / _HIDDEN).rmdir()
            for folder in (*filter(Path.is_dir, self.path.iterdir()), self.path):
                folder.rmdir()

    def _tidy(self, made: Sequence[Path]) -> None:
        """After a run that wrote nothing, take away the folders that it made, innermost first."""
        locks = [self.path / _HIDDEN / name for name in (LOCK, MARKER)]
        if made and not any(path.is_file() and path not in locks for path in self.path.rglob("*")):
            with contextlib.suppress(OSError):  # whatever else has come in the meantime may stay
                for lock in locks:
                    lock.unlink(missing_ok=True)
                for folder in made:
                    folder.rmdir()

    def _as_written(self, file: str) -> Record | None:
        """The record of an artefact; None without one, or where it is of another version of the schema.

        Raises
        ------
        StoreError
            The file does not hold the bytes that its record says were written.
        """
        for place in sorted((self.path / _HIDDEN).glob("*.json")) if file not in self._untouched else ():
            record = self._record(place.stem)
            if record is not None and self._verified(file, record):
                break
        return self._untouched.get(file)

    def _verified(self, file: str, record: Record) -> bool:
        """Whether a record knows an artefact that is there; StoreError as for :meth:`_as_written`."""
        if file in self._untouched:
            return True
        seal = record.artefacts.get(file)
        if seal is None or seal.schema_version != SCHEMAS[file].version or not (self.path / file).exists():
            return False
        if self._hash(file) != seal.digest:
            raise StoreError(
                f"{self.path / file} is damaged or was edited: its bytes are not those that were written. "
                "Delete it and run again"
            )
        self._untouched[file] = record
        return True

    def _forget(self, file: str) -> None:
        self._read.pop(file, None)
        self._untouched.pop(file, None)

    def _load(self, file: str) -> tuple[Artefact, Provenance]:
        if file not in self._read:
            self._as_written(file)
            path, schema = self.path / file, SCHEMAS[file]
            try:
                with plain_files.opened(path, links=False) as stream:
                    self._read[file] = decoded(stream, schema)
            except ValueError as error:
                raise StoreError(f"{path} {error}. Delete it and run again") from error
            except FileNotFoundError as error:
                raise StoreError(
                    f"{path} is missing: `mocap-id run TRIAL.yaml` makes it, unless it refuses the trial"
                ) from error
            except OSError as error:
                raise StoreError(f"{path} cannot be read ({error.strerror}): delete it and run again") from error
        return self._read[file]

    def _record(self, stage: str) -> Record | None:
        try:
            record = Record.decode(plain_files.read(within(self.path, record_file(stage)), links=False))
            sound = all(self._may_be_document(file) for file in record.documents)
        except (StoreError, *UNREADABLE):
            return None  # no record: the documents count as not written
        return record if sound else None

    def _may_be_document(self, file: str) -> bool:
        """Whether a name could be a document's: in this folder, and neither an artefact nor one of our own records."""
        path = within(self.path, file)
        return file not in SCHEMAS and not file.startswith(_HIDDEN) and not path.is_dir()

    def _ours(self, documents: Mapping[str, str]) -> list[str]:
        """Those that are still what was written; what somebody has changed since is theirs."""
        return [file for file, content in documents.items() if self._hash(file) == content]

    def _hash(self, file: str) -> str | None:
        """Hash of a file's bytes; None where there is none to read."""
        try:
            return hash_file(within(self.path, file), links=False)
        except (StoreError, OSError, ValueError):
            return None


def record_file(stage: str) -> str:
    """Name of the record of a stage's outputs in a run folder."""
    return f"{_HIDDEN}/{stage}.json"


def _write_record(record: Record, stream: BinaryIO) -> None:
    stream.write(record.encode())
