"""Processes beside this one: started so that Ctrl-C does not reach them, and ended in order."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

_PATIENCE = 20.0  # s, for a process that was told to end


@contextmanager
def no_ctrl_c() -> Iterator[None]:
    """Start processes that Ctrl-C does not reach, wherever in their imports they are: this one ends them in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def end(pool: ProcessPoolExecutor) -> None:
    """Tell the processes to end, whatever they are at, and wait for them."""
    pool.shutdown(wait=False, cancel_futures=True)
    children = multiprocessing.active_children()
    for process in children:
        process.terminate()
    for process in children:
        process.join(_PATIENCE)
