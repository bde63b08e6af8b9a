"""One trial with every method for the joint states; stages that do not depend on the method run once."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mocap_id import runner
from mocap_id.config import Trial
from mocap_id.errors import MocapIdError
from mocap_id.stages import STAGES
from mocap_id.store.atomic import converting_errors
from mocap_id.store.folder import record_file
from mocap_id.workflows.parallel import TrialRun, run_trial

DYNAMICS = "identify-dim"
_STATES = "ukf-smooth"


@dataclass(frozen=True)
class Method:
    """A method for the joint states."""

    name: str  # name of its folder in the trial's folder
    thesis: str  # label in the thesis's tables
    settings: Mapping[str, str | float]  # settings of `ukf-smooth` that replace the settings of the trial


CAMERAS = Method("cameras", "P", {})
ENCODER = Method("encoder", "R", {"method": "encoder"})
DIFFERENCES = Method("differences", "Diff.", {"method": "butterworth", "butterworth_hz": 20.0})
SMOOTHER = Method("differences-6", "Diff. 6 Hz", {"method": "butterworth", "butterworth_hz": 6.0})
SPLINE = Method("spline", "Spline", {"method": "spline"})
METHODS = (CAMERAS, ENCODER, DIFFERENCES, SMOOTHER, SPLINE)


def run_all_methods(trial: Trial) -> TrialRun:
    """Run a trial with its report, then its dynamics with every other method; a failure is returned as a result.

    The encoder's method is omitted if the trial has no encoder. The first method that fails ends the run.
    """
    done = run_trial(trial)
    if done.exit_code != 0:
        return done
    for method in METHODS[1:]:
        if method is ENCODER and trial.keys.encoder is None:
            continue
        variant = with_method(trial, method)
        try:
            _share_artefacts(trial.out, variant.out)
            outcome = runner.run_to(variant, DYNAMICS)
            if outcome.refused is not None:
                raise outcome.refused
        except MocapIdError as error:
            message = f"with the method {method.name}: {error}"
            return replace(
                done, exit_code=error.exit_code, message=message, published=message.replace(str(trial.out), trial.name)
            )
        done = replace(
            done,
            computed=done.computed or any(step.action == "computed" for step in outcome.steps),
            seconds=done.seconds + sum(step.seconds or 0.0 for step in outcome.steps),
        )
    return done


def with_method(trial: Trial, method: Method) -> Trial:
    """Return the trial with the settings and the run folder of a method."""
    if method is CAMERAS:
        return trial
    settings = trial.settings[_STATES].model_copy(update=dict(method.settings))
    return replace(trial, settings={**trial.settings, _STATES: settings}, out=trial.out / "methods" / method.name)


def _share_artefacts(source: Path, target: Path) -> None:
    """Link or copy the artefacts of the stages before the joint states into the run folder of a method."""
    before = STAGES[: next(k for k, stage in enumerate(STAGES) if stage.name == _STATES)]
    with converting_errors(target):
        for file in (file for stage in before for file in (*stage.outputs, record_file(stage.name))):
            copy = target / file
            copy.parent.mkdir(parents=True, exist_ok=True)
            if copy.exists() and copy.samefile(source / file):
                continue
            copy.unlink(missing_ok=True)
            try:
                os.link(source / file, copy)
            except OSError:
                shutil.copy2(source / file, copy)
