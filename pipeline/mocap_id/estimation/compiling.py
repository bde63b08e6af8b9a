"""Compilation of the inner loops: once for a machine, kept between runs."""

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
    """Compile a function of numbers and arrays to machine code, kept on disk for the next run.

    The code is kept beside the source or, where that folder is read-only, in the user's cache folder; where no folder
    can be written it is compiled anew in every run, which a log entry says. Numba keeps it until the function's own
    file changes, and looks at no other: functions that call each other live in one file.
    """
    try:
        return cast(Callable[P, T], numba.njit(cache=True, **_OPTIONS)(function))
    except RuntimeError as error:
        _log.warning("%s is compiled anew in every run: %s (set NUMBA_CACHE_DIR)", function.__name__, error)
        return cast(Callable[P, T], numba.njit(**_OPTIONS)(function))
