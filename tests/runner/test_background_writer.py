"""The background writer by itself; test_runner has runs with it."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from mocap_id.runner.execution import BackgroundWriter


def test_jobs_are_done_in_their_order_by_one_thread() -> None:
    done: list[tuple[int, int]] = []
    with BackgroundWriter() as writer:
        for k in range(20):
            writer.submit(lambda k=k: done.append((k, threading.get_ident())))  # type: ignore[misc]
        writer.wait()
        assert [k for k, _ in done] == list(range(20))
    assert len({thread for _, thread in done} | {threading.get_ident()}) == 2


def test_after_a_failure_no_job_starts_and_the_failure_is_raised() -> None:
    done: list[str] = []

    def fails() -> None:
        raise OSError("full")

    with BackgroundWriter() as writer:
        writer.submit(fails)
        with pytest.raises(OSError, match="full"):
            for _ in range(1000):
                writer.submit(lambda: done.append("later"))
            writer.wait()
    assert done == []


def test_a_signal_on_leaving_does_not_leave_a_job_undone(monkeypatch: pytest.MonkeyPatch) -> None:
    left, done = threading.Event(), []
    shutdown, told = ThreadPoolExecutor.shutdown, iter([True])

    def interrupted_once(pool: ThreadPoolExecutor, **how: Any) -> None:
        if next(told, False):
            left.set()
            raise KeyboardInterrupt
        shutdown(pool, **how)

    def job() -> None:
        assert left.wait(10)
        done.append("written")

    monkeypatch.setattr(ThreadPoolExecutor, "shutdown", interrupted_once)
    with pytest.raises(KeyboardInterrupt), BackgroundWriter() as writer:
        writer.submit(job)
    assert done == ["written"]


def test_no_thread_is_started_by_a_job(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal that interrupts the start of the thread would leave a thread that nobody waits for."""
    start = threading.Thread.start

    def interrupted(thread: threading.Thread) -> None:
        start(thread)
        raise KeyboardInterrupt

    done = threading.Event()
    with BackgroundWriter() as writer:
        monkeypatch.setattr(threading.Thread, "start", interrupted)
        writer.submit(done.set)
    assert done.is_set()
    with pytest.raises(KeyboardInterrupt):
        BackgroundWriter()
