"""The search for a movement that makes the parameters of an identified trial better known."""

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
from mocap_id.stages.identify_dim.function import identification, weak_share
from mocap_id.stages.identify_dim.identifiability import NotIdentifiable
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.store import Artefact, Folder, Tree
from mocap_id.store.views import Skeleton
from mocap_id.workflows.advice.options import AdviceOptions
from mocap_id.workflows.identified_trial import open_identified_trial

_WIDEN = {"robot-joint": 20.0}  # degrees beyond the observed range; for a person little
_WIDEN_ELSE = 5.0
_SPEED, _ACCELERATION = np.radians((90.0, 200.0)), np.radians((360.0, 800.0))  # least for everybody; most for a person
_SLACK = 0.03  # m
_POSTURES = 60  # postures for predicting the joints' errors in another movement


@dataclass(frozen=True)
class Advice:
    """The movement to record next."""

    trial: str
    joints: tuple[str, ...]
    names: tuple[str, ...]  # of the base parameters
    units: tuple[str, ...]  # of the base parameters
    value: FloatArray  # (b,) base parameters of the trial, SI
    design: ExperimentDesign
    limits: MovementLimits
    weak: float  # relative standard deviation above which a parameter is weak
    sensor_sd: FloatArray | None  # (b,) deviations of the same movement with a wrench sensor before the last segment


def advise(path: Path, options: AdviceOptions | None = None, progress: runner.Progress = lambda step: None) -> Advice:
    """Find the movement that improves the parameters most.

    Parameters
    ----------
    path : Path
        YAML file or run folder of the trial.
    options : AdviceOptions, optional
        Objective and limits of the movement.
    progress : callable, optional
        Called with every stage that runs.

    Raises
    ------
    RecordingError
        Nothing was identified on the trial.
    ConfigError
        An option names a joint that does not exist.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.workflows.identified_trial.open_identified_trial`.
    """
    options = AdviceOptions() if options is None else options
    identified = open_identified_trial(path, progress)
    if identified.facts.get("condition_number") is None:
        raise RecordingError(
            f"{path}: nothing was identified on trial {identified.name}, so the value of another movement cannot be "
            f"predicted: {identified.facts.get('why')}"
        )
    context = _context(identified.folder)
    answer = identification(context)
    assert not isinstance(answer, NotIdentifiable)  # it was identified before, from the same artefacts
    prepared, movement, found = answer
    joints = joint_names(context.tree("chain.h5"))
    own, centres = get_recorded_trajectory(prepared.recorded, found.fit.in_fit), prepared.recorded.centres
    predictor = CovariancePredictor(IdentifiedBody(prepared, found), own, _geometry(context))
    bolted = options.support == "bolted" or (options.support is None and context.trial.protocol == "robot-joint")
    rest = find_resting_posture(own, centres, upright=not bolted)
    limits = options.over(_observed_limits(predictor, rest, _widen(options, context), bolted), joints)
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
        value=found.base,
        design=chosen,
        limits=limits,
        weak=weak_share(context),
        sensor_sd=_with_sensor(found, prepared, movement.free),
    )


def _with_sensor(found: Identification, prepared: PreparedTrial, gate: BoolArray) -> FloatArray | None:
    """Return the standard deviations with a usual sensor before the last segment; None if the trial has one already."""
    segment = len(prepared.recorded.centres)
    if any(each.segment == segment for each in prepared.recorded.built_in) or prepared.prior is not None:
        return None
    covariance = predict_with_sensor(found, prepared, gate, segment, SensorNoise())
    return None if covariance is None else np.asarray(np.sqrt(np.diag(covariance)))


def joint_names(chain: Tree) -> tuple[str, ...]:
    """Return the names of the joints in chain.h5; numbers where they have no names."""
    return Skeleton.from_tree(chain).joint_names


def _context(path: Path) -> Context:
    """Return the inputs and settings of identify-dim when it wrote the folder."""
    folder = Folder(path)
    parameters = folder.provenance("dynamics.h5").origin.parameters
    stage = next(stage for stage in STAGES if stage.name == STAGE.name)
    inputs: dict[str, Artefact] = {file: folder.read(file) for file in stage.inputs}
    keys = {name: parameters[name] for name in ("trial", "protocol", "subject")}
    trial = TrialKeys.model_validate(keys | {"recording": {"markers": "."}})
    return Context(trial, stage.settings.model_validate(parameters[stage.name]), inputs)


def _geometry(context: Context) -> Callable[[FloatArray], KinematicError]:
    """Return a function that predicts the chain's errors if it is found from other postures."""
    tree = context.tree("skin.h5")
    skin, camera = skin_artefact.read_skin_tree(tree), float(tree.facts["camera_sd_m"])
    frames = context.table("states.parquet").length

    def predict(q: FloatArray) -> KinematicError:
        predicted = predict_skin(skin, q, camera, frames, _POSTURES)
        centres, turned = predicted.stored_chain_errors()
        return KinematicError(lambda angles: predicted.errors(angles)[0] + turned, centres)

    return predict


def _widen(options: AdviceOptions, context: Context) -> float:
    """Return how far every joint may go beyond its observed range, rad."""
    degrees = _WIDEN.get(context.trial.protocol, _WIDEN_ELSE) if options.widen is None else options.widen
    return float(np.radians(degrees))


def _observed_limits(predictor: CovariancePredictor, rest: FloatArray, widened: float, bolted: bool) -> MovementLimits:
    return derive_limits(
        predictor.own,
        predictor.body.wrench(predictor.own),
        rest,
        widened=widened,
        speed=(float(_SPEED[0]), np.inf if bolted else float(_SPEED[1])),
        acceleration=(float(_ACCELERATION[0]), np.inf if bolted else float(_ACCELERATION[1])),
        slack=None if bolted else _SLACK,
        at_rest=float(static_centre_of_pressure(predictor.body, rest[None])[0]),
    )
