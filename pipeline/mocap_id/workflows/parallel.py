"""Many trials in parallel, on this machine or on a cluster.

From top to bottom: the run of one trial, whose failure is a result and not an exception; the backends, which are
processes of this machine or the workers of a Dask scheduler, and provide an `Executor` of the standard library; the
distribution of the trials to the workers, with recovery from killed processes.
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
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any, Literal, TypeAlias

from mocap_id import __version__, runner
from mocap_id.config import Trial
from mocap_id.errors import ConfigError, MocapIdError, NumericalError, Refused
from mocap_id.extras import optional
from mocap_id.reporting import FILES
from mocap_id.runner.dependencies import find_user_files
from mocap_id.stages import STAGES
from mocap_id.store import Folder

NOT_RUN = 1
"""Exit code of a trial that was skipped because another trial failed."""


@dataclass(frozen=True)
class TrialRun:
    """The result of the run of a trial."""

    trial: str  # name of the trial
    exit_code: int  # exit code of `mocap-id run` for this trial
    message: str | None  # why the trial failed or was refused; only for the user's terminal, because it may name files
    published: str | None  # the same without names of files, for reports that are passed on
    key: str | None  # cache key of the trial's report, which changes with its content; None if there is no report
    computed: bool  # whether any stage ran
    seconds: float  # duration of the run, s


RunTrial: TypeAlias = Callable[[Trial], TrialRun]
"""A function that runs one trial; it must be importable by other processes."""


def run_trial(trial: Trial) -> TrialRun:
    """Run one trial and return its result; a failure is part of the result."""
    start, message, code = time.perf_counter(), None, 0
    steps: tuple[runner.Step, ...] = ()
    try:
        outcome = runner.run(trial)
    except MocapIdError as error:
        message, code = ": ".join([*getattr(error, "__notes__", []), str(error)]), error.exit_code
    except Exception as error:  # noqa: BLE001  after any failure, the other trials still run
        message, code = f"unforeseen failure, {type(error).__name__}: {error}", NumericalError.exit_code
    else:
        steps = outcome.steps
        if outcome.refused is not None:
            message, code = outcome.refused.message, outcome.refused.exit_code
    published = message
    if published is not None:
        # Names of files and folders may contain names of people.
        files = {path for stage in STAGES for path in find_user_files(trial, stage).values()}
        for path in sorted(files, key=lambda path: len(str(path)), reverse=True):
            neutral = f"the {path.suffix.lstrip('.').upper() or 'recording'} file"
            published = published.replace(str(path), neutral).replace(path.name, neutral)
        for folder, name in ((trial.out, trial.name), (trial.file, trial.file.name), (trial.file.parent, "")):
            published = published.replace(str(folder), name)
    origin = Folder(trial.out).origin("report", FILES) if code in (0, Refused.exit_code) else None
    return TrialRun(
        trial=trial.name,
        exit_code=code,
        message=message,
        published=published,
        key=None if origin is None else origin.key,
        computed=any(step.action == "computed" for step in steps),
        seconds=time.perf_counter() - start,
    )


def _make_ended(trial: Trial, exit_code: int, message: str) -> TrialRun:
    """Return the result of a trial that did not run to its end."""
    return TrialRun(trial.name, exit_code, message, message, None, computed=False, seconds=0.0)


_KILLED = "a process was killed, perhaps by the system because memory ran out: run again with fewer --jobs"


class _Terminated(BaseException):
    """The process received SIGTERM."""


def run_until_terminated(run: RunTrial, trial: Trial) -> TrialRun:
    """Run a trial in a worker process; after SIGTERM, remove incomplete files before the process ends."""
    if threading.current_thread() is not threading.main_thread():  # a cluster's worker handles signals itself
        return run(trial)

    def raise_terminated(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_IGN)  # the pool sends it again, which must not interrupt the removal of files
        raise _Terminated

    before = signal.signal(signal.SIGTERM, raise_terminated)
    try:
        return run(trial)
    except _Terminated:
        os._exit(128 + signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


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


Workers: TypeAlias = tuple[Executor, Callable[[], int]]
"""An executor for trials, and a function that returns the number of trials to submit to it at the same time."""


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
        with _prepare_processes():
            pool = ProcessPoolExecutor(jobs, context, _set_up_logging, (levels,))
            for _ in range(jobs):
                pool.submit(os.getpid)  # starts a process
        try:
            yield pool, lambda: jobs
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
                yield client.get_executor(pure=False), _WorkerCount(client)
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
            # If the queueing system rejects the job of a worker, Dask itself would wait forever.
            with _raise_log_level(logging.CRITICAL, "asyncio", "tornado.application"):  # Dask logs errors of its tasks
                running.scale(1)
                try:
                    running.sync(_wait_for_jobs, running)
                except (RuntimeError, ValueError, OSError) as error:
                    gc.collect()  # the error of a task that nobody awaits is logged when the task is collected
                    why = " ".join(str(error).split())
                    raise ConfigError(f"the queueing system rejects the job of a worker: {why}") from error
            running.scale(count or 1)
        yield running


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
        if now < self._again:
            return self._width
        with contextlib.suppress(OSError):  # the submitted trials report an unreachable scheduler
            threads: Mapping[str, int] = self._client.nthreads()
            new = sorted(set(threads) - self._known)
            versions = self._client.run(_get_version, workers=new, on_error="ignore") if new else {}
            for worker, version in versions.items():  # without workers that have left
                if version != __version__:
                    raise ConfigError(
                        f"Dask worker {worker} has mocap-id {version}, but this machine has {__version__}: install the "
                        "same version on both"
                    )
            self._known = set(threads)
            if not threads and self._again and not self._has_warned:  # at first, workers may still be starting
                self._has_warned = True
                address = self._client.scheduler.address
                _log.warning(
                    f"no worker has joined the Dask scheduler at {address}: the trials wait for one. "
                    f"Start it with `dask worker {address} --nthreads 1`, or wait for the queueing system"
                )
            self._width = max(2 * sum(threads.values()), _LEAST_SUBMITTED)
        self._again = now + _COUNTING_INTERVAL
        return self._width


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
def _prepare_processes() -> Iterator[None]:
    """Set environment variables for processes started in this context, unless they are set, and let them ignore Ctrl-C.

    This process ends them itself.
    """
    values = _THREADS | _MEMORY
    before = {name: os.environ.get(name) for name in values}
    os.environ.update({name: value for name, value in values.items() if before[name] is None})
    handles_signals = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if handles_signals else None
    try:
        yield
    finally:
        if handles_signals:
            signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)


def _set_up_logging(levels: Mapping[str, int]) -> None:
    """Set up logging in a new process with the levels of the parent process."""
    logging.captureWarnings(True)
    logging.basicConfig(format="mocap-id: %(message)s", level=logging.ERROR)
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)


OnError: TypeAlias = Literal["continue", "stop"]
TrialCallback: TypeAlias = Callable[[TrialRun], None]
_Numbered: TypeAlias = tuple[int, Trial]
_POLLING_INTERVAL = 5.0  # s, after which the number of workers is checked again


def run_trials(
    trials: Sequence[Trial],
    backend: Backend,
    tell: TrialCallback = lambda done: None,
    on_error: OnError = "continue",
    run: RunTrial = run_trial,
) -> tuple[TrialRun, ...]:
    """Run every trial that is not up to date, and return the results in the order of the trials.

    ``tell`` is called with the result of each trial as soon as it finishes. With ``on_error="stop"``, no trial starts
    after one that failed or was refused; running trials are allowed to finish.
    """
    results: dict[int, TrialRun] = {}
    waiting = deque(enumerate(trials))
    for number, done in _run_waiting(waiting, run, backend if backend.parallel and len(trials) > 1 else None):
        tell(done)
        results[number] = done
        if on_error == "stop" and done.exit_code != 0:
            waiting.clear()
    not_run = "not run, because another trial failed before"
    return tuple(results.get(number) or _make_ended(one, NOT_RUN, not_run) for number, one in enumerate(trials))


def _run_waiting(waiting: deque[_Numbered], run: RunTrial, backend: Backend | None) -> Iterator[tuple[int, TrialRun]]:
    """Run all trials, without a backend in this process; start new workers whenever a process was killed."""
    while waiting:
        if backend is None:
            number, trial = waiting.popleft()
            yield number, run(trial)
            continue
        lost: list[_Numbered] = []
        with backend.workers(len(waiting)) as workers:
            yield from _run_until_broken(waiting, run, workers, lost)
        # One of these killed the process: run each in its own process, so that only this trial fails.
        for number, trial in lost:
            with LocalBackend(1).workers(1) as (executor, _):
                try:
                    done = executor.submit(run_until_terminated, run, trial).result()
                except BrokenExecutor:
                    done = _make_ended(trial, NumericalError.exit_code, _KILLED)
            yield number, done


def _run_until_broken(
    waiting: deque[_Numbered], run: RunTrial, workers: Workers, lost: list[_Numbered]
) -> Iterator[tuple[int, TrialRun]]:
    """Submit trials until all trials are done or the pool breaks; append the interrupted trials to ``lost``."""
    executor, count_width = workers
    submitted: dict[Future[TrialRun], _Numbered] = {}
    # Futures report here when they finish: polling all of them would be expensive on a large cluster.
    finished: SimpleQueue[Future[TrialRun]] = SimpleQueue()
    while True:
        width = count_width()  # also if nothing is left to submit: this checks the versions of new workers
        while waiting and not lost and len(submitted) < width:
            numbered = waiting.popleft()
            try:
                future = executor.submit(run_until_terminated, run, numbered[1])
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
        number, trial = submitted.pop(future)
        try:
            done = future.result()
        except BrokenExecutor:
            lost.append((number, trial))
            continue
        except Exception as error:
            if type(error).__name__ != "KilledWorker":  # defined by distributed, which may not be installed
                raise
            done = _make_ended(trial, NumericalError.exit_code, _KILLED)
        yield number, done
