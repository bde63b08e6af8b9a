"""One trial by every method for its states; what does not depend on the method is computed once."""

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
from mocap_id.store.atomic import explained
from mocap_id.store.folder import record_file
from mocap_id.workflows.performing import Performed, perform

DYNAMICS = "identify-dim"
_STATES = "ukf-smooth"


@dataclass(frozen=True)
class Method:
    """A way to the joint states.

    Parameters
    ----------
    name : str
        Folder of its results in the trial's.
    thesis : str
        What the thesis's tables call it.
    settings : mapping
        Of `ukf-smooth`, over the trial's own.
    """

    name: str
    thesis: str
    settings: Mapping[str, str | float]


CAMERAS = Method("cameras", "P", {})
ENCODER = Method("encoder", "R", {"method": "encoder"})
DIFFERENCES = Method("differences", "Diff.", {"method": "butterworth", "butterworth_hz": 20.0})
SMOOTHER = Method("differences-6", "Diff. 6 Hz", {"method": "butterworth", "butterworth_hz": 6.0})
SPLINE = Method("spline", "Spline", {"method": "spline"})
METHODS = (CAMERAS, ENCODER, DIFFERENCES, SMOOTHER, SPLINE)


def perform_variants(trial: Trial) -> Performed:
    """Run a trial with its report, then its dynamics by every other method; a failure is an answer, not an error.

    An encoder's method is left out where the trial names none. The first method that fails ends it.
    """
    done = perform(trial)
    if done.exit_code != 0:
        return done
    for method in METHODS[1:]:
        if method is ENCODER and trial.keys.encoder is None:
            continue
        variant = of_method(trial, method)
        try:
            _share(trial.out, variant.out)
            outcome = runner.run_to(variant, DYNAMICS)
            if outcome.refused is not None:
                raise outcome.refused
        except MocapIdError as error:
            message = f"by {method.name}: {error}"
            return replace(
                done, exit_code=error.exit_code, message=message, published=message.replace(str(trial.out), trial.name)
            )
        done = replace(
            done,
            computed=done.computed or any(step.action == "computed" for step in outcome.steps),
            seconds=done.seconds + sum(step.seconds or 0.0 for step in outcome.steps),
        )
    return done


def of_method(trial: Trial, method: Method) -> Trial:
    """The trial with its states by a method, in a folder of its own."""
    if method is CAMERAS:
        return trial
    settings = trial.settings[_STATES].model_copy(update=dict(method.settings))
    return replace(trial, settings={**trial.settings, _STATES: settings}, out=trial.out / "methods" / method.name)


def _share(source: Path, target: Path) -> None:
    """Let a variant find the artefacts that no method changes: another name for the same file, or a copy."""
    before = STAGES[: next(k for k, stage in enumerate(STAGES) if stage.name == _STATES)]
    with explained(target):
        for file in (file for stage in before for file in (*stage.outputs, record_file(stage.name))):
            there = target / file
            there.parent.mkdir(parents=True, exist_ok=True)
            if there.exists() and there.samefile(source / file):
                continue
            there.unlink(missing_ok=True)
            try:
                os.link(source / file, there)
            except OSError:
                shutil.copy2(source / file, there)
