"""Python's search for cycles of garbage, put off while something is drawn."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def put_off() -> Iterator[None]:
    """No search for cycles of garbage within this; afterwards as it was before.

    A figure is made of tens of thousands of objects that point at each other and live until it is written. The search
    sets in for every few hundred new ones and finds nothing to free among them: a tenth of a report's time. Once it is
    written, :func:`clear` takes it away.
    """
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def clear() -> None:
    """Take away what has become garbage lately: a figure that is written."""
    gc.collect(0)
