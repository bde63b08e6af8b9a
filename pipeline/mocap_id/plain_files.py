"""Reading files that are nothing but files: no pipe that never ends, no device, nothing that changes meanwhile."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

LARGEST = 4 << 30
"""Bytes: no recording is as large, and a file that only says that it is would keep a run busy for hours."""

_KINDS = (
    (stat.S_ISFIFO, "it is a pipe"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
    (stat.S_ISSOCK, "it is a socket"),
)


class ChangedError(OSError):
    """A file was written to while it was read."""


@contextmanager
def opened(path: Path, *, links: bool = True) -> Iterator[BinaryIO]:
    """A plain file, opened for reading; it must be the same at the end.

    Parameters
    ----------
    path : Path
    links : bool
        Whether the path itself may be a symbolic link.

    Raises
    ------
    OSError
        There is no such file, it cannot be opened, is none (a pipe, a device, a folder), or is too large. Its
        ``strerror`` says so.
    ChangedError
        It was written to before the end.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "its name holds a NUL", str(path))
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags if links else flags | getattr(os, "O_NOFOLLOW", 0))
    except UnicodeError as error:
        raise OSError(errno.EINVAL, "its name cannot be written on this system", str(path)) from error
    except OSError as error:
        raise _explained(path, error, links) from None
    with os.fdopen(descriptor, "rb") as stream:
        before = os.fstat(descriptor)
        _check(path, before)
        yield stream
        after = os.fstat(descriptor)
        if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
            raise _changed(path)


def read(path: Path, *, links: bool = True, largest: int = LARGEST) -> bytes:
    """All bytes of a plain file; errors as for :func:`opened`, one of them for more than ``largest`` bytes."""
    with opened(path, links=links) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > largest:
            raise OSError(errno.EFBIG, f"its {size} bytes are more than the {largest} expected at most", str(path))
        content = stream.read(size + 1)
        if len(content) != size:
            raise _changed(path)
        return content


def _check(path: Path, found: os.stat_result) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(
            errno.EINVAL, next((what for is_, what in _KINDS if is_(found.st_mode)), "it is no file"), str(path)
        )
    if found.st_size > LARGEST:
        raise OSError(errno.EFBIG, f"its {found.st_size} bytes are more than any recording holds", str(path))


def _changed(path: Path) -> ChangedError:
    return ChangedError(errno.EAGAIN, "it changed while it was read: wait until it is complete", str(path))


def _explained(path: Path, error: OSError, links: bool) -> OSError:
    """Why a file cannot be opened, where the system's own words say little."""
    if error.errno == errno.ELOOP:
        why = "it is a symbolic link" if not links and path.is_symlink() else "its links lead round in a circle"
        return OSError(errno.ELOOP, why, str(path))
    if error.errno == errno.ENXIO:
        return OSError(errno.ENXIO, "it is a socket or a device that is not there", str(path))
    return error
