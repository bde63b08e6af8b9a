"""Function of the stage identify-dim in space, which identifies a chain whose base is on a plate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.cautions import find_cautions_in_space
from mocap_id.dynamics.excitation import WEAK
from mocap_id.dynamics.space.identification import SpatialIdentification, identify, measure_excitation_in_space
from mocap_id.dynamics.space.prediction import SpatialPrediction, predict
from mocap_id.dynamics.space.preparation import COMPONENTS, SpatialTrial
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import space_artefacts as artefacts
from mocap_id.stages.identify_dim.sit_to_stand_events import make_events
from mocap_id.stages.identify_dim.space_inputs import SpatialInputs, read_calibration, read_spatial_inputs
from mocap_id.stages.identify_dim.trial_data import read_cop_threshold
from mocap_id.store import Table, Tree
from mocap_id.store.schemas import DYNAMICS_TABLE, DYNAMICS_TREE
from mocap_id.verdict import Reason

_EXPLAINED = 0.5  # smallest share of the variance of the horizontal force that the model explains
_ADVICE = "Larger angles and higher speeds of all joints, one after the other and together, determine them better."


def identify_in_space(context: Context) -> Outputs:
    """Return events.parquet, dynamics.parquet, dynamics.h5 and phases.parquet of a trial in space."""
    inputs = read_spatial_inputs(context)
    events, torques = _make_events(context)
    if inputs.trial is None or inputs.obstacle is not None:
        table, tree = _explain_obstacle(context, inputs)
    else:
        table, tree = _identify(context, inputs, inputs.trial)
    return events, replace(table, columns={**table.columns, **torques}), tree, artefacts.make_no_averages()


def _make_events(context: Context) -> tuple[Table, dict[str, FloatArray]]:
    """Return events.parquet and additional columns of dynamics.parquet, as the protocol requires."""
    if context.trial.protocol == "curl":
        from mocap_id.stages.identify_dim.curls import find_curl_events  # noqa: PLC0415  only for curls

        return find_curl_events(context)
    if context.trial.protocol == "reach":
        from mocap_id.stages.identify_dim.reaches import find_reach_events  # noqa: PLC0415  only for reaches

        return find_reach_events(context), {}
    return make_events(()), {}


def _identify(context: Context, inputs: SpatialInputs, trial: SpatialTrial) -> tuple[Table, Tree]:
    settings = context.settings
    found = identify(trial, np.ones(len(inputs.time), dtype=np.bool_), read_calibration(settings))
    excited = measure_excitation_in_space(trial, found, settings.weak_share or WEAK)
    model = predict(trial, found)
    facts = artefacts.make_facts(trial, found, model, read_cop_threshold(context))
    reasons = find_cautions_in_space(trial, found, excited, _ADVICE) + _check_explained_force(found)
    tree = Tree(DYNAMICS_TREE, artefacts.make_data(trial, found, excited), facts, reasons)
    return Table(DYNAMICS_TABLE, _columns(context, inputs, model, found)), tree


def _columns(
    context: Context, inputs: SpatialInputs, model: SpatialPrediction, found: SpatialIdentification
) -> dict[str, Any]:
    return artefacts.make_columns(
        inputs.time,
        measured=model.measured,
        model=model.wrench,
        model_sd=model.wrench_sd,
        torque=model.torque,
        torque_sd=model.torque_sd,
        in_fit=found.fit.in_fit,
        threshold=read_cop_threshold(context),
    )


def _explain_obstacle(context: Context, inputs: SpatialInputs) -> tuple[Table, Tree]:
    """Return dynamics.parquet and dynamics.h5 of a trial without an identification."""
    obstacle = inputs.obstacle
    assert obstacle is not None
    coordinates = sum(joint.dimension for joint in inputs.chain.joints)
    absent = np.full((len(inputs.time), len(COMPONENTS)), np.nan)
    torque = np.full((len(inputs.time), coordinates), np.nan)
    columns = artefacts.make_columns(
        inputs.time,
        measured=inputs.wrench,
        model=absent,
        model_sd=absent,
        torque=torque,
        torque_sd=torque,
        in_fit=np.zeros(len(inputs.time), dtype=np.bool_),
        threshold=read_cop_threshold(context),
    )
    data = artefacts.make_empty_data(len(inputs.segments), obstacle.mass)
    expected = context.trial.protocol in ("reach", "curl")  # usually recorded without plates
    reasons = (Reason(obstacle.code, obstacle.why, level="ok" if expected else "caution"),)
    return Table(DYNAMICS_TABLE, columns), Tree(
        DYNAMICS_TREE, data, artefacts.make_empty_facts_in_space(inputs.chain, obstacle.why), reasons
    )


def _check_explained_force(found: SpatialIdentification) -> tuple[Reason, ...]:
    """Return a caution if the motion of the chain does not explain the low-passed horizontal force of the plate."""
    fit, base = found.fit, found.base
    target = fit.target[:, [0, 2]] - fit.target[:, [0, 2]].mean(axis=0)
    rest = (fit.target - fit.design[..., : len(base)] @ base)[:, [0, 2]]
    share = 1.0 - float(np.var(rest, axis=0).sum() / max(float(np.sum(target**2) / len(target)), 1e-300))
    if share >= _EXPLAINED:
        return ()
    return (
        Reason(
            "wrench-unexplained",
            f"the motion of the chain explains {100 * max(share, 0.0):.0f} % of the variance of the horizontal force "
            f"on the plate, expected at least {100 * _EXPLAINED:.0f} %: the plate does not carry this base, or another "
            "object on the plate moves; do not use the parameters",
            value=share,
            limit=_EXPLAINED,
        ),
    )
