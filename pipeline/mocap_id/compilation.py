"""Compilation of functions to machine code with numba; the code is cached on disk between runs."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

P = ParamSpec("P")
T = TypeVar("T")

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}

_log = logging.getLogger(__name__)


class _CompiledCode(FunctionCache):
    """A numba cache that loads compiled code without importing the compiler, which takes 0.3 s, a tenth of a run.

    It uses a private method of numba. If a later version of numba lacks this method, the compiler is imported.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        if not hasattr(self, "_load_overload"):
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        rtsys.initialize(target_context)  # compiled code allocates arrays
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile a function of numbers and arrays to machine code, and cache the code on disk.

    The cache is beside the source file, or in the user's cache folder if the source folder is read-only. Without a
    writable folder the function is compiled in every run, with a warning in the log. Numba renews the cache only if the
    function's own file changes. Functions that call each other must therefore be in one file.
    """
    try:
        dispatcher = numba.njit(cache=True, **_OPTIONS)(function)
        dispatcher._cache = _CompiledCode(function)  # type: ignore[no-untyped-call]
        return cast(Callable[P, T], dispatcher)
    except RuntimeError as error:
        _log.warning("%s is compiled in every run: %s (set NUMBA_CACHE_DIR)", function.__name__, error)
        return cast(Callable[P, T], numba.njit(**_OPTIONS)(function))
