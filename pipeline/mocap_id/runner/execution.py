"""Running stages: what is up to date is reused, what is not is computed, a refusal is reported, a failure explained.

A stage's outputs are reused when they were made by the same version of the stage, with the same settings, from inputs
that were made alike (not from files of the same age). Whoever runs a stage, ``run`` or a stage's own command, finds
what the other left. Within a run, stages hand on their results in memory; a thread writes them behind the computation.
"""

from __future__ import annotations

import json
import logging
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

from mocap_id.config import Trial
from mocap_id.errors import ConfigError, MocapIdError, NumericalError, Refused, StoreError
from mocap_id.runner.behind import Behind
from mocap_id.runner.dependencies import FileHashes, cache_key, parameters, user_files
from mocap_id.runner.log import RUN_LOG, run_log, verdict_line
from mocap_id.runner.refusals import remember, remembered
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Context, Outputs
from mocap_id.store import Artefact, Document, Folder, Origin
from mocap_id.store.atomic import replace_together

LOG_FILE = "failure.log"
"""In the run folder: the traceback of a failure that nobody foresaw."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Step:
    """One stage that was dealt with; ``seconds`` is the time of its computation, now or, when reused, then.

    ``begun`` is told of, no more: an outcome holds only what came of it.
    """

    stage: str
    action: Literal["begun", "computed", "reused", "refused"]
    seconds: float


@dataclass(frozen=True)
class Outcome:
    """How a trial went.

    Parameters
    ----------
    folder : Path
        The run folder.
    steps : tuple of Step
        In the order in which they were taken.
    refused : Refused, optional
        The refusal, when a stage refused the trial; the summary and the report say so too.
    """

    folder: Path
    steps: tuple[Step, ...]
    refused: Refused | None = None

    def summary(self) -> Mapping[str, Any]:
        """The trial's summary.json."""
        result: Mapping[str, Any] = json.loads((self.folder / "summary.json").read_text("utf-8"))
        return result


Progress: TypeAlias = Callable[[Step], None]


def _silent(step: Step) -> None:
    """Tell nobody."""


def run(trial: Trial, stages: Sequence[Stage] = STAGES, progress: Progress = _silent) -> Outcome:
    """Run every stage that is not up to date.

    Raises
    ------
    ConfigError, RecordingError, NumericalError, StoreError
        As in :mod:`mocap_id.errors`; a refusal is an outcome, not an error.
    """
    with _run(trial, stages, progress) as this:
        return this.go(stages)


def run_stage(trial: Trial, name: str, stages: Sequence[Stage] = STAGES, progress: Progress = _silent) -> Outcome:
    """Run one stage on the artefacts of those before it, unless its outputs are up to date.

    Raises
    ------
    StoreError
        An artefact that it reads is missing, or was made from something else than the trial now says.
    ConfigError, RecordingError, NumericalError
        As for :func:`run`.
    """
    stage = next(stage for stage in stages if stage.name == name)
    with _run(trial, stages, progress) as this:
        this.check_inputs(stage)
        return this.go([stage])


def run_to(trial: Trial, name: str, stages: Sequence[Stage] = STAGES, progress: Progress = _silent) -> Outcome:
    """Run every stage up to one that is not up to date; what comes after it stays as it is.

    Raises
    ------
    ConfigError, RecordingError, NumericalError, StoreError
        As for :func:`run`; a refusal is an outcome, and reported as there.
    """
    last = next(k for k, stage in enumerate(stages) if stage.name == name)
    with _run(trial, stages, progress) as this:
        return this.go(stages[: last + 1])


@contextmanager
def _run(trial: Trial, stages: Sequence[Stage], progress: Progress) -> Iterator[_Run]:
    """A run that holds its folder; the user's files are looked at first, so that a mistake there writes nothing."""
    this = _Run(trial, stages, progress)
    outputs = {(trial.out / file).resolve() for stage in stages for file in (*stage.outputs, RUN_LOG)}
    files = {role: path for stage in stages for role, path in user_files(trial, stage).items()}
    for stage in stages:
        this.files.of(stage)
    for role, path in files.items():
        if path.resolve() in outputs:
            raise ConfigError(f"{trial.file}: the run would overwrite `{role}`, {path}: choose another `out:`")
    with this.folder.locked(), run_log(trial.out, trial.name, files) as log, this.behind:
        this.log = log
        yield this


class _Run:
    """One run of some stages of one trial."""

    def __init__(self, trial: Trial, stages: Sequence[Stage], progress: Progress) -> None:
        self.trial, self.stages, self.progress = trial, stages, progress
        self.folder = Folder(trial.out)
        self.files = FileHashes(trial)
        self.log = _log
        self.behind = Behind()
        self._steps: list[Step] = []
        self._origins: dict[str, Origin] = {}

    def go(self, stages: Sequence[Stage]) -> Outcome:
        """Take these stages in their order."""
        refused = None
        for number, stage in enumerate(stages):
            try:
                with _named(self.trial, stage):
                    self.step(stage)
            except Refused as error:
                refused = error
                self.refuse(stage, refused)
                break
            wanted = {file for later in stages[number + 1 :] for file in later.inputs}
            self.folder.release({file for earlier in self.stages for file in earlier.outputs} - wanted)
        self.behind.settle()
        self.folder.remove([LOG_FILE])
        self.log.info(verdict_line(self.trial.out))
        return Outcome(self.trial.out, tuple(self._steps), refused)

    def step(self, stage: Stage) -> None:
        """Compute one stage, or find that there is no need to."""
        hashes = self.hashes(stage)
        origin = self.current(stage, hashes)
        action: Literal["computed", "reused"] = "computed" if origin is None else "reused"
        origin = origin or self.compute_or_refuse(stage, hashes)
        self._origins[stage.name] = origin
        if action == "reused":
            self.behind.settle()  # what it was made from is on the disk
            self.freshen(stage)
        self.took(Step(stage.name, action, origin.seconds))

    def compute_or_refuse(self, stage: Stage, hashes: Mapping[str, str]) -> Origin:
        """Run a stage's function, unless it is known to refuse."""
        key = self.key(stage, hashes)
        known = remembered(self.trial.out, stage.name, key)
        if known is not None:
            raise known
        self.progress(Step(stage.name, "begun", 0.0))
        try:
            return self.compute(stage, hashes)
        except Refused as refused:
            remember(self.trial.out, stage.name, key, refused)
            raise

    def took(self, step: Step) -> None:
        """Note a step and tell of it."""
        self._steps.append(step)
        took = f", {step.seconds:.2f} s" if step.action == "computed" else ""
        self.log.info("%s %s%s", step.stage, step.action, took)
        self.progress(step)

    def compute(self, stage: Stage, hashes: Mapping[str, str], refused: Refused | None = None) -> Origin:
        """Run a stage's function and have written what it gives."""
        inputs = {file: self.folder.read(file) for file in stage.inputs if file in hashes}
        settings = self.trial.settings[stage.name]
        context = Context(self.trial.keys, settings, inputs, refused, self.seconds_before(stage))
        slice_ = parameters(self.trial, stage)
        key = cache_key(stage, slice_, hashes, refused)
        start = time.perf_counter()
        try:
            with self.foreseen():
                outputs = stage.function(context)
                self.files.unchanged(stage)
                origin = Origin(stage.name, stage.version, slice_, hashes, key, time.perf_counter() - start)
                _check_names(stage, outputs)
                kept = self.folder.keep(outputs, origin)
        except NumericalError:
            self.forget_from(stage)
            raise
        self.behind.do(partial(self.write, stage, kept, origin))
        return origin

    def freshen(self, stage: Stage) -> None:
        """Make a stage's outputs no older than what they were made from, for `make`."""
        made_from = [self.trial.out / file for file in stage.inputs] + [*user_files(self.trial, stage).values()]
        self.folder.freshen(stage.outputs, [self.trial.file, *(path for path in made_from if path.exists())])

    def write(self, stage: Stage, outputs: Sequence[Artefact | Document], origin: Origin) -> None:
        """Write what a stage gave."""
        with _named(self.trial, stage), self.foreseen():
            self.folder.store(outputs, origin)
            self.freshen(stage)

    def refuse(self, stage: Stage, refused: Refused) -> None:
        """Remove what no longer holds, and make the report of what does, unless that is what stands there."""
        report = self.stages[-1]
        self.behind.settle()
        self.forget_from(stage, but=report)
        self.took(Step(stage.name, "refused", 0.0))
        hashes = {file: self.folder.key(file) for file in report.inputs if self.folder.exists(file)}
        with _named(self.trial, report):
            standing = self.current(report, hashes, refused)
            if standing is None:
                self.forget_from(report)
                standing = self.compute(report, hashes, refused)
                self.took(Step(report.name, "computed", standing.seconds))
            else:
                self.took(Step(report.name, "reused", standing.seconds))

    def forget_from(self, stage: Stage, but: Stage | None = None) -> None:
        """Remove the outputs of a stage that failed and of all later ones: they are of an older run."""
        for later in self.stages[self.stages.index(stage) :]:
            if later is not but:
                self.folder.forget(later.name, later.outputs)

    @contextmanager
    def foreseen(self) -> Iterator[None]:
        """Turn a failure that is our fault into an error: one line for the screen, the rest into a file."""
        try:
            yield
        except MocapIdError:
            raise
        except Exception as error:
            log = self.trial.out / LOG_FILE
            text = "".join(traceback.format_exception(error))
            try:
                replace_together(self.trial.out, {LOG_FILE: text.encode("utf-8", "backslashreplace")})
                where = f"the details are in {log}; please report them"
            except StoreError as problem:
                where = str(problem)
            what = str(error).partition("\n")[0]
            message = f"an unforeseen failure, {type(error).__name__}: {what}; {where}"
            raise NumericalError(message) from error

    def check_inputs(self, stage: Stage) -> None:
        """Say which stage to run first, if what this one reads is missing or stale, however far back."""
        for earlier in self.ancestors(stage):
            missing = [file for file in earlier.outputs if not self.folder.exists(file)]
            if missing:
                why = f"{self.trial.out / missing[0]} is missing"
            elif self.stale(earlier):
                why = f"{self.trial.out / earlier.outputs[0]} was made from another recording or with other settings"
            else:
                continue
            first = f"mocap-id {earlier.name} {self.trial.file}"
            raise StoreError(f"{stage.name}: {why}. Run `{first}` first, or all with `mocap-id run {self.trial.file}`")

    def stale(self, stage: Stage) -> bool:
        """Whether a stage's outputs, which all exist, are not what the trial now says; StoreError if one is damaged."""
        self.folder.origin(stage.name, stage.outputs)
        return self.current(stage, self.hashes(stage)) is None

    def ancestors(self, stage: Stage) -> list[Stage]:
        """The stages from which a stage's inputs come, directly or not, in the order of the tuple."""
        needed = set(stage.inputs)
        found: list[Stage] = []
        for earlier in reversed(self.stages):
            if needed & set(earlier.outputs):
                found.insert(0, earlier)
                needed |= set(earlier.inputs)
        return found

    def hashes(self, stage: Stage) -> dict[str, str]:
        """Hash of every file of the user's and key of every artefact that a stage reads."""
        return self.files.of(stage) | {file: self.folder.key(file) for file in stage.inputs}

    def key(self, stage: Stage, hashes: Mapping[str, str], refused: Refused | None = None) -> str:
        """Cache key that the stage's outputs would have."""
        return cache_key(stage, parameters(self.trial, stage), hashes, refused)

    def current(self, stage: Stage, hashes: Mapping[str, str], refused: Refused | None = None) -> Origin | None:
        """Where a stage's outputs come from, if they are there, sound, and what computing them again would give."""
        key = self.key(stage, hashes, refused)
        try:
            origin = self.folder.origin(stage.name, stage.outputs)
        except StoreError as error:
            _log.warning("%s: %s is computed again: %s", self.trial.name, stage.name, error)
            return None
        return origin if origin is not None and origin.key == key else None

    def seconds_before(self, stage: Stage) -> dict[str, float]:
        """Computation times of the stages before this one, as far as their outputs stand."""
        seconds: dict[str, float] = {}
        for earlier in self.stages[: self.stages.index(stage)]:
            origin = self._origins.get(earlier.name)
            try:
                origin = origin or self.folder.origin(earlier.name, earlier.outputs)
            except StoreError:
                continue  # a damaged output that this stage does not read is for its own stage to mend
            if origin is not None:
                seconds[earlier.name] = origin.seconds
        return seconds


@contextmanager
def _named(trial: Trial, stage: Stage) -> Iterator[None]:
    """Have every error say which trial and which stage."""
    try:
        yield
    except MocapIdError as error:
        if getattr(error, "__notes__", None):
            raise  # the writer's: it names the stage that it wrote for
        error.add_note(f"trial {trial.name}, stage {stage.name}")
        raise


def _check_names(stage: Stage, outputs: Outputs) -> None:
    """A stage gives what its record says; documents may be more."""
    given = [output.file if isinstance(output, Document) else output.schema.file for output in outputs]
    extra = {output.file for output in outputs if isinstance(output, Document)} - set(stage.outputs)
    if [file for file in given if file not in extra] != list(stage.outputs):
        raise ValueError(f"{stage.name} gave {given}, its record says {list(stage.outputs)}")
