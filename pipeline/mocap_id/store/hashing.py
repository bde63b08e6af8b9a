"""SHA-256 hashes of bytes, of files, and of a file while it is being written."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, BinaryIO

from mocap_id import plain_files

_CHUNK = 1 << 20  # bytes read at a time


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
