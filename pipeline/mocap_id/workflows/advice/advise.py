"""From a finished trial to the movement that would tell more of its body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics.base import base_names, base_units
from mocap_id.dynamics.course import recorded_course
from mocap_id.dynamics.design import Design, design
from mocap_id.dynamics.foresight import Body, Foresight
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.limits import Limits, observed_limits, resting_posture
from mocap_id.dynamics.waves import pressure
from mocap_id.errors import RecordingError
from mocap_id.kinematics.skin_foreseen import skin_in
from mocap_id.stages import STAGES, skin_artefact
from mocap_id.stages.base import Context, TrialKeys
from mocap_id.stages.identify_dim import STAGE
from mocap_id.stages.identify_dim.function import identification, weak_share
from mocap_id.stages.identify_dim.unknown import Unknown
from mocap_id.store import Artefact, Folder, Tree
from mocap_id.workflows.advice.asked import Asked
from mocap_id.workflows.finished import finished

_WIDEN = {"robot-joint": 20.0}  # degrees; a person is asked for little beyond what was seen
_WIDEN_ELSE = 5.0
_SPEED, _ACCELERATION = np.radians((90.0, 200.0)), np.radians((360.0, 800.0))  # in any case; at most, for a person
_SLACK = 0.03  # m
_POSTURES = 60  # from which the joints' errors in another movement are foreseen


@dataclass(frozen=True)
class Advised:
    """What to record next.

    Parameters
    ----------
    trial : str
    joints, names, units : tuple of str
        Of the joints, and of the base parameters.
    value : (b,) array
        Base parameters as they are known, SI.
    design : Design
    limits : Limits
    weak : float
        Standard deviation by size above which a parameter is weak.
    """

    trial: str
    joints: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: FloatArray
    design: Design
    limits: Limits
    weak: float


def advise(path: Path, asked: Asked | None = None, progress: runner.Progress = lambda step: None) -> Advised:
    """Look for the movement that would tell most.

    Parameters
    ----------
    path : Path
        YAML file or run folder of the trial.
    asked : Asked, optional
        What for, and within which limits.
    progress : callable, optional
        Told of the stages that have to run.

    Raises
    ------
    RecordingError
        Nothing was identified from the trial.
    ConfigError
        What is asked names a joint that is not there.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.workflows.finished.finished`.
    """
    asked = Asked() if asked is None else asked
    done = finished(path, progress)
    why = done.facts.get("why")
    if done.facts.get("condition_number") is None:
        raise RecordingError(
            f"{path}: nothing was identified from trial {done.name}, so what another movement would be worth cannot be "
            f"foreseen: {why}"
        )
    context = _context(path if path.is_dir() else load(path).out)
    answer = identification(context)
    assert not isinstance(answer, Unknown)  # it was identified before, from the same artefacts
    prepared, movement, found = answer
    joints = joint_names(context.tree("chain.h5"))
    own, centres = recorded_course(prepared.recorded, found.fit.in_fit), prepared.recorded.centres
    sight = Foresight.of(Body(prepared, found), own, _geometry(context))
    bolted = asked.support == "bolted" or (asked.support is None and context.trial.protocol == "robot-joint")
    rest = resting_posture(own, centres, upright=not bolted)
    limits = asked.over(_observed(sight, rest, _widen(asked, context), bolted), joints)
    rest = limits.inside(rest)  # what is asked may leave the posture out that was seen
    chosen = design(
        sight,
        limits,
        rest,
        joints,
        objective=asked.objective,
        seconds=asked.seconds,
        mixed=movement.contact is None or not movement.contact.chair,
        seed=asked.seed,
    )
    return Advised(
        trial=done.name,
        joints=joints,
        names=base_names(prepared.base, centres),
        units=base_units(prepared.base),
        value=found.base,
        design=chosen,
        limits=limits,
        weak=weak_share(context),
    )


def joint_names(chain: Tree) -> tuple[str, ...]:
    """Of the joints of chain.h5, by number where they have no names."""
    joints: Any = chain.data["joints"]
    numbers = [f"joint {j}" for j in range(1, len(joints["centre"]) + 1)]
    return tuple(str(name) for name in joints.get("name", numbers))


def _context(path: Path) -> Context:
    """What identify-dim saw when it wrote the folder."""
    folder = Folder(path)
    asked = folder.provenance("dynamics.h5").origin.parameters
    stage = next(stage for stage in STAGES if stage.name == STAGE.name)
    inputs: dict[str, Artefact] = {file: folder.read(file) for file in stage.inputs}
    keys = {name: asked[name] for name in ("trial", "protocol", "subject")}
    trial = TrialKeys.model_validate(keys | {"recording": {"markers": "."}})
    return Context(trial, stage.settings.model_validate(asked[stage.name]), inputs)


def _geometry(context: Context) -> Callable[[FloatArray], KinematicError]:
    """What would be uncertain of the chain if it were found from other postures."""
    tree = context.tree("skin.h5")
    skin, camera = skin_artefact.from_tree(tree), float(tree.facts["camera_sd_m"])
    seen = context.table("states.parquet").length

    def of(q: FloatArray) -> KinematicError:
        there = skin_in(skin, q, camera, seen, _POSTURES)
        centres, turned = there.frames_turned()
        return KinematicError(lambda angles: there.errors(angles)[0] + turned, centres)

    return of


def _widen(asked: Asked, context: Context) -> float:
    """By how much every joint may turn further than it was seen to, rad."""
    degrees = _WIDEN.get(context.trial.protocol, _WIDEN_ELSE) if asked.widen is None else asked.widen
    return float(np.radians(degrees))


def _observed(sight: Foresight, rest: FloatArray, widened: float, bolted: bool) -> Limits:
    return observed_limits(
        sight.own,
        sight.body.wrench(sight.own),
        rest,
        widened=widened,
        speed=(float(_SPEED[0]), np.inf if bolted else float(_SPEED[1])),
        acceleration=(float(_ACCELERATION[0]), np.inf if bolted else float(_ACCELERATION[1])),
        slack=None if bolted else _SLACK,
        at_rest=float(pressure(sight.body, rest[None])[0]),
    )
