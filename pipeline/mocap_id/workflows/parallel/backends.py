"""Backends that run trials: processes of this machine, or the workers of a Dask scheduler.

Both provide an `Executor` of the standard library, so that the same scheduling code serves both.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import multiprocessing
import os
import shlex
import shutil
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
from mocap_id.extras import optional

_log = logging.getLogger(__name__)

_LOGGERS = ("mocap_id", "py.warnings")
_THREADS = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA")}
_MEMORY = {
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "MALLOC_MMAP_THRESHOLD_": "4194304",
    "MALLOC_TRIM_THRESHOLD_": "4194304",
}
"""Settings that return the memory of freed arrays to the system, as in the process of the command line."""
_LEAST_SUBMITTED = 16  # number of trials submitted to a scheduler even while its workers are still starting
_COUNTING_INTERVAL = 5.0  # s, after which the workers of a scheduler are counted again
_TERMINATION_TIME = 20.0  # s, for a process to end after SIGTERM


@dataclass(frozen=True)
class Workers:
    """An executor for trials, and the number of trials to submit."""

    executor: Executor
    width: Callable[[], int]  # returns the number of trials to submit at the same time


class Backend(ABC):
    """A place where trials run."""

    @property
    @abstractmethod
    def parallel(self) -> bool:
        """Whether trials run in other processes."""

    @abstractmethod
    @contextmanager
    def workers(self, most: int) -> Iterator[Workers]:
        """Start workers for at most ``most`` trials at a time; the workers end with the context, or after an error."""


@dataclass(frozen=True)
class LocalBackend(Backend):
    """Processes of this machine."""

    jobs: int = 1  # number of trials at a time; with 1, the trials run in this process

    @property
    def parallel(self) -> bool:
        return self.jobs > 1

    @contextmanager
    def workers(self, most: int) -> Iterator[Workers]:
        jobs = min(self.jobs, most)
        # Spawn new interpreters: forking is unsafe because libraries of this process have threads.
        context, levels = multiprocessing.get_context("spawn"), {one: logging.getLogger(one).level for one in _LOGGERS}
        with _set_environment(_THREADS | _MEMORY), _ignore_ctrl_c():
            pool = ProcessPoolExecutor(jobs, context, _set_up_logging, (levels,))
            for _ in range(jobs):
                pool.submit(os.getpid)  # starts a process
        try:
            yield Workers(pool, lambda: jobs)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            children = multiprocessing.active_children()
            for process in children:
                process.terminate()
            for process in children:
                process.join(_TERMINATION_TIME)
                process.kill()  # has no effect if the process has ended
            raise
        pool.shutdown()


@dataclass(frozen=True)
class DaskBackend(Backend):
    """The workers of a Dask scheduler; they must have the same files under the same paths."""

    scheduler: str | None = None  # address of a running scheduler, ``tcp://…``; None to start a cluster
    # a cluster to start while the batch runs: ``kind`` (``local``, ``ssh``, ``slurm``, ``pbs``, ``sge``, ``lsf``),
    # ``workers`` (their number), and the arguments of Dask's class for this kind
    cluster: Mapping[str, Any] = field(default_factory=dict)

    @property
    def parallel(self) -> bool:
        return True

    @contextmanager
    def workers(self, most: int) -> Iterator[Workers]:
        distributed = _import("distributed")
        with ExitStack() as stack:
            stack.enter_context(_raise_log_level(logging.WARNING, "distributed"))
            address = self.scheduler or stack.enter_context(_deploy(self.cluster))
            try:
                client = stack.enter_context(distributed.Client(address, set_as_default=False))
            except (OSError, TimeoutError, ValueError) as error:
                raise ConfigError(
                    f"no Dask scheduler answers at {address} ({error}): start one with `dask scheduler`"
                ) from error
            try:
                yield Workers(client.get_executor(pure=False), _WorkerCount(client))
            except (CancelledError, _import("distributed.comm").CommClosedError) as error:
                raise NumericalError(
                    f"the connection to the Dask scheduler at {address} broke: finished trials are kept; repeat the "
                    "command for the remaining trials"
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
def _deploy(cluster: Mapping[str, Any]) -> Iterator[Any]:
    """Start a cluster and yield it; the cluster ends with the context."""
    arguments = dict(cluster)
    kind, count = arguments.pop("kind", None), arguments.pop("workers", None)
    if kind not in _KINDS:
        raise ConfigError(f"a cluster's `kind` is {kind!r}; expected one of {', '.join(_KINDS)}")
    module, name = _KINDS[kind]
    cluster_class = getattr(_import(module), name)
    submit = getattr(getattr(cluster_class, "job_cls", None), "submit_command", None)
    if submit and not shutil.which(shlex.split(submit)[0]):
        raise ConfigError(
            f"`kind: {kind}` starts its workers with the program `{submit}`, which is not on this machine's path: "
            "run the command on a machine where you submit jobs to the cluster"
        )
    if kind == "local":
        defaults = {"n_workers": count, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
        arguments = defaults | arguments
    # Dask's defaults trim memory after every task and profile the workers a hundred times a second.
    environment = {f"distributed.nanny.pre-spawn-environ.{key}": value for key, value in (_THREADS | _MEMORY).items()}
    try:
        with _import("dask.config").set({**environment, "distributed.worker.profile.enabled": False}):
            deployed = cluster_class(**arguments)
    except (TypeError, ValueError, RuntimeError, OSError) as error:
        raise ConfigError(f"Dask's {name} does not accept {', '.join(arguments)}: {error}") from error
    with deployed as running:
        if kind not in ("local", "ssh"):
            _try_one_job(running)
            running.scale(count or 1)
        yield running


def _try_one_job(running: Any) -> None:
    """Raise ConfigError if the queueing system rejects the job of a worker, because Dask itself would wait forever."""
    with _raise_log_level(
        logging.CRITICAL, "asyncio", "tornado.application"
    ):  # Dask logs the errors of its tasks there
        running.scale(1)
        try:
            running.sync(_wait_for_jobs, running)
        except (RuntimeError, ValueError, OSError) as error:
            gc.collect()  # the error of a task that nobody awaits is logged when the task is collected
            why = " ".join(str(error).split())
            raise ConfigError(f"the queueing system rejects the job of a worker: {why}") from error


async def _wait_for_jobs(running: Any) -> None:
    """Wait until the jobs are submitted; raise the error of a job that cannot be submitted."""
    await running
    for worker in running.workers.values():
        if worker.status.name == "created":
            try:
                await worker  # submits the job again, which raises its error
            except Exception:
                worker.status = type(worker.status).failed  # so that the cluster can be closed
                raise


class _WorkerCount:
    """The number of trials to submit at the same time: twice the threads of the workers that have joined.

    Workers of a queueing system join at any time, so they are counted again every few seconds. ConfigError is raised if
    a new worker has a different version of this program.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._known: set[str] = set()
        self._has_warned = False
        self._width, self._again = _LEAST_SUBMITTED, 0.0
        self()

    def __call__(self) -> int:
        now = time.monotonic()
        if now >= self._again:
            with contextlib.suppress(OSError):  # the submitted trials report an unreachable scheduler
                self._count(self._client.nthreads())
            self._again = now + _COUNTING_INTERVAL
        return self._width

    def _count(self, threads: Mapping[str, int]) -> None:
        new = sorted(set(threads) - self._known)
        if new:
            _check_versions(self._client, new)
        self._known = set(threads)
        if not threads and self._again and not self._has_warned:  # at the first count, workers may still be starting
            self._has_warned = True
            address = self._client.scheduler.address
            _log.warning(
                f"no worker has joined the Dask scheduler at {address}: the trials wait for one. "
                f"Start it with `dask worker {address} --nthreads 1`, or wait for the queueing system"
            )
        self._width = max(2 * sum(threads.values()), _LEAST_SUBMITTED)


def _check_versions(client: Any, workers: Sequence[str]) -> None:
    """Raise ConfigError if a worker has a different version of this program; workers that have left are ignored."""
    for worker, version in client.run(_get_version, workers=workers, on_error="ignore").items():
        if version != __version__:
            raise ConfigError(
                f"Dask worker {worker} has mocap-id {version}, but this machine has {__version__}: install the same "
                "version on both"
            )


def _get_version() -> str:
    return __version__


@contextmanager
def _raise_log_level(level: int, *loggers: str) -> Iterator[None]:
    """Drop messages of these loggers below a level, unless this program logs its own information (``--verbose``)."""
    before = {logging.getLogger(name): logging.getLogger(name).level for name in loggers}
    if not logging.getLogger("mocap_id").isEnabledFor(logging.INFO):
        for log, old in before.items():
            log.setLevel(max(old, level))
    try:
        yield
    finally:
        for log, old in before.items():
            log.setLevel(old)


def _import(module: str) -> Any:
    return optional(module, "cluster", "running on a cluster")


@contextmanager
def _set_environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for processes started in this context, unless they are already set."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update({name: value for name, value in values.items() if before[name] is None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)


@contextmanager
def _ignore_ctrl_c() -> Iterator[None]:
    """Let processes started in this context ignore Ctrl-C, because this process ends them itself."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _set_up_logging(levels: Mapping[str, int]) -> None:
    """Set up logging in a new process with the levels of the parent process."""
    logging.captureWarnings(True)
    logging.basicConfig(format="mocap-id: %(message)s", level=logging.ERROR)
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)
