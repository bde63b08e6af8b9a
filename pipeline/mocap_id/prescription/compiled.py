"""Compilation of this package's inner loops, kept between runs where a folder can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile a function of numbers and arrays; those that call each other live in one file, which numba watches."""
    try:
        return cast(Callable[P, T], numba.njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # no folder to keep the code in: compiled anew in every run
        return cast(Callable[P, T], numba.njit(error_model="numpy")(function))
