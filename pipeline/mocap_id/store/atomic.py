"""Atomic writing of files, so that all files of a stage are written or none, their hashes, and locks of folders."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, TypeAlias

from filelock import BaseFileLock, FileLock, SoftFileLock

from mocap_id import plain_files
from mocap_id.errors import StoreError

_CHUNK = 1 << 20  # bytes read at a time


_TEMPORARY = ".mocap-id.tmp"

_ADVICE = {
    errno.ENOSPC: "the disk is full: make room and run again",
    errno.EDQUOT: "your disk quota is used up: make room and run again",
    errno.EFBIG: "the file is larger than this system allows: choose another folder",
    errno.EROFS: "the disk is read-only: choose another folder",
    errno.EACCES: "you may not write there: change its permissions or choose another folder",
    errno.EPERM: "you may not write there: change its permissions or choose another folder",
    errno.ENOTDIR: "there is a file where a folder is needed: move it or choose another folder",
    errno.EEXIST: "there is a file where a folder is needed: move it or choose another folder",
    errno.EISDIR: "a folder has the name of the file: move it or choose another folder",
    errno.ENAMETOOLONG: "the name is too long: choose another folder",
}

Content: TypeAlias = bytes | Callable[[BinaryIO], object]
"""The bytes of a file, or a function that writes them to a stream."""


def hash_bytes(content: bytes) -> str:
    """Return the SHA-256 of some bytes, as hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def hash_file(path: Path, *, links: bool = True) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits.

    ``links`` says whether the path may be a symbolic link. Raises OSError if the file cannot be read, is not a regular
    file, or changes while it is read (:mod:`mocap_id.plain_files`).
    """
    digest = hashlib.sha256()
    with plain_files.open_file(path, links=links) as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


class HashedStream:
    """A binary stream that hashes the bytes written to it; it cannot seek."""

    closed = False

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._digest = stream, hashlib.sha256()

    def write(self, data: Any) -> int:
        """Write a whole buffer, and return the number of bytes."""
        self._digest.update(data)
        return self._stream.write(data)

    def tell(self) -> int:
        """Return the number of bytes written so far."""
        return self._stream.tell()

    def flush(self) -> None:
        """Flush the underlying stream."""
        self._stream.flush()

    def hash(self) -> str:
        """Return the hash of the bytes written so far, as hexadecimal digits."""
        return self._digest.hexdigest()


@contextlib.contextmanager
def converting_errors(path: Path) -> Iterator[None]:
    """Convert an OSError while writing ``path`` to a StoreError that says what to do."""
    try:
        yield
    except OSError as error:
        advice = _ADVICE.get(error.errno or 0, error.strerror or str(error))
        raise StoreError(f"{path} cannot be written: {advice}") from error


def replace_together(folder: Path, contents: Mapping[str, Content], void: str | None = None) -> None:
    """Write several files into an existing folder, so that either all of them are written completely or none.

    ``contents`` are by file name, in which ``/`` separates a sub-folder. ``void`` is the name of the file that declares
    all others valid. It is deleted before the first rename, so that after a power cut between two renames no file
    declares a mixture of old and new files valid. Raises StoreError if the folder cannot be written, for example
    because the disk is full; the previous files are then still there.
    """
    temporary: dict[Path, Path] = {}
    try:
        for name, content in contents.items():
            path = resolve_path(folder, name)
            temporary[path] = path.with_name(f".{path.name}.{os.getpid()}{_TEMPORARY}")
            with converting_errors(path):
                path.parent.mkdir(exist_ok=True)
                temporary[path].unlink(missing_ok=True)
                with temporary[path].open("xb") as stream:  # "x": do not follow a symbolic link
                    if isinstance(content, bytes):
                        stream.write(content)
                    else:
                        content(stream)
                    stream.flush()
                    os.fsync(stream.fileno())
                if path.is_dir():
                    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with delaying_signals():
            if void is not None:
                resolve_path(folder, void).unlink(missing_ok=True)
            for path, written in temporary.items():
                with converting_errors(path):
                    written.replace(path)
    finally:
        for written in temporary.values():
            written.unlink(missing_ok=True)


def write_files(folder: Path, contents: Mapping[str, Content]) -> None:
    """Write files as :func:`replace_together` does; the folder and its sub-folders are created if needed."""
    with converting_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name in contents:
            resolve_path(folder, name).parent.mkdir(parents=True, exist_ok=True)
    replace_together(folder, contents)


def resolve_path(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder; ``/`` in the name separates a sub-folder.

    Raises StoreError if the path would be outside the folder, by its name or because a sub-folder is a symbolic link.
    The folder itself may be a link, since the user chose it.
    """
    parts = PurePosixPath(name).parts
    if not parts or name.startswith("/") or ".." in parts or "\0" in name or "\\" in name:
        raise StoreError(f"{folder}: {name!r} is not an allowed name of a file in this folder")
    path = folder
    for part in parts[:-1]:
        path = path / part
        if path.is_symlink():
            raise StoreError(f"{path} is a symbolic link out of the run folder: delete it and run again")
    return path / parts[-1]


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files of a killed run; call this only while holding the folder's lock."""
    for path in folder.rglob(f".*{_TEMPORARY}"):
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def delaying_signals() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM until the block ends, if the system supports it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


try:
    import fcntl
except ImportError:  # Windows, where every disk supports locks
    fcntl = None  # type: ignore[assignment]

LOCK, MARKER = "lock", "lock.held"
"""Files in ``.mocap-id``. The marker exists only during a run on a disk without locks."""

_UNKNOWN = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)


def create_lock(hidden: Path) -> BaseFileLock:
    """Return the lock of a run folder without acquiring it; ``hidden`` is the folder ``.mocap-id`` in the run folder.

    On a disk without locks, as some network disks are, it is a file. Raises OSError if the folder is not writable.
    """
    path = hidden / LOCK
    if fcntl is None:
        return FileLock(path)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # another process has locked it
        pass
    except OSError as error:
        if error.errno not in _UNKNOWN:
            raise
        return SoftFileLock(hidden / MARKER)
    finally:
        os.close(descriptor)
    return FileLock(path)
