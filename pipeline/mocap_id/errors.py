"""Everything that can go wrong, and the exit code that says so.

::

    MocapIdError
    ├── ConfigError          2   the command line or a configuration is wrong
    ├── RecordingError       3   an input is missing, unreadable or contradicts itself
    ├── Refused              4   the motion is not what the method can treat (carries the reasons)
    ├── NumericalError       5   a computation failed that should not have
    └── StoreError           6   an artefact or the output folder is missing, stale, damaged, locked or not writable

Messages name the file or trial, what was found, what was expected, and what to do.
"""

from __future__ import annotations

from typing import ClassVar


class MocapIdError(Exception):
    """Base of every error that mocap-id raises on purpose."""

    exit_code: ClassVar[int] = 1


class ConfigError(MocapIdError):
    """The command line or a configuration file is wrong."""

    exit_code = 2


class RecordingError(MocapIdError):
    """A recording is missing, unreadable or contradicts itself."""

    exit_code = 3


class Refused(MocapIdError):
    """The method cannot treat this motion: a verdict, not a failure.

    Parameters
    ----------
    code, message, value, limit
        As in :class:`mocap_id.verdict.Reason`.
    """

    exit_code = 4

    def __init__(self, code: str, message: str, value: float | None = None, limit: float | None = None) -> None:
        super().__init__(message)
        self.code, self.message, self.value, self.limit = code, message, value, limit

    def __reduce__(self) -> tuple[type[Refused], tuple[str, str, float | None, float | None]]:
        """Pickle with every argument, so that a refusal passes between processes."""
        return type(self), (self.code, self.message, self.value, self.limit)


class NumericalError(MocapIdError):
    """A computation failed (no convergence, a singular system) on input that passed every check."""

    exit_code = 5


class StoreError(MocapIdError):
    """An artefact or the output folder is missing, stale, damaged, locked, full or not writable."""

    exit_code = 6
