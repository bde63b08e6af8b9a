"""Distribution of many trials to the workers of a backend, with recovery from killed processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future
from queue import Empty, SimpleQueue
from typing import Literal, TypeAlias

from mocap_id.config import Trial
from mocap_id.workflows.parallel.backends import Backend, LocalBackend, Workers
from mocap_id.workflows.parallel.trial import (
    RunTrial,
    TrialRun,
    make_killed,
    make_not_run,
    run_trial,
    run_until_terminated,
)

OnError: TypeAlias = Literal["continue", "stop"]
TrialCallback: TypeAlias = Callable[[TrialRun], None]
_Numbered: TypeAlias = tuple[int, Trial]
_Done: TypeAlias = tuple[int, TrialRun]
_POLLING_INTERVAL = 5.0  # s, after which the number of workers is checked again


def run_trials(
    trials: Sequence[Trial],
    backend: Backend,
    tell: TrialCallback = lambda done: None,
    on_error: OnError = "continue",
    run: RunTrial = run_trial,
) -> tuple[TrialRun, ...]:
    """Run every trial that is not up to date, and return the results in the order of the trials.

    Parameters
    ----------
    trials : sequence of Trial
    backend : Backend
        Where the trials run.
    tell : callable
        Called with the result of each trial as soon as the trial finishes.
    on_error : {"continue", "stop"}
        With ``stop``, no trial starts after one that failed or was refused; running trials are allowed to finish.
    run : callable, optional
        Runs one trial; :func:`run_trial` by default.
    """
    results: dict[int, TrialRun] = {}
    queue = _Queue(trials, run, stop=on_error == "stop")
    for number, done in _run_in_parallel(queue, backend) if backend.parallel and len(trials) > 1 else _run_here(queue):
        tell(done)
        results[number] = done
        queue.note(done)
    return tuple(results.get(number) or make_not_run(trial) for number, trial in enumerate(trials))


class _Queue:
    """The trials that have not started, and the function that runs them."""

    def __init__(self, trials: Sequence[Trial], run: RunTrial, *, stop: bool) -> None:
        self.run = run
        self._left = deque(enumerate(trials))
        self._stop = stop

    def __len__(self) -> int:
        return len(self._left)

    def next(self) -> _Numbered:
        return self._left.popleft()

    def note(self, done: TrialRun) -> None:
        if self._stop and done.exit_code != 0:
            self._left.clear()


def _run_here(queue: _Queue) -> Iterator[_Done]:
    while queue:
        number, trial = queue.next()
        yield number, queue.run(trial)


def _run_in_parallel(queue: _Queue, backend: Backend) -> Iterator[_Done]:
    """Run all trials in parallel; start new workers whenever a process was killed."""
    while queue:
        lost: list[_Numbered] = []
        with backend.workers(len(queue)) as workers:
            yield from _run_until_broken(queue, workers, lost)
        for number, trial in lost:  # one of these killed the process: run each in its own process
            yield number, _run_alone(queue.run, trial)


def _run_until_broken(queue: _Queue, workers: Workers, lost: list[_Numbered]) -> Iterator[_Done]:
    """Submit trials until all trials are done or the pool breaks; append the interrupted trials to ``lost``."""
    submitted: dict[Future[TrialRun], _Numbered] = {}
    # Futures report here when they finish: polling all of them would be expensive on a large cluster.
    finished: SimpleQueue[Future[TrialRun]] = SimpleQueue()
    while True:
        width = workers.width()  # also if nothing is left to submit: this checks the versions of new workers
        while queue and not lost and len(submitted) < width:
            numbered = queue.next()
            try:
                future = workers.executor.submit(run_until_terminated, queue.run, numbered[1])
            except BrokenExecutor:
                lost.append(numbered)
            else:
                submitted[future] = numbered
                future.add_done_callback(finished.put)
        if not submitted:
            return
        try:
            future = finished.get(timeout=_POLLING_INTERVAL)
        except Empty:  # more workers may have joined
            continue
        yield from _read_result(future, submitted.pop(future), lost)


def _read_result(future: Future[TrialRun], numbered: _Numbered, lost: list[_Numbered]) -> Iterator[_Done]:
    """Yield the result of a finished future; add its trial to ``lost`` if the pool broke."""
    number, trial = numbered
    try:
        yield number, future.result()
    except BrokenExecutor:
        lost.append(numbered)
    except Exception as error:
        if type(error).__name__ != "KilledWorker":  # defined by distributed, which may not be installed
            raise
        yield number, make_killed(trial)


def _run_alone(run: RunTrial, trial: Trial) -> TrialRun:
    """Run a trial in a new process of its own; if this process is killed, only this trial fails."""
    with LocalBackend(1).workers(1) as workers:
        try:
            return workers.executor.submit(run_until_terminated, run, trial).result()
        except BrokenExecutor:
            return make_killed(trial)
