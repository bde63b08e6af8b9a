"""The result of one robot trial with every method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config.robot_study import RobotReference, RobotTrial
from mocap_id.stages.trial_keys import get_recording
from mocap_id.store import Folder
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.robot_study.method_results import MethodResult, read_method_result
from mocap_id.workflows.robot_study.methods import CAMERAS, ENCODER, METHODS, with_method
from mocap_id.workflows.robot_study.truth import PARAMETERS, Labels, Truth, read_labels, read_reference, read_truth
from mocap_id.workflows.trial_outcome import TrialOutcome, read_summary


@dataclass(frozen=True, kw_only=True)
class RobotTrialResult(TrialOutcome):
    """The result of one robot trial with every method."""

    trial: RobotTrial
    labels: Labels
    truth: Truth | None
    reference: Mapping[str, float]  # known reference parameters, and ``base``: distance of the joint from the origin, m
    by_method: Mapping[str, MethodResult]  # empty for a trial that failed or was refused

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.trial.name

    @property
    def cell(self) -> tuple[str, str]:
        """Joint and speed, which identify a cell in the thesis's tables."""
        return self.labels.joint, self.labels.speed

    @property
    def method_of_reference(self) -> MethodResult | None:
        """The result whose states are used with the reference parameters; None if a reference parameter is unknown."""
        known = all(name in self.reference for name in PARAMETERS)
        return self.by_method.get(ENCODER.name, self.by_method.get(CAMERAS.name)) if known else None


def read_trial_result(trial: RobotTrial, run: TrialRun, reference: Mapping[str, RobotReference]) -> RobotTrialResult:
    """Read the result of a trial from its run folder and the run folders of the methods."""
    config = trial.trial
    truth = read_truth(get_recording(config.keys).motion)
    labels = Labels(trial.joint, trial.speed, trial.orientation).completed_by(read_labels(truth))
    given = reference.get(labels.joint)
    methods = [method for method in METHODS if method is not ENCODER or config.keys.encoder is not None]
    return RobotTrialResult(
        trial=trial,
        run=run,
        summary=read_summary(config.out, run),
        labels=labels,
        truth=truth,
        reference=read_reference(truth) if given is None else given.model_dump(exclude_none=True),
        by_method={
            method.name: read_method_result(
                Folder(with_method(config, method).out), truth, by_encoder=method is ENCODER
            )
            for method in (methods if run.exit_code == 0 else ())
        },
    )


def predict_reference(trial: RobotTrialResult, result: MethodResult) -> tuple[FloatArray, FloatArray]:
    """Return wrench (T, 3) and torque (T,) in the plane, from the reference parameters and the states of a method."""
    identified = result.identified
    base = result.frame.into_plane(np.array([trial.reference[name] for name in PARAMETERS]))
    full = np.linalg.pinv(result.folder.tree("dynamics.h5").array("base/regrouping").astype(np.float64)) @ base
    return identified.chain.regressor @ full, (identified.chain.torque_regressor @ full)[:, 0]
