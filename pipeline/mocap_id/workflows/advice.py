"""``mocap-id advise``: the movement to record next for more precise body parameters."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.design.experiment import SMALLER, ExperimentDesign, design_experiment, static_centre_of_pressure
from mocap_id.design.proposal import (
    OBJECTIVES,
    CovariancePredictor,
    MovementLimits,
    Objective,
    PredictedUncertainty,
    Proposal,
    derive_limits,
    find_resting_posture,
    get_recorded_trajectory,
)
from mocap_id.dynamics.built_in_sensors import predict_with_sensor
from mocap_id.dynamics.cautions import classify
from mocap_id.dynamics.instrument_errors import KinematicError
from mocap_id.dynamics.regressor import base_names, list_base_units
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.kinematics.skin_slides import predict_skin
from mocap_id.reporting.grids import show
from mocap_id.reporting.paper_figures import draw_advice, render
from mocap_id.reporting.results import CommandResult, to_finite
from mocap_id.stages import STAGES, skin_motion
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.stages.identify_dim.plane import choose_weak_share, identify_trial
from mocap_id.stages.identify_dim.trial_data import NotIdentifiable
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.store import Artefact, Folder
from mocap_id.store.artefacts import Skeleton
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


def advise_movement(
    path: Path, options: AdviceOptions | None = None, progress: runner.Progress = lambda step: None
) -> Advice:
    """Return the movement that most reduces the standard deviations of the trial's parameters.

    ``path`` and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`. RecordingError is raised if no
    parameters were identified on the trial, and ConfigError if an option names a joint that does not exist.
    """
    options = AdviceOptions() if options is None else options
    identified = open_identified_trial(path, progress)
    if identified.facts.get("condition_number") is None:
        raise RecordingError(
            f"{path}: no parameters were identified on trial {identified.name}, so the benefit of another movement "
            f"cannot be predicted: {identified.facts.get('why')}"
        )
    # The inputs and settings from which identify-dim computed the artefacts in the run folder.
    folder = Folder(identified.folder)
    parameters = folder.provenance("dynamics.h5").origin.parameters
    stage = next(stage for stage in STAGES if stage.name == STAGE.name)
    inputs: dict[str, Artefact] = {file: folder.read(file) for file in stage.inputs}
    keys = {name: parameters[name] for name in ("trial", "protocol", "subject")}
    trial = TrialKeys.model_validate(keys | {"recording": {"markers": "."}})
    context = Context(trial, stage.settings.model_validate(parameters[stage.name]), inputs)
    outcome = identify_trial(context)
    assert not isinstance(outcome, NotIdentifiable)  # it was identified before, from the same artefacts
    prepared, movement, model = outcome
    joints = Skeleton(context.tree("chain.h5")).joint_names
    own, centres = get_recorded_trajectory(prepared.recorded, model.fit.in_fit), prepared.recorded.centres
    skin_tree, frames = context.tree("skin.h5"), context.table("states.parquet").length
    skin, camera = skin_motion.read_skin_tree(skin_tree), float(skin_tree.facts["camera_sd_m"])

    def predict_errors(q: FloatArray) -> KinematicError:
        """Return the errors of the chain for a recording with other postures (F, n), rad."""
        predicted = predict_skin(skin, q, camera, frames, _POSTURES)
        centres, turned = predicted.stored_chain_errors()
        return KinematicError(lambda angles: predicted.errors(angles)[0] + turned, centres)

    predictor = CovariancePredictor(prepared, model, own, predict_errors)

    # The limits, from the recorded movement and the options.
    is_robot = trial.protocol == "robot-joint"
    bolted = options.support == "bolted" or (options.support is None and is_robot)
    rest = find_resting_posture(own, centres, upright=not bolted)
    widen = options.widen if options.widen is not None else _WIDEN_ROBOT if is_robot else _WIDEN
    observed = derive_limits(
        own,
        predictor.wrench(own),
        rest,
        widened=float(np.radians(widen)),
        speed=(_SPEED[0], np.inf if bolted else _SPEED[1]),
        acceleration=(_ACCELERATION[0], np.inf if bolted else _ACCELERATION[1]),
        slack=None if bolted else _SLACK,
        at_rest=float(static_centre_of_pressure(predictor, rest[None])[0]),
    )
    limits = options.replace_limits(observed, joints)
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

    # The same movement with a typical wrench sensor before the last segment, unless the trial has it, or a prior.
    covariance = None
    if prepared.prior is None and not any(each.segment == len(centres) for each in prepared.recorded.built_in):
        covariance = predict_with_sensor(model, prepared, movement.free, len(centres))
    return Advice(
        trial=identified.name,
        joints=joints,
        names=base_names(prepared.base, centres),
        units=list_base_units(prepared.base),
        value=model.base,
        design=chosen,
        limits=limits,
        weak=choose_weak_share(context),
        sensor_sd=None if covariance is None else np.asarray(np.sqrt(np.diag(covariance))),
    )


Support = tuple[float, float] | Literal["bolted"] | None


@dataclass(frozen=True)
class AdviceOptions:
    """Objective and limits of the movement. Where a limit is None, the trial gives it."""

    objective: Objective = "intervals"
    seconds: float | None = None  # length of the recording, s; None for the length of the trial
    # how far every joint may go beyond its observed range, degrees; None for 20 with a robot and 5 with a person
    widen: float | None = None
    # ranges of joints by name, degrees; they replace the observed ranges
    angles: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    speed: float | None = None  # limit of every joint, degrees/s
    acceleration: float | None = None  # limit of every joint, degrees/s²
    # range of the centre of pressure along the plane's x, m; None for 3 cm beyond its observed range, or for no limit
    # in a trial of a robot, which is bolted down
    support: Support = None
    seed: int = 0  # seed of the search

    def __post_init__(self) -> None:
        def is_within(value: float | None, low: float, high: float) -> bool:
            return value is None or low <= value <= high

        checks = (
            ("objective", self.objective, self.objective in OBJECTIVES, "one of " + ", ".join(OBJECTIVES)),
            ("seconds", self.seconds, is_within(self.seconds, 8, 600), "8 … 600 s"),
            ("widen", self.widen, is_within(self.widen, 0, 180), "0 … 180 degrees"),
            ("speed", self.speed, is_within(self.speed, 1, 2000), "1 … 2000 degrees/s"),
            ("acceleration", self.acceleration, is_within(self.acceleration, 1, 1e5), "1 … 100000 degrees/s²"),
            ("seed", self.seed, self.seed >= 0, "a whole number, 0 or more"),
        )
        for name, value, valid, expected in checks:
            if not valid:
                raise ConfigError(f"advise: {name} is {value!r}; expected {expected}")

    def replace_limits(self, limits: MovementLimits, joints: Sequence[str]) -> MovementLimits:
        low, high, one = limits.low.copy(), limits.high.copy(), np.ones(len(joints))
        for name, ends in self.angles.items():
            if name not in joints:
                raise ConfigError(f"advise: there is no joint {name!r}; expected one of {', '.join(joints)}")
            low[joints.index(name)], high[joints.index(name)] = np.radians(ends)
        return MovementLimits(
            low=low,
            high=high,
            speed=limits.speed if self.speed is None else one * np.radians(self.speed),
            acceleration=limits.acceleration if self.acceleration is None else one * np.radians(self.acceleration),
            support=self.support if isinstance(self.support, tuple) else limits.support,
        )


def parse_angle_range(text: str) -> tuple[str, tuple[float, float]]:
    """Return a joint and its range in degrees from a text such as ``hip=-10:60``."""
    name, _, rest = text.partition("=")
    expected = "JOINT=LOW:HIGH in degrees, such as hip=-10:60"
    return name.strip(), _parse_range(rest if name else "", f"--angle {text!r}", expected)


def parse_support(text: str) -> Support:
    """Return ``bolted``, or the range of the centre of pressure in m, from a text such as ``-8:3`` in cm."""
    if text == "bolted":
        return "bolted"
    low, high = _parse_range(
        text, f"--support {text!r}", "LOW:HIGH in cm along the plane's x, such as -12:4, or `bolted`"
    )
    return low / 100, high / 100


def _parse_range(text: str, given: str, expected: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = (math.nan, math.nan)
    if not colon or not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and ends[0] < ends[1]):
        raise ConfigError(f"advise: {given}; expected {expected}")
    return ends


_NAMED = 4  # number of parameters that are mentioned


def format_text(advised: Advice) -> Iterator[str]:
    """Yield the lines of the text for the terminal."""
    design = advised.design
    yield f"{advised.trial}: {len(advised.names)} parameters, condition number {design.now.condition:.0f}"
    limits = advised.limits
    parts = [
        f"{name} {np.degrees(low):.0f}° to {np.degrees(high):.0f}°, up to {np.degrees(speed):.0f}°/s"
        for name, low, high, speed in zip(advised.joints, limits.low, limits.high, limits.speed, strict=True)
    ]
    if limits.support is None:
        parts.append("the base is bolted down")
    else:
        low, high = (100 * end for end in limits.support)
        parts.append(f"centre of pressure {low:.1f} to {high:.1f} cm")
    yield "limits: " + "; ".join(parts)
    yield ""
    if design.best is None or not design.helps:
        yield (
            "no movement within these limits helps: none reduces the "
            f"{OBJECTIVES[design.objective]} by a fifth and a standard deviation by 5 %. More markers, a zeroed and "
            "calibrated plate or a longer recording would help"
        )
    else:
        yield f"record this, {design.seconds:.0f} s: {design.best.words}"
        yield f"  {_describe_benefit(advised, design.best)}"
    yield ""
    yield f"simple changes, best first{'' if design.helps else ', none recommended'}:"
    changes = [each for each in design.simple if each.value < design.value or not design.helps]
    for rank, each in enumerate(changes, start=1):
        yield f"  {rank}. {each.words}: {_describe_benefit(advised, each)}"
    if not changes:
        yield "  no simple change is better within these limits"
    yield ""
    if design.designed is not None:
        head = "designed" if design.helps else "designed, not recommended"
        yield f"{head}: {design.designed.words}: {_describe_benefit(advised, design.designed)}"
    else:
        yield "designed: no movement of all joints together is within these limits"
    yield ""
    # The standard deviations of every parameter, relative to its size.
    columns = [("now", design.now)]
    if design.simple:
        columns.append(("simple 1", design.simple[0].predicted))
    if design.designed is not None:
        columns.append(("designed", design.designed.predicted))
    width = max(map(len, advised.names))
    sds = [(name, each.sd) for name, each in columns]
    if advised.sensor_sd is not None:
        sds.append(("sensor", advised.sensor_sd))
    yield "sd by size, %".ljust(width) + "".join(name.rjust(10) for name, _ in sds)
    for i, name in enumerate(advised.names):
        yield name.ljust(width) + "".join(f"{100 * sd[i] / design.size[i]:10.2f}" for _, sd in sds)
    if advised.sensor_sd is not None:
        yield (
            f"sensor: the same movement with a wrench sensor in the {advised.joints[-1]}; these are lower limits, "
            "because they contain only the noise of the sensor and of the accelerations"
        )
    yield "condition number".ljust(width) + "".join(f"{f.condition:10.1f}" for _, f in columns)


def _describe_benefit(advised: Advice, proposal: Proposal) -> str:
    """Return the benefit of a movement as text: the standard deviations that decrease, and the condition number."""
    design = advised.design
    before, after = design.now.sd / design.size, proposal.predicted.sd / design.size
    gains = [i for i in np.argsort(-before) if after[i] < SMALLER * before[i]]
    named = [
        f"sd of {advised.names[i]} from {show(100 * before[i], 2, '%')} to {show(100 * after[i], 2, '%')}"
        for i in gains[:_NAMED]
    ]
    condition = f"condition number {design.now.condition:.0f} -> {proposal.predicted.condition:.0f}"
    return ", ".join([*(named or ["no smaller sd"]), condition])


def make_output(advised: Advice) -> CommandResult:
    """Return the files to write: ``advice.json``, and the best new movement as CSV and as a figure."""
    design, limits = advised.design, advised.limits

    def describe(proposal: Proposal) -> dict[str, Any]:
        head = {"text": proposal.words, "designed": proposal.designed, "objective": to_finite(proposal.value)}
        return head | _describe_prediction(advised, proposal.predicted)

    sensor = None
    if advised.sensor_sd is not None:
        rows = zip(advised.names, advised.sensor_sd, design.size, strict=True)
        parameters = [
            {"name": name, "sd": to_finite(sd), "relative_sd": to_finite(sd / size)} for name, sd, size in rows
        ]
        sensor = {"joint": advised.joints[-1], "parameters": parameters}
    content = {
        "trial": advised.trial,
        "objective": {"name": design.objective, "text": OBJECTIVES[design.objective], "now": to_finite(design.value)},
        "helps": design.helps,
        "seconds": design.seconds,
        "limits": {
            "joints": [
                {
                    "name": name,
                    "low_deg": math.degrees(limits.low[j]),
                    "high_deg": math.degrees(limits.high[j]),
                    "speed_deg_s": math.degrees(limits.speed[j]),
                    "acceleration_deg_s2": math.degrees(limits.acceleration[j]),
                }
                for j, name in enumerate(advised.joints)
            ],
            "support_m": None if limits.support is None else list(limits.support),
        },
        "now": _describe_prediction(advised, design.now),
        "simple": [describe(each) for each in design.simple],
        "designed": None if design.designed is None else describe(design.designed),
        "sensor": sensor,
    }

    def draw_movement() -> dict[str, bytes]:
        """Return the movement as figure, and as CSV: time, and angle, velocity and acceleration of every joint."""
        movement = design.best_standalone
        if movement is None:
            return {}
        path = movement.trajectory
        heads = [f"{joint.replace(' ', '_')}_{unit}" for unit in ("rad", "rad_s", "rad_s2") for joint in advised.joints]
        rows, stream = np.column_stack([path.time - path.time[0], path.q, path.dq, path.ddq]), io.StringIO()
        np.savetxt(stream, rows, fmt="%.6f", delimiter=",", header=",".join(["time_s", *heads]), comments="")
        title = f"A movement to record after {advised.trial}"
        figure = render("movement", title, lambda: draw_advice(path, advised.joints, advised.limits, movement.words))
        return {"movement.csv": stream.getvalue().encode(), **figure}

    return CommandResult("advice", "advice.json", content, other_files=draw_movement, indent=2)


def _describe_prediction(advised: Advice, predicted: PredictedUncertainty) -> dict[str, Any]:
    size = advised.design.size
    return {
        "condition_number": to_finite(predicted.condition),
        "condition_number_scaled": to_finite(predicted.condition_scaled),
        "fitted_s": predicted.samples,
        "parameters": [
            {
                "name": name,
                "value": float(advised.value[i]),
                "unit": advised.units[i],
                "sd": to_finite(predicted.sd[i]),
                "relative_sd": to_finite(predicted.sd[i] / size[i]),
                "verdict": classify(float(predicted.sd[i] / size[i]), advised.weak),
            }
            for i, name in enumerate(advised.names)
        ],
    }
