"""Hashes of bytes: of files as they stand, and of files while they are written."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, BinaryIO

from mocap_id import plain_files

_CHUNK = 1 << 20  # bytes of a file


def hash_bytes(content: bytes) -> str:
    """Hash of a document or of a canonical string."""
    return hashlib.sha256(content).hexdigest()


def hash_file(path: Path, *, links: bool = True) -> str:
    """Hash of a file's bytes.

    Parameters
    ----------
    path : Path
    links : bool
        Whether the path itself may be a symbolic link.

    Raises
    ------
    OSError
        The file cannot be read, is no plain file, or changes meanwhile: see :mod:`mocap_id.plain_files`.
    """
    digest = hashlib.sha256()
    with plain_files.opened(path, links=links) as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


class HashedStream:
    """A stream to write to, from beginning to end, that hashes what goes through it."""

    closed = False

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._digest = stream, hashlib.sha256()

    def write(self, data: Any) -> int:
        """Write all of a buffer."""
        self._digest.update(data)
        return self._stream.write(data)

    def tell(self) -> int:
        """Bytes written so far."""
        return self._stream.tell()

    def flush(self) -> None:
        """As the stream does."""
        self._stream.flush()

    def hash(self) -> str:
        """Hash of what has been written so far."""
        return self._digest.hexdigest()
