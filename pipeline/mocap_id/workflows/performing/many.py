"""Many trials: as many at a time as there are workers, and those that take their worker along told apart."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future
from queue import Empty, SimpleQueue
from typing import Literal, TypeAlias

from mocap_id.config import Trial
from mocap_id.workflows.performing.engine import Engine, Here, Workers
from mocap_id.workflows.performing.one import How, Performed, killed, not_run, perform, perform_until_told

OnError: TypeAlias = Literal["continue", "stop"]
Tell: TypeAlias = Callable[[Performed], None]
_Done: TypeAlias = tuple[int, Performed]
_LOOKED_AGAIN = 5.0  # s, at whether more workers have come


def perform_all(
    trials: Sequence[Trial],
    engine: Engine,
    tell: Tell = lambda done: None,
    on_error: OnError = "continue",
    how: How = perform,
) -> tuple[Performed, ...]:
    """Run every trial that is not up to date.

    Parameters
    ----------
    trials : sequence of Trial
    engine : Engine
        Where they are run.
    tell : callable
        Told of each trial once it is done, in the order in which they end.
    on_error : {"continue", "stop"}
        With ``stop`` no trial is begun after one that failed or was refused; those at work are let finish.
    how : callable, optional
        Runs one trial; :func:`perform` by default.

    Returns
    -------
    tuple of Performed
        In the order of the trials.
    """
    found: dict[int, Performed] = {}
    going = _Going(trials, how, stop=on_error == "stop")
    for number, done in _each(going, engine) if engine.side_by_side and len(trials) > 1 else _one_by_one(going):
        tell(done)
        found[number] = done
        going.note(done)
    return tuple(found.get(number) or not_run(trial) for number, trial in enumerate(trials))


class _Going:
    """The trials that are still to be begun, and how."""

    def __init__(self, trials: Sequence[Trial], how: How, *, stop: bool) -> None:
        self.how = how
        self._left = deque(enumerate(trials))
        self._stop = stop

    def __len__(self) -> int:
        return len(self._left)

    def next(self) -> tuple[int, Trial]:
        return self._left.popleft()

    def note(self, done: Performed) -> None:
        if self._stop and done.exit_code != 0:
            self._left.clear()


def _one_by_one(going: _Going) -> Iterator[_Done]:
    while going:
        number, trial = going.next()
        yield number, going.how(trial)


def _each(going: _Going, engine: Engine) -> Iterator[_Done]:
    """Side by side, and again with new workers after one was killed, until every trial is done."""
    while going:
        lost: list[tuple[int, Trial]] = []
        with engine.workers(len(going)) as workers:
            yield from _side_by_side(going, workers, lost)
        for number, trial in lost:  # one of those that were at work then: each by itself
            yield number, _alone(going.how, trial)


def _side_by_side(going: _Going, workers: Workers, lost: list[tuple[int, Trial]]) -> Iterator[_Done]:
    """Keep the workers busy until all is done, or until the processes break down with what is then in ``lost``."""
    asked: dict[Future[Performed], tuple[int, Trial]] = {}
    # Each that ends comes here by itself: to look through all that are asked would cost a large cluster dear.
    ended: SimpleQueue[Future[Performed]] = SimpleQueue()
    while True:
        while going and not lost and len(asked) < workers.width():
            one = going.next()
            try:
                future = workers.executor.submit(perform_until_told, going.how, one[1])
            except BrokenExecutor:
                lost.append(one)
            else:
                asked[future] = one
                future.add_done_callback(ended.put)
        if not asked:
            return
        try:
            future = ended.get(timeout=_LOOKED_AGAIN)
        except Empty:  # there may be more workers by now
            continue
        yield from _told(future, asked.pop(future), lost)


def _told(future: Future[Performed], one: tuple[int, Trial], lost: list[tuple[int, Trial]]) -> Iterator[_Done]:
    """What came of a trial; into ``lost`` where its process broke down."""
    number, trial = one
    try:
        yield number, future.result()
    except BrokenExecutor:
        lost.append(one)
    except Exception as error:
        if type(error).__name__ != "KilledWorker":  # distributed's, which may not be installed
            raise
        yield number, killed(trial)


def _alone(how: How, trial: Trial) -> Performed:
    """A trial in a process of its own, which it may take along."""
    with Here(1).workers(1) as workers:
        try:
            return workers.executor.submit(perform_until_told, how, trial).result()
        except BrokenExecutor:
            return killed(trial)
