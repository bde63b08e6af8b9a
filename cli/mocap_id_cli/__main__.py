"""Entry point of the program, which turns errors and signals into messages and exit codes."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import os
import signal
import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from pathlib import Path
from types import FrameType, ModuleType

from mocap_id.errors import MocapIdError, NumericalError

_LARGE = 16 << 20
"""Size in bytes from which freed blocks of memory are returned to the system."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # option numbers of glibc
_UNUSED = frozenset({"numpy.f2py", "numpy.testing", "yaml"})
"""Modules that scipy and numba import but do not use in a run."""
_EXIT_CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}


class Interrupted(BaseException):
    """Exception for Ctrl-C or SIGTERM; it is a BaseException, so that no handler of errors catches it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = _EXIT_CODES[signal.Signals(number)]


class _LazyFinder(MetaPathFinder):
    """A finder that delays the import of ``_UNUSED`` modules until they are used, because it takes 0.08 s."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path) if name in _UNUSED else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def main() -> None:
    """Run ``mocap-id`` and exit."""
    if not any(isinstance(finder, _LazyFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _LazyFinder())
    sys.exit(exit_code(_command_line))


def exit_code(call: Callable[[], None]) -> int:
    """Call a function and return the exit code; if it fails, print a message on standard error and no traceback."""
    before = {number: signal.signal(number, _interrupt) for number in _EXIT_CODES}
    try:
        call()
    except MocapIdError as error:
        return _fail(_format_error(error), error.exit_code)
    except Interrupted as interruption:
        return _fail(
            "interrupted: no file is half-written, and the same command continues from here", interruption.exit_code
        )
    except BrokenPipeError:
        sys.stdout = None  # nobody reads the output any more, so it must not be flushed
        return 0
    except Exception as error:  # noqa: BLE001  users should see a sentence, not a traceback
        what = str(error).partition("\n")[0]
        return _fail(f"unforeseen failure, {type(error).__name__}: {what}; please report it", NumericalError.exit_code)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _command_line() -> None:
    # The matrices are so small that threads of the linear algebra would wait for each other longer than they compute.
    for library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # no plugin is used, and the search for them takes 12 ms
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # this pool returns the memory of freed tables
    _return_memory()
    gc.set_threshold(50_000, 20, 20)  # saves 0.1 s of a run, because the libraries' objects are permanent
    atexit.register(gc.freeze)  # saves a tenth of a run, because Python then skips the garbage collection at the end
    from mocap_id_cli import commands, progress  # noqa: PLC0415  so that Ctrl-C during the imports is handled too

    try:
        commands.build()(prog_name="mocap-id")
    finally:
        progress.stop()


def _return_memory() -> None:
    """Make glibc return the memory of freed arrays to the system.

    By default, glibc raises its thresholds after each large array. This increases the peak memory of a long recording
    by a tenth.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        for option in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD):
            ctypes.CDLL(None).mallopt(option, _LARGE)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise Interrupted(number)


def _format_error(error: MocapIdError) -> str:
    """Return the message, preceded by its notes, with paths relative to the working folder."""
    about = "".join(f"{note}: " for note in getattr(error, "__notes__", []))
    return f"{about}{error}".replace(f"{Path.cwd()}/", "")


def _fail(message: str, code: int) -> int:
    print(f"mocap-id: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
