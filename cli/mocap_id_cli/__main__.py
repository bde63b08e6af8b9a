"""The door: every error becomes one message and one exit code, every signal an orderly stop."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from mocap_id.errors import MocapIdError, NumericalError

_LARGE = 4 << 20
"""Bytes: memory of this size and more goes back to the system when an array goes."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # glibc's numbers
_EXIT_CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}


class Interrupted(BaseException):
    """Ctrl-C or SIGTERM, past everything that catches exceptions."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = _EXIT_CODES[signal.Signals(number)]


def main() -> None:
    """Entry point of ``mocap-id``."""
    sys.exit(guarded(_command_line))


def guarded(call: Callable[[], None]) -> int:
    """Make a call; its exit code, with a message on stderr where it failed, never a traceback."""
    before = {number: signal.signal(number, _interrupt) for number in _EXIT_CODES}
    try:
        call()
    except MocapIdError as error:
        return _fail(_sentence(error), error.exit_code)
    except Interrupted as interruption:
        return _fail("interrupted: nothing is half-written; the same command goes on from here", interruption.exit_code)
    except BrokenPipeError:
        sys.stdout = None  # whoever read our output has gone: do not flush it
        return 0
    except Exception as error:  # noqa: BLE001  the last stop: a user sees a sentence, not a traceback
        what = str(error).partition("\n")[0]
        return _fail(f"unforeseen failure, {type(error).__name__}: {what}; please report it", NumericalError.exit_code)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _command_line() -> None:
    # Matrices are small here: threads of the linear algebra would wait for each other longer than they compute.
    for library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # there are none of ours; looking for them takes 12 ms
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # which gives back what tables no longer need
    _return_memory()
    gc.set_threshold(50_000, 20, 20)  # the libraries' objects stay: looking for garbage among them takes 0.1 s of a run
    from mocap_id_cli import progress as live  # noqa: PLC0415  so that Ctrl-C during the imports is orderly too
    from mocap_id_cli.app import build  # noqa: PLC0415

    try:
        build()(prog_name="mocap-id")
    finally:
        live.stop()


def _return_memory() -> None:
    """Keep the C library, where it is glibc, from holding back the room of arrays that are gone.

    It learns from every large array to keep the next one's room for itself: a tenth of a long recording's peak.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        for option in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD):
            ctypes.CDLL(None).mallopt(option, _LARGE)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise Interrupted(number)


def _sentence(error: MocapIdError) -> str:
    """The message after what it is about; paths below the working folder without it."""
    about = "".join(f"{note}: " for note in getattr(error, "__notes__", []))
    return f"{about}{error}".replace(f"{Path.cwd()}/", "")


def _fail(message: str, code: int) -> int:
    print(f"mocap-id: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
