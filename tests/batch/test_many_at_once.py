"""What handing out a trial costs does not grow with how many there are, nor with how many are run at a time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from batch_cases import trials

from mocap_id.config import Trial
from mocap_id.config import parsing as source_module
from mocap_id.workflows import batch, parallel
from mocap_id.workflows.batch import find_trials
from mocap_id.workflows.parallel import Backend, TrialRun, Workers, run_trials

distributed = pytest.importorskip("distributed", reason="Dask is not installed: mocap-id[cluster]")


class Counted:
    """A lock's condition that counts how often anybody takes it."""

    def __init__(self) -> None:
        self.taken = 0
        self._own = threading.Condition()

    def acquire(self, *how: Any) -> bool:
        self.taken += 1
        return self._own.acquire(*how)

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *problem: Any) -> None:
        self._own.__exit__(*problem)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._own, name)


class InOrder(Executor):
    """Ends one trial after another, each when the one before was told of, once as many wait as are asked at a time."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.most = self.looks = 0
        self._waiting: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work)
        self._enough = threading.Event()
        self.told = threading.Semaphore(1)
        self._futures: list[Counted] = []
        self._thread.start()

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future._condition = counted = Counted()  # type: ignore[assignment]
        self._futures.append(counted)
        self.most = max(self.most, self._waiting.qsize() + 1)
        self._waiting.put((future, lambda: fn(*args, **kwargs)))
        if self._waiting.qsize() >= self.width:
            self._enough.set()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._waiting.put(None)
        self._thread.join()
        self.looks = sum(one.taken for one in self._futures)

    def _work(self) -> None:
        self._enough.wait()
        while (one := self._waiting.get()) is not None:
            future, call = one
            assert self.told.acquire(timeout=30)
            future.set_result(call())


class Wide(Backend):
    """So many trials at a time, none of which takes any."""

    def __init__(self, width: int) -> None:
        self.executor = InOrder(width)

    @property
    def parallel(self) -> bool:
        return True

    @contextmanager
    def workers(self, most: int) -> Iterator[Workers]:
        try:
            yield self.executor, lambda: self.executor.width
        finally:
            self.executor.shutdown()


class Named:
    """A trial of which nothing but its name is asked."""

    def __init__(self, number: int) -> None:
        self.name = f"t{number:05}"


def at_once(trial: Trial) -> TrialRun:
    """A trial that takes no time."""
    return TrialRun(trial.name, 0, None, None, None, computed=True, seconds=0.0)


@pytest.mark.parametrize(("count", "width"), [(300, 2), (3_000, 2), (3_000, 1_000)])
def test_operations_a_trial_are_the_same_for_any_number_of_trials_and_workers(count: int, width: int) -> None:
    wide = Wide(width)
    asked: list[Any] = [Named(k) for k in range(count)]
    told: list[str] = []

    def tell(one: TrialRun) -> None:
        told.append(one.trial)
        wide.executor.told.release()

    done = run_trials(asked, wide, tell, run=at_once)
    assert [one.trial for one in done] == [one.name for one in asked]
    assert sorted(told) == [one.name for one in asked]
    assert wide.executor.most <= width
    assert wide.executor.looks <= 6 * count  # set, given its callback, read: a few each


def test_workers_that_join_later_get_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a cluster's queue gives them: the first trials are asked for when nobody is there yet."""
    monkeypatch.setattr(parallel, "_COUNTING_INTERVAL", 0.2)
    monkeypatch.setattr(parallel, "_LEAST_SUBMITTED", 1)
    with distributed.LocalCluster(
        n_workers=0, threads_per_worker=4, processes=False, dashboard_address=":0", silence_logs=50
    ) as cluster:
        asked: list[Any] = [Named(k) for k in range(60)]
        with parallel.DaskBackend(cluster.scheduler_address).workers(len(asked)) as (_, width):
            assert width() == 1
            cluster.scale(1)
            until = time.monotonic() + 30
            while width() == 1 and time.monotonic() < until:
                time.sleep(0.05)
            assert width() == 8
        done = run_trials(asked, parallel.DaskBackend(cluster.scheduler_address), run=at_once)
        assert [one.trial for one in done] == [one.name for one in asked]


def test_a_worker_that_joins_with_another_version(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []

    class Client:
        """Has one worker at first, then two, the second of another version."""

        def __init__(self) -> None:
            self.threads = {"one": 1}

        def nthreads(self) -> dict[str, int]:
            return self.threads

        def run(self, function: Any, workers: list[str], on_error: str) -> dict[str, str]:
            asked.append(workers)
            return {name: function() if name == "one" else "0.0.1" for name in workers}

    monkeypatch.setattr(parallel, "_COUNTING_INTERVAL", 0.0)
    client = Client()
    joining = parallel._WorkerCount(client)
    assert joining() == parallel._LEAST_SUBMITTED
    client.threads = {"one": 1, "two": 100}
    with pytest.raises(parallel.ConfigError, match=r"two has mocap-id 0\.0\.1"):
        joining()
    assert asked == [["one"], ["two"]]


def test_workers_are_looked_at_while_the_last_trials_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker may join when all trials are submitted."""
    monkeypatch.setattr(parallel, "_POLLING_INTERVAL", 0.1)
    looks: list[int] = []
    release = threading.Event()

    def width() -> int:
        looks.append(1)
        if len(looks) > 3:
            release.set()
        return 16

    class Slow(parallel.Backend):
        @property
        def parallel(self) -> bool:
            return True

        @contextmanager
        def workers(self, most: int) -> Iterator[Workers]:
            with ThreadPoolExecutor(1) as executor:
                yield executor, width

    def run(trial: Any) -> TrialRun:
        assert release.wait(30)
        return at_once(trial)

    asked: list[Any] = [Named(0), Named(1)]
    assert [one.trial for one in run_trials(asked, Slow(), run=run)] == [one.name for one in asked]


@pytest.mark.parametrize("how", ["folder", "pattern"])
def test_each_file_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    trials(tmp_path, [f"t{k}" for k in range(20)])
    read: list[Path] = []

    def reading(file: Path) -> Any:
        read.append(file)
        return source_module.read_source(file)

    monkeypatch.setattr(batch, "read_source", reading)
    monkeypatch.setattr(batch, "load", None)  # which would read it again
    found, unreadable = find_trials([str(tmp_path if how == "folder" else tmp_path / "*.yaml")])
    assert len(found) == 20
    assert unreadable == []
    assert len(read) == len(set(read)) == 20
