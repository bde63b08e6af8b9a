"""Background thread that runs jobs in order, such as writing files, during the computation."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

from mocap_id.store.atomic import delaying_signals


class BackgroundWriter:
    """A thread that runs jobs in order. After a job has failed, no further job starts.

    The next call of :meth:`submit` or :meth:`wait` raises the exception of this job. At the end of the context,
    ``__exit__`` waits for all jobs, even if signals arrive, and raises no exception of a job.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="writer")
        self._jobs: list[Future[None]] = []
        self._failed = False
        self._pool.submit(int)  # start the thread before any job: the pool forgets a thread whose start is interrupted

    def __enter__(self) -> BackgroundWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with delaying_signals():
            try:
                self._pool.shutdown()
            except BaseException:  # a signal may still arrive through a thread that does not block it
                self._pool.shutdown()
                raise

    def submit(self, job: Callable[[], None]) -> None:
        """Add a job to the queue; if an earlier job has failed, raise its exception instead."""
        if self._failed:
            self.wait()
        self._jobs.append(self._pool.submit(self._run, job))

    def wait(self) -> None:
        """Wait until all jobs are done, and raise the exception of the first job that failed."""
        jobs, self._jobs = self._jobs, []
        for job in jobs:
            job.result()

    def _run(self, job: Callable[[], None]) -> None:
        if self._failed:
            return
        try:
            job()
        except BaseException:
            self._failed = True
            raise
