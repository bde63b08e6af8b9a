"""Execution of stages: outputs are reused if they are up to date, or else they are computed and written.

Outputs are up to date if the same version of the stage made them with the same settings from inputs with the same keys;
file times do not matter. Within a run, stages pass their outputs on in memory, and a background thread writes them.
Refusals and failures are reported.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import logging
import platform
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypeAlias

from mocap_id import __version__, plain_files, store
from mocap_id.config import Trial, load
from mocap_id.errors import ConfigError, MocapIdError, NumericalError, RecordingError, Refused, StoreError
from mocap_id.runner.dependencies import FileHashes, collect_parameters, compute_cache_key, find_owner, find_user_files
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Context
from mocap_id.store import Document, Folder, Origin
from mocap_id.store.atomic import converting_errors, delaying_signals, replace_together
from mocap_id.store.folder import check_owner, store_owner

RUN_LOG = "run.log"
"""Name of the log in the run folder."""

_NO_VERDICT = "no verdict yet"
_LARGEST = 1_000_000  # bytes; a longer log is cut to its newer half


@contextlib.contextmanager
def keep_log(folder: Path, trial: str, files: Mapping[str, Path]) -> Iterator[logging.Logger]:
    """Collect log messages and warnings, and append them to the log of the run folder at the end of the run.

    Nothing is written to a folder without other files. A log that cannot be written causes no error. The caller must
    have locked the folder. Instead of the names of the user ``files``, which may identify a person, the log contains
    their YAML keys. The logger that is yielded is for messages that go only to the log.
    """
    lines = _Lines(files)
    every, own = logging.getLogger("mocap_id"), logging.Logger("mocap_id.run", logging.INFO)
    every.addHandler(lines)
    own.addHandler(lines)
    own.info("%s: mocap-id %s, Python %s, %s", trial, __version__, platform.python_version(), platform.system())
    try:
        yield own
    except BaseException as error:
        own.info("%s: %s", type(error).__name__, error)
        raise
    finally:
        every.removeHandler(lines)
        with contextlib.suppress(OSError, StoreError):
            path = folder / RUN_LOG
            unsafe = path.is_symlink() or (path.exists() and not path.is_file())  # a link may lead out of the folder
            if not unsafe and (path.exists() or any(file.is_file() for file in folder.iterdir())):
                with path.open("a", encoding="utf-8") as stream:
                    stream.write("".join(lines.lines))
                if path.stat().st_size > _LARGEST:
                    kept = path.read_bytes()[-_LARGEST // 2 :]
                    replace_together(folder, {RUN_LOG: kept[kept.find(b"\n") + 1 :]})


def summarise_verdict(folder: Path) -> str:
    """Return the verdict in a run folder and the codes of its reasons, as a line of the log."""
    try:
        verdict = json.loads(plain_files.read_bytes(folder / "summary.json"))["verdict"]
    except (OSError, ValueError, KeyError, TypeError):
        return _NO_VERDICT
    codes = [reason["code"] for reason in verdict["reasons"] if reason.get("level") != "ok"]
    return ": ".join([f"verdict {verdict['level']}", *([", ".join(codes)] if codes else [])])


def read_last_failure(folder: Path) -> str | None:
    """Return the message of the last line in the log if the last run failed, or else None."""
    try:
        lines = plain_files.read_bytes(folder / RUN_LOG, links=False).decode("utf-8", "replace").splitlines()
    except OSError:
        return None
    message = lines[-1].partition(" ")[2] if lines else "verdict"
    return None if message.startswith(("verdict", _NO_VERDICT)) else message


class _Lines(logging.Handler):
    """Log handler that collects lines with time stamps."""

    def __init__(self, files: Mapping[str, Path]) -> None:
        super().__init__(logging.INFO)
        self.lines: list[str] = []
        self._keys = {name: key for key, path in files.items() for name in (str(path), path.name)}

    def emit(self, record: logging.LogRecord) -> None:
        stamp = datetime.datetime.fromtimestamp(record.created, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        message = " ".join(record.getMessage().split())
        for name, key in self._keys.items():
            message = message.replace(name, key)
        level = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        self.lines.append(f"{stamp} {level}{message}\n")


LOG_FILE = "failure.log"  # in the run folder: the traceback of an unexpected failure
_REFUSAL_FILE = ".mocap-id/refusal.json"
_LONGEST_WAIT_S = 600.0  # if another run updates the calibration
_LARGE = 64 << 20  # bytes; a larger artefact is read again instead of kept in memory

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Step:
    """A stage and what was done with it; ``seconds`` is the time of its computation, in this run or an earlier one.

    A step with the action ``begun`` is only reported as progress and is not part of an :class:`Outcome`.
    """

    stage: str
    action: Literal["begun", "computed", "reused", "refused"]
    seconds: float


@dataclass(frozen=True)
class Outcome:
    """Result of a run; ``refused`` is the refusal if a stage refused the trial, or else None."""

    folder: Path  # run folder
    steps: tuple[Step, ...]  # in the order of the run
    refused: Refused | None = None

    def summary(self) -> Mapping[str, Any]:
        """Return the contents of the trial's summary.json."""
        result: Mapping[str, Any] = json.loads((self.folder / "summary.json").read_text("utf-8"))
        return result


Progress: TypeAlias = Callable[[Step], None]


def _silent(step: Step) -> None:
    """Do nothing, as the default for ``progress``."""


def run(trial: Trial, stages: Sequence[Stage] = STAGES, progress: Progress = _silent) -> Outcome:
    """Run all stages that are not up to date; a refusal is not raised, but part of the outcome."""
    with _start_run(trial, stages, progress) as this_run:
        return this_run.run_stages(stages)


def run_stage(trial: Trial, name: str, stages: Sequence[Stage] = STAGES, progress: Progress = _silent) -> Outcome:
    """Run one stage on existing artefacts, unless its outputs are up to date.

    Raises StoreError if an artefact that it reads is missing, or was made with other settings or files.
    """
    stage = next(stage for stage in stages if stage.name == name)
    with _start_run(trial, stages, progress) as this_run:
        this_run.check_inputs(stage)
        return this_run.run_stages([stage])


def run_to(
    trial: Trial, name: str, stages: Sequence[Stage] = STAGES, progress: Progress = _silent, wait: float = 0.0
) -> Outcome:
    """Run the stages up to the stage ``name``, after waiting up to ``wait`` seconds for another run of the trial."""
    last = next(k for k, stage in enumerate(stages) if stage.name == name)
    with _start_run(trial, stages, progress, wait) as this_run:
        return this_run.run_stages(stages[: last + 1])


@contextmanager
def _start_run(trial: Trial, stages: Sequence[Stage], progress: Progress, wait: float = 0.0) -> Iterator[_Run]:
    """Start a run, and lock the run folder while it lasts."""
    if trial.keys.calibration is not None:
        # Run the stages of the calibration that the trial needs. Of several trials that do this at the same time, one
        # runs the stages and the others wait.
        other = load(trial.keys.calibration.trial, stages)
        last = "fit-joints" if trial.keys.calibration.states is None else "ukf-smooth"
        refused = run_to(other, last, stages, wait=_LONGEST_WAIT_S).refused
        if refused is not None:
            raise RecordingError(
                f"{other.file}: the calibration of {trial.file} was refused ({refused}); choose a trial in which every "
                "joint moves"
            )
    this_run = _Run(trial, stages, progress)
    outputs = {(trial.out / file).resolve() for stage in stages for file in (*stage.outputs, RUN_LOG)}
    files = {role: path for stage in stages for role, path in find_user_files(trial, stage).items()}
    for role, path in files.items():
        this_run.files.read(role, path)
        if path.resolve() in outputs:
            raise ConfigError(f"{trial.file}: the run would overwrite `{role}`, {path}: choose another `out:`")
    with this_run.folder.locked(wait):
        check_owner(trial.out, this_run.owner)
        with keep_log(trial.out, trial.name, files) as log, this_run.writer:
            this_run.log = log
            yield this_run


class _Run:
    """One run of some stages of one trial."""

    def __init__(self, trial: Trial, stages: Sequence[Stage], progress: Progress) -> None:
        self.trial, self.stages, self.progress = trial, stages, progress
        self.folder = Folder(trial.out)
        self.files = FileHashes(trial)
        self.owner = find_owner(trial, self.files)
        self.log = _log
        self.writer = BackgroundWriter()
        self._steps: list[Step] = []
        self._origins: dict[str, Origin] = {}

    def run_stages(self, stages: Sequence[Stage]) -> Outcome:
        """Run some stages in order, and return the outcome."""
        refused = None
        for number, stage in enumerate(stages):
            try:
                with _name_errors(self.trial, stage):
                    self.run_or_reuse(stage)
            except Refused as error:
                refused = error
                self.report_refusal(stage, refused)
                break
            # Remove artefacts that no later stage reads, and large ones that the next stage does not read.
            later = stages[number + 1 :]
            wanted = {file for one in later for file in one.inputs}
            made = {file for one in self.stages for file in one.outputs} - set(later[0].inputs if later else ())
            self.folder.release(f for f in made if f not in wanted or (self.folder.size(f) or 0) > _LARGE)
        self.writer.wait()
        store_owner(self.trial.out, self.owner)
        self.folder.remove([LOG_FILE])
        self.log.info(summarise_verdict(self.trial.out))
        return Outcome(self.trial.out, tuple(self._steps), refused)

    def run_or_reuse(self, stage: Stage) -> None:
        """Compute one stage, unless its outputs are up to date; if it refused these inputs before, refuse again."""
        hashes = self.compute_hashes(stage)
        origin = self.find_current(stage, hashes)
        action: Literal["computed", "reused"] = "reused"
        if origin is not None:
            self.writer.wait()  # its inputs must be on the disk
            self.update_times(stage)
        else:
            action, key = "computed", compute_cache_key(self.trial, stage, hashes)
            known = read_refusal(self.trial.out, stage.name, key)
            if known is not None:
                raise known
            self.progress(Step(stage.name, "begun", 0.0))
            try:
                origin = self.compute(stage, hashes)
            except Refused as refused:
                store_owner(self.trial.out, self.owner)
                reason = {name: getattr(refused, name) for name in ("code", "message", "value", "limit")}
                text = json.dumps({"stage": stage.name, "key": key, "refused": reason}, indent=1)
                replace_together(self.trial.out, {_REFUSAL_FILE: text.encode()})
                raise
        self._origins[stage.name] = origin
        self.record(Step(stage.name, action, origin.seconds))

    def record(self, step: Step) -> None:
        """Add a step to the outcome, log it and report it as progress."""
        self._steps.append(step)
        duration = f", {step.seconds:.2f} s" if step.action == "computed" else ""
        self.log.info("%s %s%s", step.stage, step.action, duration)
        self.progress(step)

    def compute(self, stage: Stage, hashes: Mapping[str, str], refused: Refused | None = None) -> Origin:
        """Run a stage's function, queue its outputs for writing and return their origin."""
        inputs = {file: self.folder.read(file) for file in stage.inputs if file in hashes}
        settings = self.trial.settings[stage.name]
        context = Context(self.trial.keys, settings, inputs, refused, self.collect_seconds(stage))
        slice_, key = collect_parameters(self.trial, stage), compute_cache_key(self.trial, stage, hashes, refused)
        start = time.perf_counter()
        try:
            with self.report_unexpected():
                outputs = stage.function(context)
                self.files.check_unchanged(stage)
                origin = Origin(stage.name, stage.version, slice_, hashes, key, time.perf_counter() - start)
                given = [output.file if isinstance(output, Document) else output.schema.file for output in outputs]
                extra = {output.file for output in outputs if isinstance(output, Document)} - set(stage.outputs)
                if [file for file in given if file not in extra] != list(stage.outputs):  # more documents are allowed
                    raise ValueError(f"{stage.name} returned {given}, it declares {list(stage.outputs)}")
                kept = self.folder.keep(outputs, origin)
        except NumericalError:
            self.delete_outputs_from(stage)
            raise
        store_owner(self.trial.out, self.owner)
        self.writer.submit(partial(self.write, stage, kept, origin))
        return origin

    def update_times(self, stage: Stage) -> None:
        """Set the times of a stage's outputs so that none is older than its inputs, as `make` requires."""
        inputs = [self.trial.out / file for file in stage.inputs] + [*find_user_files(self.trial, stage).values()]
        self.folder.update_times(stage.outputs, [self.trial.file, *(path for path in inputs if path.exists())])

    def write(self, stage: Stage, outputs: Sequence[store.Artefact | Document], origin: Origin) -> None:
        """Write a stage's outputs and update their times."""
        with _name_errors(self.trial, stage), self.report_unexpected():
            self.folder.store(outputs, origin)
            self.update_times(stage)

    def report_refusal(self, stage: Stage, refused: Refused) -> None:
        """Delete outputs that are no longer valid, and write a report of the refusal unless there is one already."""
        report = self.stages[-1]
        self.writer.wait()
        self.delete_outputs_from(stage, but=report)
        self.record(Step(stage.name, "refused", 0.0))
        hashes = {file: self.folder.key(file) for file in report.inputs if self.folder.exists(file)}
        with _name_errors(self.trial, report):
            origin = self.find_current(report, hashes, refused)
            if origin is not None:
                self.record(Step(report.name, "reused", origin.seconds))
                return
            self.delete_outputs_from(report)
            origin = self.compute(report, hashes, refused)
            self.record(Step(report.name, "computed", origin.seconds))

    def delete_outputs_from(self, stage: Stage, but: Stage | None = None) -> None:
        """Delete the outputs of a failed stage and of all later stages except ``but``; they are from an earlier run."""
        for later in self.stages[self.stages.index(stage) :]:
            if later is not but:
                self.folder.remove_outputs(later.name, later.outputs)

    @contextmanager
    def report_unexpected(self) -> Iterator[None]:
        """Convert an unexpected exception to a NumericalError of one line; write its traceback to ``failure.log``."""
        try:
            yield
        except MocapIdError:
            raise
        except Exception as error:
            log = self.trial.out / LOG_FILE
            text = "".join(traceback.format_exception(error))
            try:
                store_owner(self.trial.out, self.owner)
                replace_together(self.trial.out, {LOG_FILE: text.encode("utf-8", "backslashreplace")})
                where = f"the details are in {log}; please report them"
            except StoreError as problem:
                where = str(problem)
            what = f"{type(error).__name__}: " + str(error).partition("\n")[0]
            raise NumericalError(f"an unforeseen failure, {what}; {where}") from error

    def check_inputs(self, stage: Stage) -> None:
        """Raise StoreError if a direct or indirect input is missing or stale; the message names the stage to run."""
        needed, before = set(stage.inputs), list[Stage]()  # stages on which the stage depends, in their order
        for earlier in reversed(self.stages):
            if needed & set(earlier.outputs):
                before.insert(0, earlier)
                needed |= set(earlier.inputs)
        for earlier in before:
            missing = [file for file in earlier.outputs if not self.folder.exists(file)]
            if missing:
                why = f"{self.trial.out / missing[0]} is missing"
            else:
                self.folder.origin(earlier.name, earlier.outputs)  # raises if an output is damaged
                if self.find_current(earlier, self.compute_hashes(earlier)) is not None:
                    continue
                why = f"{self.trial.out / earlier.outputs[0]} was made from another recording or with other settings"
            first = f"mocap-id {earlier.name} {self.trial.file}"
            raise StoreError(f"{stage.name}: {why}. Run `{first}` first, or all with `mocap-id run {self.trial.file}`")

    def compute_hashes(self, stage: Stage) -> dict[str, str]:
        """Return the hashes of user files, by YAML key, and the keys of artefacts, by file name, that a stage reads."""
        if any(self.folder.size(file) is None for file in stage.inputs):
            self.writer.wait()  # the inputs must be on the disk
        return self.files.of(stage) | {file: self.folder.key(file) for file in stage.inputs}

    def find_current(self, stage: Stage, hashes: Mapping[str, str], refused: Refused | None = None) -> Origin | None:
        """Return the origin of a stage's outputs; None if they are missing, damaged or out of date."""
        key = compute_cache_key(self.trial, stage, hashes, refused)
        try:
            origin = self.folder.origin(stage.name, stage.outputs)
        except StoreError as error:
            _log.warning("%s: %s is computed again: %s", self.trial.name, stage.name, error)
            return None
        return origin if origin is not None and origin.key == key else None

    def collect_seconds(self, stage: Stage) -> dict[str, float]:
        """Return the computation times of the earlier stages whose outputs exist, s."""
        seconds: dict[str, float] = {}
        for earlier in self.stages[: self.stages.index(stage)]:
            origin = self._origins.get(earlier.name)
            try:
                origin = origin or self.folder.origin(earlier.name, earlier.outputs)
            except StoreError:
                continue  # this stage does not read the damaged output
            if origin is not None:
                seconds[earlier.name] = origin.seconds
        return seconds


@contextmanager
def _name_errors(trial: Trial, stage: Stage) -> Iterator[None]:
    """Add the names of trial and stage, as a note, to every MocapIdError."""
    try:
        yield
    except MocapIdError as error:
        if getattr(error, "__notes__", None):
            raise  # the background writer has already added the names
        error.add_note(f"trial {trial.name}, stage {stage.name}")
        raise


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


def read_refusal(folder: Path, stage: str, key: str) -> Refused | None:
    """Return the stored refusal of the computation with the cache key ``key``; None if it was not refused."""
    try:
        found: dict[str, Any] = json.loads(plain_files.read_bytes(folder / _REFUSAL_FILE, links=False))
        refused = Refused(**found["refused"]) if (found["stage"], found["key"]) == (stage, key) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return refused if refused is not None and isinstance(refused.message, str) else None


def forget_refusal(folder: Path) -> None:
    """Delete the stored refusal, so that the stage is computed again."""
    with converting_errors(folder / _REFUSAL_FILE):
        (folder / _REFUSAL_FILE).unlink(missing_ok=True)
