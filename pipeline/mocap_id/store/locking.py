"""Lock of a run folder: a lock of the system or, on disks without locks, a file that exists during the run."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from filelock import BaseFileLock, FileLock, SoftFileLock

try:
    import fcntl
except ImportError:  # Windows, where every disk supports locks
    fcntl = None  # type: ignore[assignment]

LOCK, MARKER = "lock", "lock.held"
"""Files in ``.mocap-id``. The marker exists only during a run on a disk without locks."""

_UNKNOWN = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)


def create_lock(hidden: Path) -> BaseFileLock:
    """Return the lock of a run folder without acquiring it; ``hidden`` is the folder ``.mocap-id`` in the run folder.

    Raises OSError if the folder is not writable.
    """
    return FileLock(hidden / LOCK) if _supports_locks(hidden / LOCK) else SoftFileLock(hidden / MARKER)


def _supports_locks(path: Path) -> bool:
    """Return whether the disk supports locks; some network disks do not."""
    if fcntl is None:
        return True
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # another process has locked it
        return True
    except OSError as error:
        if error.errno not in _UNKNOWN:
            raise
        return False
    finally:
        os.close(descriptor)
    return True
