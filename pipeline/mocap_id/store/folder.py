"""Run folder of one trial: every artefact is read and written here."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import utime
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from filelock import SoftFileLock, Timeout

from mocap_id import plain_files, store
from mocap_id.errors import StoreError
from mocap_id.store.atomic import Content, explained, remove_leftovers, replace_together, within
from mocap_id.store.hashing import hash_bytes, hash_file
from mocap_id.store.locking import LOCK, MARKER, lock_in
from mocap_id.store.provenance import Origin, Provenance
from mocap_id.store.record import UNREADABLE, Checksum, Document, Record
from mocap_id.store.schemas import SCHEMAS

if TYPE_CHECKING:
    from mocap_id.store.artefacts import Artefact, LongTable, Table, Tree

_HIDDEN = ".mocap-id"


class Folder:
    """The run folder of a trial.

    Each artefact is read once and kept in memory. The outputs of a stage are passed on as they would be read from their
    files: typed by the schema, facts as JSON, arrays read-only. A stage therefore sees the same inputs when it is run
    alone and within a whole run.

    Parameters
    ----------
    path : Path
        Created, with its parents, when the folder is locked.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read: dict[str, tuple[Artefact, Provenance]] = {}
        self._verified: dict[str, Record] = {}

    @contextlib.contextmanager
    def locked(self, wait: float = 0.0) -> Iterator[Folder]:
        """Lock the folder for one run, for which another run may take up to ``wait`` seconds to end.

        Raises
        ------
        StoreError
            Another run has locked it, or it cannot be created or written.
        """
        with explained(self.path):
            made = [folder for folder in (self.path / _HIDDEN, self.path, *self.path.parents) if not folder.exists()]
            (self.path / _HIDDEN).mkdir(parents=True, exist_ok=True)
        place = within(self.path, f"{_HIDDEN}/{LOCK}")
        if place.is_symlink() or (place.exists() and not place.is_file()):
            raise StoreError(f"{place} is not a lock of mocap-id: delete it and run again")
        with explained(self.path):
            lock = lock_in(self.path / _HIDDEN)
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
            self._remove_if_empty(made)
            lock.release()

    def there(self) -> bool:
        """Return whether the folder exists; StoreError where its permissions hide it."""
        try:
            (self.path / _HIDDEN / LOCK).exists()
            return self.path.is_dir()
        except OSError as error:
            message = f"{self.path} cannot be read ({error.strerror}): change its permissions"
            raise StoreError(message) from error

    def read(self, file: str) -> Artefact:
        """Read an artefact, with read-only arrays; StoreError where it is missing or damaged."""
        artefact = self._load(file)[0]
        return replace(artefact, facts=json.loads(json.dumps(artefact.facts)))  # a copy

    def table(self, file: str) -> Table:
        """Return a Parquet artefact; errors as for :meth:`read`."""
        artefact = self.read(file)
        assert isinstance(artefact, store.Table)
        return artefact

    def long_table(self, file: str) -> LongTable:
        """Return a Parquet artefact with a row for every frame and marker; errors as for :meth:`read`."""
        artefact = self.read(file)
        assert isinstance(artefact, store.LongTable)
        return artefact

    def tree(self, file: str) -> Tree:
        """Return an HDF5 artefact; errors as for :meth:`read`."""
        artefact = self.read(file)
        assert isinstance(artefact, store.Tree)
        return artefact

    def provenance(self, file: str) -> Provenance:
        """Return the provenance of an artefact; StoreError where it is missing or damaged."""
        return self._load(file)[1]

    def key(self, file: str) -> str:
        """Return the cache key of an artefact; StoreError where it is missing or damaged."""
        record = None if file in self._read else self._record_of(file)
        return self.provenance(file).origin.key if record is None else record.origin.key

    def exists(self, file: str) -> bool:
        """Return whether the file exists, damaged or not."""
        return file in self._read or (self.path / file).is_file()

    def keep(self, outputs: Iterable[Artefact | Document], origin: Origin) -> list[Artefact | Document]:
        """Keep a stage's outputs in memory as they would be read from their files, and return them for :meth:`store`.

        Raises
        ------
        ValueError
            An artefact does not match its schema.
        """
        from mocap_id.store.encoding import conformed  # noqa: PLC0415  slow import, and often nothing is computed

        kept = [output if isinstance(output, Document) else conformed(output) for output in outputs]
        for output in kept:
            if not isinstance(output, Document):
                schema = output.schema
                provenance = Provenance(schema.file, schema.version, origin, output.facts, output.reasons)
                self._read[schema.file] = output, provenance
        return kept

    def size(self, file: str) -> int | None:
        """Return the bytes of an artefact in memory; None if it is not in memory."""
        return self._read[file][0].nbytes if file in self._read else None

    def release(self, files: Iterable[str]) -> None:
        """Drop artefacts from memory; the next access reads them from the disk."""
        for file in files:
            self._read.pop(file, None)

    def write(self, outputs: Iterable[Artefact | Document], origin: Origin) -> None:
        """Call :meth:`keep`, then :meth:`store`."""
        kept = self.keep(outputs, origin)
        try:
            self.store(kept, origin)
        except BaseException:
            self.release(output.schema.file for output in kept if not isinstance(output, Document))
            raise

    def store(self, outputs: Iterable[Artefact | Document], origin: Origin) -> None:
        """Write the outputs of :meth:`keep`; all files appear together.

        Documents that an earlier run of the stage wrote and this one did not are deleted.

        Raises
        ------
        StoreError
            The folder cannot be written.
        """
        from mocap_id.store.encoding import checksum_writer  # noqa: PLC0415

        contents: dict[str, Content] = {}
        documents: dict[str, str] = {}
        checksums: dict[str, Checksum] = {}
        for output in outputs:
            if isinstance(output, Document):
                contents[output.file] = output.content
                documents[output.file] = hash_bytes(output.content)
            else:
                contents[output.schema.file] = checksum_writer(output, origin, checksums)
        before = self.documents(origin.stage)
        record = Record(origin, documents, checksums)
        contents[record_file(origin.stage)] = partial(_write_record, record)  # last: the checksums are then known
        replace_together(self.path, contents, void=record_file(origin.stage))
        self.remove({file for file in self._unchanged(before) if file not in documents})
        for file in contents:
            self._verified.pop(file, None)

    def origin(self, stage: str, files: Sequence[str]) -> Origin | None:
        """Return the origin of a stage's outputs; None unless all exist, are intact and come from one computation.

        Parameters
        ----------
        stage : str
            Name of the stage.
        files : sequence of str
            File names of its outputs; a name without a schema is a document.

        Raises
        ------
        StoreError
            An artefact is damaged.
        """
        record = self._record(stage)
        if record is None or not all((self.path / file).is_file() for file in files):
            return None
        if any(not self._verify(file, record) for file in files if file in SCHEMAS):
            return None
        sound = len(self._unchanged(record.documents)) == len(record.documents)
        return record.origin if sound and {*record.artefacts, *record.documents} >= set(files) else None

    def documents(self, stage: str) -> Mapping[str, str]:
        """Return the hashes of the documents that a stage wrote last; none without a readable record."""
        record = self._record(stage)
        return record.documents if record else {}

    def remove(self, files: Iterable[str]) -> None:
        """Delete files of this folder, as far as they exist."""
        for file in files:
            path = within(self.path, file)
            with explained(path):
                path.unlink(missing_ok=True)
            self._forget(file)

    def forget(self, stage: str, files: Iterable[str]) -> None:
        """Delete everything that a stage wrote, except documents that were edited since."""
        self.remove([*files, *self._unchanged(self.documents(stage)), record_file(stage)])

    def freshen(self, files: Iterable[str], inputs: Iterable[Path]) -> None:
        """Make files no older than their inputs, so that `make` also considers them up to date."""
        newest = max((path.stat().st_mtime_ns for path in inputs), default=0)
        for path in (self.path / file for file in files):
            if path.stat().st_mtime_ns < newest:
                stamp = max(newest, time.time_ns())
                with explained(path):
                    utime(path, ns=(stamp, stamp))

    def dissolve(self) -> None:
        """Delete the folder if nothing is left in it; call this only while holding its lock."""
        with contextlib.suppress(OSError):
            for name in (LOCK, MARKER):
                (self.path / _HIDDEN / name).unlink(missing_ok=True)
            (self.path / _HIDDEN).rmdir()
            for folder in (*filter(Path.is_dir, self.path.iterdir()), self.path):
                folder.rmdir()

    def _remove_if_empty(self, made: Sequence[Path]) -> None:
        """Delete the folders that a run created, innermost first, if it wrote nothing."""
        locks = [self.path / _HIDDEN / name for name in (LOCK, MARKER)]
        if made and not any(path.is_file() and path not in locks for path in self.path.rglob("*")):
            with contextlib.suppress(OSError):  # another program may have written there meanwhile
                for lock in locks:
                    lock.unlink(missing_ok=True)
                for folder in made:
                    folder.rmdir()

    def _record_of(self, file: str) -> Record | None:
        """Return the record of an artefact; None without one, or where the artefact has another schema version.

        Raises
        ------
        StoreError
            The file's bytes are not those that were written.
        """
        for place in sorted((self.path / _HIDDEN).glob("*.json")) if file not in self._verified else ():
            record = self._record(place.stem)
            if record is not None and self._verify(file, record):
                break
        return self._verified.get(file)

    def _verify(self, file: str, record: Record) -> bool:
        """Return whether a record lists an existing artefact; StoreError where the artefact is damaged."""
        if file in self._verified:
            return True
        checksum = record.artefacts.get(file)
        if checksum is None or checksum.schema_version != SCHEMAS[file].version or not (self.path / file).exists():
            return False
        if self._hash(file) != checksum.digest:
            raise StoreError(
                f"{self.path / file} is damaged or was edited: its bytes are not those that were written. "
                "Delete it and run again"
            )
        self._verified[file] = record
        return True

    def _forget(self, file: str) -> None:
        self._read.pop(file, None)
        self._verified.pop(file, None)

    def _load(self, file: str) -> tuple[Artefact, Provenance]:
        if file not in self._read:
            from mocap_id.store.encoding import decoded  # noqa: PLC0415

            self._record_of(file)
            path, schema = self.path / file, SCHEMAS[file]
            try:
                with plain_files.open_file(path, links=False) as stream:
                    self._read[file] = decoded(stream, schema)
            except ValueError as error:
                raise StoreError(f"{path} {error}. Delete it and run again") from error
            except FileNotFoundError as error:
                raise StoreError(
                    f"{path} is missing: `mocap-id run TRIAL.yaml` makes it, unless the trial is refused"
                ) from error
            except OSError as error:
                raise StoreError(f"{path} cannot be read ({error.strerror}): delete it and run again") from error
        return self._read[file]

    def _record(self, stage: str) -> Record | None:
        try:
            record = Record.decode(plain_files.read(within(self.path, record_file(stage)), links=False))
            sound = all(self._may_be_document(file) for file in record.documents)
        except (StoreError, *UNREADABLE):
            return None  # without a record, the documents count as not written
        return record if sound else None

    def _may_be_document(self, file: str) -> bool:
        """Return whether a name may be a document: in this folder, and neither an artefact nor a record."""
        path = within(self.path, file)
        return file not in SCHEMAS and not file.startswith(_HIDDEN) and not path.is_dir()

    def _unchanged(self, documents: Mapping[str, str]) -> list[str]:
        """Return the documents that nobody has edited since they were written."""
        return [file for file, content in documents.items() if self._hash(file) == content]

    def _hash(self, file: str) -> str | None:
        """Return the hash of a file; None where it cannot be read."""
        try:
            return hash_file(within(self.path, file), links=False)
        except (StoreError, OSError, ValueError):
            return None


def record_file(stage: str) -> str:
    """Return the file name of a stage's record in a run folder."""
    return f"{_HIDDEN}/{stage}.json"


def _write_record(record: Record, stream: BinaryIO) -> None:
    stream.write(record.encode())
