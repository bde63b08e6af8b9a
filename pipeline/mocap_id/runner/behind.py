"""Jobs that are done behind the computation, one after the other, by one thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

from mocap_id.store.atomic import uninterrupted


class Behind:
    """One thread that does jobs in their order; after one has failed, none begins.

    The failure is raised by the next call of :meth:`do` or :meth:`settle`. Leaving the context waits for the jobs that
    were given, whatever signals come meanwhile, and raises no failure of theirs.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="writer")
        self._jobs: list[Future[None]] = []
        self._failed = False

    def __enter__(self) -> Behind:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with uninterrupted():
            try:
                self._pool.shutdown()
            except BaseException:  # a signal after all: a thread that does not hold it back has taken it
                self._pool.shutdown()
                raise

    def do(self, job: Callable[[], None]) -> None:
        """Give a job."""
        if self._failed:
            self.settle()
        self._jobs.append(self._pool.submit(self._done, job))

    def settle(self) -> None:
        """Wait until all jobs are done; raises what the first that failed has raised."""
        jobs, self._jobs = self._jobs, []
        for job in jobs:
            job.result()

    def _done(self, job: Callable[[], None]) -> None:
        if self._failed:
            return
        try:
            job()
        except BaseException:
            self._failed = True
            raise
