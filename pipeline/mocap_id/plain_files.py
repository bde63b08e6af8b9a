"""Safe reading of regular files: pipes, devices and files that change during reading are errors."""

from __future__ import annotations

import errno
import os
import stat
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

LARGEST = 4 << 30
"""Largest size of a file, bytes. No recording is this large, and a sparse file of this size would keep a run busy for
hours."""

_KINDS = (
    (stat.S_ISFIFO, "it is a pipe"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
    (stat.S_ISSOCK, "it is a socket"),
)


class ChangedError(OSError):
    """Error for a file that changed while it was being read."""


@contextmanager
def open_file(path: Path, *, links: bool = True) -> Iterator[BinaryIO]:
    """Open a regular file for reading, and check on closing that it has not changed.

    ``links`` says whether ``path`` itself may be a symbolic link. Raises OSError if the file is missing, cannot be
    opened, is too large, or is not a regular file (a pipe, a device, a folder); ``strerror`` is the cause. Raises
    ChangedError if the file was written to while it was open.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "its name contains a NUL", str(path))
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags if links else flags | getattr(os, "O_NOFOLLOW", 0))
    except UnicodeError as error:
        raise OSError(errno.EINVAL, "its name cannot be written on this system", str(path)) from error
    except OSError as error:
        if error.errno == errno.ELOOP:
            why = "it is a symbolic link" if not links and path.is_symlink() else "its symbolic links form a loop"
            raise OSError(errno.ELOOP, why, str(path)) from None
        if error.errno == errno.ENXIO:
            raise OSError(errno.ENXIO, "it is a socket, or a device that does not exist", str(path)) from None
        raise
    with os.fdopen(descriptor, "rb") as stream:
        before = os.fstat(descriptor)
        if stat.S_ISDIR(before.st_mode):
            raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
        if not stat.S_ISREG(before.st_mode):
            kind = next((text for is_kind, text in _KINDS if is_kind(before.st_mode)), "it is not a regular file")
            raise OSError(errno.EINVAL, kind, str(path))
        if before.st_size > LARGEST:
            raise OSError(errno.EFBIG, f"it has {before.st_size} bytes, more than any recording", str(path))
        yield stream
        after = os.fstat(descriptor)
        if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
            raise _changed_error(path)


def read_bytes(path: Path, *, links: bool = True, largest: int = LARGEST) -> bytes:
    """Return all bytes of a regular file.

    Raises the errors of :func:`open_file`, and OSError if the file has more than ``largest`` bytes.
    """
    with open_file(path, links=links) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > largest:
            raise OSError(errno.EFBIG, f"it has {size} bytes, expected at most {largest}", str(path))
        content = stream.read(size + 1)
        if len(content) != size:
            raise _changed_error(path)
        return content


def _changed_error(path: Path) -> ChangedError:
    return ChangedError(errno.EAGAIN, "it changed while it was being read: wait until it is complete", str(path))


def suggest(path: Path) -> str:
    """Return the end of a message about a missing file: the file that was probably meant, or an empty text.

    The names differ in capital letters, in the encoding of accents (NFC and NFD), or in backslashes.
    """
    try:
        wanted = path if os.sep == "\\" else Path(str(path).replace("\\", "/"))
        here = Path(wanted.anchor)
        for part in wanted.relative_to(wanted.anchor).parts:
            if part == ".." or (here / part).exists():
                here /= part
                continue
            alike = [each for each in sorted(entry.name for entry in here.iterdir()) if _fold(each) == _fold(part)]
            if not alike:
                return ""
            here /= next((each for each in alike if each.casefold() == part.casefold()), alike[0])
    except (OSError, ValueError):
        return ""
    if here == path:
        return ""
    if here == wanted:
        why = "write its path with / instead of \\"
    elif str(here).casefold() == str(wanted).casefold():
        why = "this system distinguishes capital and small letters"
    else:
        why = "the name looks the same, but its accents are stored differently: copy the name, or rename the file"
    return f"; there is {here}: {why}"


def _fold(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
