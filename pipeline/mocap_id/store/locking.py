"""The lock of a run folder: the system's own, or where the disk has none, a file that stands for as long as the run."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from filelock import BaseFileLock, FileLock, SoftFileLock

try:
    import fcntl
except ImportError:  # a system whose locks need no asking
    fcntl = None  # type: ignore[assignment]

LOCK, MARKER = "lock", "lock.held"
"""Names in the folder of the program's own. The marker stands only while a run goes on where nothing can be locked."""

_UNKNOWN = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)


def lock_in(own: Path) -> BaseFileLock:
    """The lock of the run folder whose folder of the program's own this is; not taken yet.

    Raises
    ------
    OSError
        No file can be written there.
    """
    return FileLock(own / LOCK) if _can_be_locked(own / LOCK) else SoftFileLock(own / MARKER)


def _can_be_locked(place: Path) -> bool:
    """Whether a file there can be: not on every network disk."""
    if fcntl is None:
        return True
    descriptor = os.open(place, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # another one holds it
        return True
    except OSError as error:
        if error.errno not in _UNKNOWN:
            raise
        return False
    finally:
        os.close(descriptor)
    return True
