"""Exceptions and their exit codes.

::

    MocapIdError
    ├── ConfigError          2   the command line or a configuration is wrong
    ├── RecordingError       3   an input is missing, unreadable or contradicts itself
    ├── Refused              4   the method cannot process this motion; the exception contains the reason
    ├── NumericalError       5   a computation failed on valid input
    └── StoreError           6   an artefact or the run folder is missing, stale, damaged, locked or not writable

A message names the file or trial and says what was found, what was expected and what to do.
"""

from __future__ import annotations

from typing import ClassVar


class MocapIdError(Exception):
    """Base class of all errors that mocap-id raises deliberately."""

    exit_code: ClassVar[int] = 1


class ConfigError(MocapIdError):
    """Error in the command line or in a configuration file."""

    exit_code = 2


class RecordingError(MocapIdError):
    """Error for a recording or another input that is missing, unreadable or contradictory."""

    exit_code = 3


class Refused(MocapIdError):
    """Refusal of a motion that the method cannot process, with the fields of a :class:`mocap_id.verdict.Reason`."""

    exit_code = 4

    def __init__(self, code: str, message: str, value: float | None = None, limit: float | None = None) -> None:
        super().__init__(message)
        self.code, self.message, self.value, self.limit = code, message, value, limit

    def __reduce__(self) -> tuple[type[Refused], tuple[str, str, float | None, float | None]]:
        """Return all arguments for pickle, so that a refusal can be sent between processes."""
        return type(self), (self.code, self.message, self.value, self.limit)


class NumericalError(MocapIdError):
    """Failure of a computation on input that passed all checks, such as no convergence or a singular system."""

    exit_code = 5


def first_line(error: Exception) -> str:
    """Return the first line of an exception's message, or the exception's type if it has no message."""
    return str(error).partition("\n")[0] or type(error).__name__


class StoreError(MocapIdError):
    """Error for an artefact or run folder that is missing, stale, damaged, locked, full or not writable."""

    exit_code = 6
