"""Where trials are run: in this process, in several of this machine, or on the workers of a Dask scheduler.

Both ways of running side by side are an `Executor` of the standard library, so that whoever uses one uses the other.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import multiprocessing
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

from mocap_id import __version__
from mocap_id.errors import ConfigError, NumericalError

_LOGGERS = ("mocap_id", "py.warnings")
_THREADS = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA")}
_MEMORY = {
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "MALLOC_MMAP_THRESHOLD_": "4194304",
    "MALLOC_TRIM_THRESHOLD_": "4194304",
}
"""Room of arrays that are gone goes back to the system, as in the process of the command line."""
_LEAST_WAITING = 16  # trials asked of a scheduler whose workers may still be on their way
_COUNTED_EVERY = 5.0  # s, a scheduler's workers
_PATIENCE = 20.0  # s, for a process that was told to end
_EXTRA = "pip install 'mocap-id[cluster]'"


@dataclass(frozen=True)
class Workers:
    """What runs trials: an executor, and how many trials it should have at a time, which may change as it goes."""

    executor: Executor
    width: Callable[[], int]


class Engine(ABC):
    """Where trials are run."""

    @property
    @abstractmethod
    def side_by_side(self) -> bool:
        """Whether there are other processes than this one."""

    @abstractmethod
    @contextmanager
    def workers(self, most: int) -> Iterator[Workers]:
        """Processes for at most so many trials at a time; they end with the context, at once if it fails."""


@dataclass(frozen=True)
class Here(Engine):
    """Processes of this machine.

    Parameters
    ----------
    jobs : int
        How many trials at a time; 1 for no process beside this one.
    """

    jobs: int = 1

    @property
    def side_by_side(self) -> bool:
        return self.jobs > 1

    @contextmanager
    def workers(self, most: int) -> Iterator[Workers]:
        jobs = min(self.jobs, most)
        # New interpreters, not copies of this one, whose libraries have threads by now.
        context, levels = multiprocessing.get_context("spawn"), {one: logging.getLogger(one).level for one in _LOGGERS}
        with _environment(_THREADS | _MEMORY), _no_ctrl_c():
            pool = ProcessPoolExecutor(jobs, context, _begin, (levels,))
            for _ in range(jobs):
                pool.submit(os.getpid)  # which starts a process
        try:
            yield Workers(pool, lambda: jobs)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            children = multiprocessing.active_children()
            for process in children:
                process.terminate()
            for process in children:
                process.join(_PATIENCE)
            raise
        pool.shutdown()


@dataclass(frozen=True)
class Dask(Engine):
    """The workers of a Dask scheduler, which see the same files under the same paths.

    Parameters
    ----------
    scheduler : str, optional
        Address of one that is running, ``tcp://…``.
    cluster : mapping, optional
        A cluster to deploy for the time of the batch: ``kind`` (``local``, ``ssh``, ``slurm``, ``pbs``, ``sge``,
        ``lsf``), ``workers`` (how many to ask for), and the arguments of Dask's own class for that kind.
    """

    scheduler: str | None = None
    cluster: Mapping[str, Any] = field(default_factory=dict)

    @property
    def side_by_side(self) -> bool:
        return True

    @contextmanager
    def workers(self, most: int) -> Iterator[Workers]:
        distributed = _imported("distributed")
        with ExitStack() as stack:
            address = self.scheduler or stack.enter_context(_deployed(self.cluster))
            try:
                client = stack.enter_context(distributed.Client(address, set_as_default=False))
            except (OSError, TimeoutError, ValueError) as error:
                raise ConfigError(
                    f"no Dask scheduler answers at {address} ({error}): start one with `dask scheduler`"
                ) from error
            try:
                yield Workers(client.get_executor(pure=False), _Joining(client))
            except (CancelledError, distributed.CommClosedError) as error:
                raise NumericalError(
                    f"the Dask scheduler at {address} was lost: what is done is kept, run again for the rest"
                ) from error


_KINDS = {
    "local": ("distributed", "LocalCluster"),
    "ssh": ("distributed", "SSHCluster"),
    "slurm": ("dask_jobqueue", "SLURMCluster"),
    "pbs": ("dask_jobqueue", "PBSCluster"),
    "sge": ("dask_jobqueue", "SGECluster"),
    "lsf": ("dask_jobqueue", "LSFCluster"),
}


@contextmanager
def _deployed(cluster: Mapping[str, Any]) -> Iterator[Any]:
    """A cluster that lives as long as the context."""
    asked = dict(cluster)
    kind, count = asked.pop("kind", None), asked.pop("workers", None)
    if kind not in _KINDS:
        raise ConfigError(f"a cluster's `kind` is {kind!r}, expected one of {', '.join(_KINDS)}")
    module, name = _KINDS[kind]
    if kind == "local":
        asked = {"n_workers": count, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"} | asked
    # By itself Dask has workers give memory back at every turn, and their stacks looked at a hundred times a second.
    environment = {f"distributed.nanny.pre-spawn-environ.{key}": value for key, value in (_THREADS | _MEMORY).items()}
    try:
        with _imported("dask.config").set({**environment, "distributed.worker.profile.enabled": False}):
            made = getattr(_imported(module), name)(**asked)
    except (TypeError, ValueError, RuntimeError, OSError) as error:
        raise ConfigError(f"Dask's {name} cannot be made with {', '.join(asked)}: {error}") from error
    with made as running:
        if kind not in ("local", "ssh"):
            running.scale(count or 1)
        yield running


class _Joining:
    """How many trials a scheduler should have at a time: twice what its workers can do, of which some join later.

    A queue gives its workers when it can, so they are counted again every few seconds, and each is asked once for its
    version: ConfigError where that is another.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._known: set[str] = set()
        self._width, self._again = _LEAST_WAITING, 0.0
        self()

    def __call__(self) -> int:
        now = time.monotonic()
        if now >= self._again:
            with contextlib.suppress(OSError):  # a scheduler out of reach is told of by the trials that it has
                self._count(self._client.nthreads())
            self._again = now + _COUNTED_EVERY
        return self._width

    def _count(self, threads: Mapping[str, int]) -> None:
        new = sorted(set(threads) - self._known)
        if new:
            _check_versions(self._client, new)
        self._known = set(threads)
        self._width = max(2 * sum(threads.values()), _LEAST_WAITING)


def _check_versions(client: Any, workers: Sequence[str]) -> None:
    """ConfigError where one of these workers has another version of this program; one that has gone says nothing."""
    for worker, version in client.run(_version, workers=workers, on_error="ignore").items():
        if version != __version__:
            raise ConfigError(
                f"Dask worker {worker} has mocap-id {version}, here it is {__version__}: install the same"
            )


def _version() -> str:
    return __version__


def _imported(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(f"{error.name} is not installed, which running on a cluster needs: {_EXTRA}") from error


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """For processes started within: threads of several workers would fight over the cores."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update({name: value for name, value in values.items() if before[name] is None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)


@contextmanager
def _no_ctrl_c() -> Iterator[None]:
    """Start processes that Ctrl-C does not reach, wherever in their imports they are: this one ends them in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _begin(levels: Mapping[str, int]) -> None:
    """Have a new process tell as much as this one."""
    logging.captureWarnings(True)
    logging.basicConfig(format="mocap-id: %(message)s", level=logging.ERROR)
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)
