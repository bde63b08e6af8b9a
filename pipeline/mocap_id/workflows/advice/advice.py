"""Search for the movement that reduces the standard deviations of an identified trial's parameters most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.design.experiment import ExperimentDesign, design_experiment
from mocap_id.design.movement_limits import MovementLimits, derive_limits, find_resting_posture
from mocap_id.design.predicted_covariance import CovariancePredictor, IdentifiedBody
from mocap_id.design.trajectory import get_recorded_trajectory
from mocap_id.design.wave_movement import static_centre_of_pressure
from mocap_id.dynamics.base_parameters import base_names, list_base_units
from mocap_id.dynamics.built_in_sensors import SensorNoise, predict_with_sensor
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.errors import RecordingError
from mocap_id.kinematics.skin_slides import predict_skin
from mocap_id.stages import STAGES, skin_artefact
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.stages.identify_dim.identifiability import NotIdentifiable
from mocap_id.stages.identify_dim.plane import choose_weak_share, identify_trial
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.store import Artefact, Folder
from mocap_id.store.views import Skeleton
from mocap_id.workflows.advice.options import AdviceOptions
from mocap_id.workflows.identified_trial import open_identified_trial

_WIDEN_ROBOT, _WIDEN = 20.0, 5.0  # degrees beyond the observed range, for a robot and for a person
_SPEED = (float(np.radians(90.0)), float(np.radians(200.0)))  # rad/s: lowest limit, and highest limit of a person
_ACCELERATION = (float(np.radians(360.0)), float(np.radians(800.0)))  # rad/s², as above
_SLACK = 0.03  # m, how far the centre of pressure may go beyond its observed range
_POSTURES = 60  # number of postures from which the joints' errors in another movement are predicted


@dataclass(frozen=True)
class Advice:
    """The movement to record next."""

    trial: str
    joints: tuple[str, ...]
    names: tuple[str, ...]  # names of the base parameters
    units: tuple[str, ...]  # units of the base parameters
    value: FloatArray  # (b,) base parameters of the trial, SI
    design: ExperimentDesign
    limits: MovementLimits
    weak: float  # relative standard deviation above which a parameter is weak
    # (b,) standard deviations for the same movement with a wrench sensor before the last segment; None if unknown, or
    # if the trial already has this sensor
    sensor_sd: FloatArray | None


def advise(path: Path, options: AdviceOptions | None = None, progress: runner.Progress = lambda step: None) -> Advice:
    """Return the movement that most reduces the standard deviations of the trial's parameters.

    ``path`` and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`.

    Raises
    ------
    RecordingError
        No parameters were identified on the trial.
    ConfigError
        An option names a joint that does not exist.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.workflows.identified_trial.open_identified_trial`.
    """
    options = AdviceOptions() if options is None else options
    identified = open_identified_trial(path, progress)
    if identified.facts.get("condition_number") is None:
        raise RecordingError(
            f"{path}: no parameters were identified on trial {identified.name}, so the benefit of another movement "
            f"cannot be predicted: {identified.facts.get('why')}"
        )
    context = _read_context(identified.folder)
    outcome = identify_trial(context)
    assert not isinstance(outcome, NotIdentifiable)  # it was identified before, from the same artefacts
    prepared, movement, model = outcome
    joints = Skeleton.from_tree(context.tree("chain.h5")).joint_names
    own, centres = get_recorded_trajectory(prepared.recorded, model.fit.in_fit), prepared.recorded.centres
    predictor = CovariancePredictor(IdentifiedBody(prepared, model), own, _make_error_predictor(context))
    bolted = options.support == "bolted" or (options.support is None and context.trial.protocol == "robot-joint")
    rest = find_resting_posture(own, centres, upright=not bolted)
    limits = options.replace_limits(_observe_limits(predictor, rest, _find_widening(options, context), bolted), joints)
    rest = limits.clip(rest)  # the options may exclude the observed posture
    chosen = design_experiment(
        predictor,
        limits,
        rest,
        joints,
        objective=options.objective,
        seconds=options.seconds,
        mixed=movement.contact is None or not movement.contact.chair,
        seed=options.seed,
    )
    return Advice(
        trial=identified.name,
        joints=joints,
        names=base_names(prepared.base, centres),
        units=list_base_units(prepared.base),
        value=model.base,
        design=chosen,
        limits=limits,
        weak=choose_weak_share(context),
        sensor_sd=_predict_with_sensor(model, prepared, movement.free),
    )


def _predict_with_sensor(model: Identification, prepared: PreparedTrial, gate: BoolArray) -> FloatArray | None:
    """Return the standard deviations (b,) of the base parameters with a typical wrench sensor before the last segment.

    ``gate`` marks the samples of the fit. None if the trial already has this sensor, has a prior, or is too short.
    """
    segment = len(prepared.recorded.centres)
    if any(each.segment == segment for each in prepared.recorded.built_in) or prepared.prior is not None:
        return None
    covariance = predict_with_sensor(model, prepared, gate, segment, SensorNoise())
    return None if covariance is None else np.asarray(np.sqrt(np.diag(covariance)))


def _read_context(path: Path) -> Context:
    """Return the inputs and settings from which identify-dim computed the artefacts in a run folder."""
    folder = Folder(path)
    parameters = folder.provenance("dynamics.h5").origin.parameters
    stage = next(stage for stage in STAGES if stage.name == STAGE.name)
    inputs: dict[str, Artefact] = {file: folder.read(file) for file in stage.inputs}
    keys = {name: parameters[name] for name in ("trial", "protocol", "subject")}
    trial = TrialKeys.model_validate(keys | {"recording": {"markers": "."}})
    return Context(trial, stage.settings.model_validate(parameters[stage.name]), inputs)


def _make_error_predictor(context: Context) -> Callable[[FloatArray], KinematicError]:
    """Return a function that predicts the errors of the chain for a recording with other postures (F, n), rad."""
    tree = context.tree("skin.h5")
    skin, camera = skin_artefact.read_skin_tree(tree), float(tree.facts["camera_sd_m"])
    frames = context.table("states.parquet").length

    def predict(q: FloatArray) -> KinematicError:
        predicted = predict_skin(skin, q, camera, frames, _POSTURES)
        centres, turned = predicted.stored_chain_errors()
        return KinematicError(lambda angles: predicted.errors(angles)[0] + turned, centres)

    return predict


def _find_widening(options: AdviceOptions, context: Context) -> float:
    """Return how far every joint may go beyond its observed range, rad."""
    usual = _WIDEN_ROBOT if context.trial.protocol == "robot-joint" else _WIDEN
    return float(np.radians(usual if options.widen is None else options.widen))


def _observe_limits(predictor: CovariancePredictor, rest: FloatArray, widened: float, bolted: bool) -> MovementLimits:
    return derive_limits(
        predictor.own,
        predictor.body.wrench(predictor.own),
        rest,
        widened=widened,
        speed=(_SPEED[0], np.inf if bolted else _SPEED[1]),
        acceleration=(_ACCELERATION[0], np.inf if bolted else _ACCELERATION[1]),
        slack=None if bolted else _SLACK,
        at_rest=float(static_centre_of_pressure(predictor.body, rest[None])[0]),
    )
