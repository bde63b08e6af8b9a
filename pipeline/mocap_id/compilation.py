"""Compilation of inner loops to machine code, cached on disk between runs."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
T = TypeVar("T")

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}

_log = logging.getLogger(__name__)


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile a function of numbers and arrays to machine code, and cache the code on disk.

    The cache is beside the source, or in the user's cache folder if the source is read-only. Without a writable folder
    the function is compiled in every run, with a warning in the log. Numba renews the cache only if the function's own
    file changes, so functions that call each other must be in one file.
    """
    try:
        return cast(Callable[P, T], numba.njit(cache=True, **_OPTIONS)(function))
    except RuntimeError as error:
        _log.warning("%s is compiled in every run: %s (set NUMBA_CACHE_DIR)", function.__name__, error)
        return cast(Callable[P, T], numba.njit(**_OPTIONS)(function))
