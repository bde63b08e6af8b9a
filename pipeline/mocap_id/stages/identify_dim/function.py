"""Function of the stage identify-dim: identifies the dynamics and describes the repetitions."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.recommendation import describe_recommendations, recommend_if_doubtful
from mocap_id.dynamics.acceleration_noise import correlate_errors
from mocap_id.dynamics.built_in_sensors import combine_with_sensors
from mocap_id.dynamics.cautions import find_cautions
from mocap_id.dynamics.excitation import WEAK, WEAK_ROBOT, measure_excitation
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.point_grid import PointGrid
from mocap_id.dynamics.prediction import Prediction, estimate_chain_noise, predict
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings, validation
from mocap_id.stages.identify_dim import dynamics_artefacts as artefacts
from mocap_id.stages.identify_dim.board_position import board_reasons
from mocap_id.stages.identify_dim.encoder_torque import torque_facts
from mocap_id.stages.identify_dim.few_markers import foot_notes, foot_sd, plate_sd, torque_reasons
from mocap_id.stages.identify_dim.identifiability import NotIdentifiable
from mocap_id.stages.identify_dim.motion_comparison import motion_reasons, pinned_facts
from mocap_id.stages.identify_dim.reference_bodies import ReferenceBodies, reference_bodies
from mocap_id.stages.identify_dim.repetition_averages import averages
from mocap_id.stages.identify_dim.scales import (
    calibration,
    calibration_facts,
    check_and_calibrate,
    scale_facts,
    scale_reasons,
)
from mocap_id.stages.identify_dim.segment_fit import SegmentFit, fit_segments
from mocap_id.stages.identify_dim.sit_to_stand_events import events_table, missing_force, sit_to_stand_events
from mocap_id.stages.identify_dim.trial_data import joint_names, read_kinematic_error
from mocap_id.stages.identify_dim.trial_inputs import TrialInputs, gap_facts, read_inputs
from mocap_id.stages.identify_dim.wrench_checks import gain_facts, sensor_cautions
from mocap_id.store import Table, Tree
from mocap_id.store.schemas import DYNAMICS_TABLE, DYNAMICS_TREE
from mocap_id.verdict import Reason


def identify_dim(context: Context) -> Outputs:
    """Return events.parquet, dynamics.parquet, dynamics.h5 and phases.parquet."""
    inputs = read_inputs(context)
    prepared = inputs.prepared
    if prepared is None or inputs.obstacle is not None:
        assert inputs.obstacle is not None
        table, tree = _without_identification(context, inputs, inputs.obstacle)
    else:
        table, tree, prepared = _with_identification(context, inputs, prepared)
    events = _events(context, inputs, prepared, table)
    return events, table, tree, averages(context, events, table)


def identification(context: Context) -> tuple[PreparedTrial, Movement, Identification] | NotIdentifiable:
    """Return the prepared trial, its movement and the identification behind the artefacts.

    All three belong to the pinned chain. With measured poses, its parameters are computed from those of the bodies.
    """
    inputs = read_inputs(context)
    if inputs.prepared is None or inputs.obstacle is not None:
        assert inputs.obstacle is not None
        return inputs.obstacle
    references = reference_bodies(context, inputs.prepared.recorded, inputs.movement)
    found, segments = _fit(context, inputs, inputs.prepared, references)
    return inputs.prepared, inputs.movement, found if segments is None else segments.in_chain


def fit_chain(
    context: Context, prepared: PreparedTrial, movement: Movement, grid: PointGrid, references: ReferenceBodies
) -> Identification:
    """Identify the pinned chain."""
    settings: IdentifyDimSettings = context.settings
    consistency, reference = settings.consistency or "grid", references.chosen.parameters
    found = identify(
        prepared,
        movement.free,
        grid,
        reference,
        read_kinematic_error(context),
        consistency=consistency,
        reference_sd=settings.reference_sd,
        reference_pulls=settings.reference_pulls is True,
        foot_sd=foot_sd(context, prepared.recorded),
        plate_sd=plate_sd(context, prepared.recorded),
    )
    return combine_with_sensors(found, prepared, movement.free, grid, reference, consistency=consistency)


def _fit(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, references: ReferenceBodies
) -> tuple[Identification, SegmentFit | None]:
    """Return the identification of the pinned chain and, if measured poses are used, that of the bodies."""
    found = fit_chain(context, prepared, inputs.movement, inputs.grid, references)
    if not inputs.body_sets:
        return check_and_calibrate(context, prepared, inputs.movement, found, references.chosen.parameters), None
    return found, fit_segments(context, inputs.body_sets, prepared, inputs.movement, pinned=found, tables=references)


def _events(context: Context, inputs: TrialInputs, prepared: PreparedTrial | None, dynamics: Table) -> Table:
    """Return events.parquet, with details by the protocol."""
    movement, recorded = inputs.movement, inputs.recorded
    if movement.posture is None:
        return events_table(movement.repetitions)
    return sit_to_stand_events(
        context.table("wrench.parquet"),
        recorded,
        movement,
        missing_force(prepared, dynamics.columns),
        share=context.settings.seat_off_share,
        seat_measured=recorded.seat is not None,
    )


def _with_identification(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial
) -> tuple[Table, Tree, PreparedTrial]:
    """Return dynamics.parquet, dynamics.h5 and the prepared trial of the motion used."""
    movement, threshold = inputs.movement, _cop_threshold(context)
    references = reference_bodies(context, prepared.recorded, movement)
    found, segments = _fit(context, inputs, prepared, references)
    motion = inputs.motion_facts
    if segments is None:
        result = _of_chain(context, inputs, prepared, found, references)
    else:
        result = _of_bodies(context, inputs, prepared, segments)
        motion = motion | segments.facts | {"joints": gap_facts(segments.bodies, joint_names(context))}
    columns = artefacts.dynamics_columns(result)
    facts = artefacts.dynamics_facts(result, joint_names(context)) | {
        "external": gain_facts(prepared, found.fit),
        "torque": torque_facts(context, columns),
        "motion": motion,
        "scales": scale_facts(result.found),
        "calibration_covariance": calibration_facts(result.found),
    }
    if inputs.board is not None:
        facts["board"] = inputs.board
    if segments is not None:
        facts["pins"] = pinned_facts(prepared, found, movement, segments, threshold)
    cautions = (
        *_cautions(context, result),
        *torque_reasons(context, result, movement.free),
        *validation.reasons(facts["held_out"]),
        *motion_reasons(facts),
        *board_reasons(context, facts),
    )
    prior = foot_notes(context, result.found)
    reasons = (*movement.reasons, *references.chosen.reasons, *prior, *cautions)
    tree = Tree(DYNAMICS_TREE, artefacts.dynamics_data(result), facts, reasons)
    return Table(DYNAMICS_TABLE, columns), tree, result.prepared


def _of_chain(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, found: Identification, references: ReferenceBodies
) -> artefacts.IdentifiedDynamics:
    q, threshold, chain = prepared.recorded.q, _cop_threshold(context), inputs.chain
    snap = _snap(context, q.shape[1])
    correlation = correlate_errors(q, chain.centres, chain.marker_segment, chain.local, snap)

    def model_of(each: Identification) -> Prediction:
        return predict(prepared, each, estimate_chain_noise(prepared, each, correlation, inputs.centre_sd), threshold)

    model = model_of(found)
    if found.with_foot is not None:
        model = model.replace_torques(model_of(found.with_foot))
    excited = measure_excitation(prepared, found, weak_share(context))
    return artefacts.IdentifiedDynamics(
        prepared=prepared,
        found=found,
        chain=prepared,
        in_chain=found,
        excitation=excited,
        recommendations=recommend_if_doubtful(prepared, found, excited),
        model=model,
        grid=inputs.grid,
        references=references,
        chain_reference=references.chosen.parameters,
        contact=inputs.movement.contact,
        validation=validation.validate(prepared, inputs.movement, found, model.wrench),
        cop_threshold=threshold,
        prior_share=np.full(len(found.base), np.nan if found.uses_reference else 0.0),
    )


def _of_bodies(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, segments: SegmentFit
) -> artefacts.IdentifiedDynamics:
    threshold = _cop_threshold(context)
    excited = measure_excitation(prepared, segments.in_chain, weak_share(context))
    return artefacts.IdentifiedDynamics(
        prepared=segments.prepared,
        found=segments.found,
        chain=prepared,
        in_chain=segments.in_chain,
        excitation=excited,
        recommendations=recommend_if_doubtful(prepared, segments.in_chain, excited),
        model=predict(segments.prepared, segments.found, segments.noise(), threshold),
        grid=segments.grid,
        references=segments.references,
        chain_reference=segments.chain_reference,
        contact=inputs.movement.contact,
        validation=segments.validation,
        cop_threshold=threshold,
        prior_share=segments.prior_share,
        chain_map=segments.chain_map,
    )


def weak_share(context: Context) -> float:
    """Return the relative standard deviation above which a parameter is weak; smaller for a robot."""
    given: float | None = context.settings.weak_share
    return given or (WEAK_ROBOT if context.trial.protocol == "robot-joint" else WEAK)


def _cautions(context: Context, result: artefacts.IdentifiedDynamics) -> tuple[Reason, ...]:
    """Return cautions about the identification, and about what the fitted components leave undetermined."""
    facts = context.table("wrench.parquet").facts
    standing, given = facts.get("mass_kg"), context.trial.subject.mass
    recommended = describe_recommendations(result.excitation, result.recommendations, joint_names(context))
    reasons = find_cautions(
        result.prepared,
        result.found,
        result.excitation,
        recommended,
        given=given,
        standing=standing,
        calibration=calibration(context),
    )
    reasons += sensor_cautions(result.chain, result.in_chain.fit)
    reasons += scale_reasons(result.found, given)
    if short := artefacts.components_short(result):
        undetermined = Reason(
            "components-short",
            f"the fitted components {', '.join(context.settings.components)} do not determine {', '.join(short)}, so "
            "no values are given for these; fit at least Fy and tauz (`identify-dim: {components: [Fy, tauz]}`)",
        )
        reasons = (*reasons, undetermined)
    if context.trial.protocol == "free" and standing is None and given is None:
        unchecked = Reason(
            "mass-unchecked",
            "the identified mass could not be compared with the mass of the standing person "
            f"({facts.get('why') or 'the plates do not show it'}) nor with `subject: {{mass: …}}`: if a chair or a "
            "support carries part of the body, the parameters are wrong, and no other check shows it",
        )
        reasons = (*reasons, unchecked)
    return reasons


def _cop_threshold(context: Context) -> float:
    """Return the vertical force up to which there is no centre of pressure, N, as used in planarise."""
    return float(context.table("wrench.parquet").facts["cop_threshold_N"])


def _snap(context: Context, joints: int) -> FloatArray:
    """Return the standard deviation of each joint's process noise (n,), rad/s⁴."""
    return np.broadcast_to(np.asarray(context.table("states.parquet").facts["sigma_v"], dtype=np.float64), (joints,))


def _without_identification(context: Context, inputs: TrialInputs, obstacle: NotIdentifiable) -> tuple[Table, Tree]:
    """Return dynamics.parquet and dynamics.h5 of a trial whose parameters are unknown."""
    recorded, movement, threshold = inputs.recorded, inputs.movement, _cop_threshold(context)
    references = reference_bodies(context, recorded, movement)
    reference, facts = artefacts.unknown_facts(
        obstacle.why, recorded, references, movement.free, cop_threshold=threshold, gravity=context.settings.gravity
    )
    columns = artefacts.empty_columns(recorded, reference, threshold)
    data = artefacts.empty_data(recorded.centres, inputs.grid, obstacle.mass, references.chosen.parameters)
    reasons = (*movement.reasons, *references.chosen.reasons, Reason(obstacle.code, obstacle.why))
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, reasons)
