"""Function of the stage identify-dim in the plane, which identifies the dynamics and describes the repetitions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray
from mocap_id.design.proposal import describe_recommendations, recommend_if_doubtful
from mocap_id.dynamics.built_in_sensors import combine_with_sensors
from mocap_id.dynamics.cautions import (
    OFFSET_LARGE,
    WEAK,
    WEAK_ROBOT,
    find_cautions,
    get_identified_mass,
    measure_excitation,
)
from mocap_id.dynamics.consistency import PointGrid
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.instrument_errors import correlate_errors
from mocap_id.dynamics.prediction import Prediction, estimate_chain_noise, predict
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.errors import Refused
from mocap_id.protocols.body_names import name_directions
from mocap_id.protocols.movement import Movement, find_facing
from mocap_id.protocols.repetitions import SUPPORT_LIMIT
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings, validation
from mocap_id.stages.identify_dim import dynamics_artefacts as artefacts
from mocap_id.stages.identify_dim.dynamics_artefacts import (
    check_torques,
    choose_foot_sd,
    choose_plate_sd,
    explain_foot_prior,
)
from mocap_id.stages.identify_dim.events import (
    average_signals,
    compute_missing_force,
    find_zeros,
    make_events,
    make_sit_to_stand_events,
)
from mocap_id.stages.identify_dim.segment_fit import (
    ON_TRUST,
    SegmentFit,
    check_and_calibrate,
    compare_motions,
    compare_torque,
    explain_motion,
    explain_scales,
    fit_segments,
    make_scale_facts,
    read_calibration,
)
from mocap_id.stages.identify_dim.trial_data import (
    MASS_CONTRADICTS,
    NotIdentifiable,
    ReferenceBodies,
    build_reference_bodies,
    explain_board,
    find_seat_segment,
    judge_mass,
    read_cop_threshold,
    read_joint_names,
    read_kinematic_error,
    read_wrench,
)
from mocap_id.stages.identify_dim.trial_inputs import (
    TrialInputs,
    check_sensors,
    describe_gaps,
    make_gain_facts,
    read_inputs,
)
from mocap_id.store import Table, Tree
from mocap_id.store.schemas import DYNAMICS_TABLE, DYNAMICS_TREE
from mocap_id.store.views import find_measured
from mocap_id.verdict import Reason

_LET_GO = 0.4  # s after `stand`: in simulations, a person comes to rest up to 0.37 s later
_SEAT_LEVER = 0.04  # m, horizontal distance between the hip and the part of the chair's force that acts on the pelvis
_SAME = 0.1
"""Relative difference of two masses up to which they are the same, while the person stands without a load."""


def identify_dim(context: Context) -> Outputs:
    """Return events.parquet, dynamics.parquet, dynamics.h5 and phases.parquet of a trial in the plane."""
    _refuse_other_mass(context)
    inputs = read_inputs(context)
    prepared = inputs.prepared
    if prepared is None or inputs.obstacle is not None:
        assert inputs.obstacle is not None
        table, tree = _explain_obstacle(context, inputs, inputs.obstacle)
    else:
        table, tree, prepared = _identify(context, inputs, prepared)
    events = _make_events(context, inputs, prepared, table, tree)
    table = _mark_contact(context, inputs, prepared, (events, table, tree))
    return events, table, tree, average_signals(context, events, table, *find_zeros(context, inputs.movement.posture))


def identify_trial(context: Context) -> tuple[PreparedTrial, Movement, Identification] | NotIdentifiable:
    """Return the prepared trial, its movement and its identification, or the reason why nothing can be identified.

    The results are for the pinned chain. With measured poses, its parameters are computed from those of the bodies.
    """
    inputs = read_inputs(context)
    if inputs.prepared is None or inputs.obstacle is not None:
        assert inputs.obstacle is not None
        return inputs.obstacle
    references = build_reference_bodies(context, inputs.prepared.recorded, inputs.movement)
    found, segments = _fit(context, inputs, inputs.prepared, references)
    return inputs.prepared, inputs.movement, found if segments is None else segments.in_chain


def fit_chain(
    context: Context, prepared: PreparedTrial, movement: Movement, grid: PointGrid, references: ReferenceBodies
) -> Identification:
    """Return the identification of the pinned chain."""
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
        foot_sd=choose_foot_sd(context, prepared.recorded),
        plate_sd=choose_plate_sd(context, prepared.recorded),
    )
    return combine_with_sensors(found, prepared, movement.free, grid, reference, consistency=consistency)


def _fit(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, references: ReferenceBodies
) -> tuple[Identification, SegmentFit | None]:
    """Return the identification of the pinned chain, and the fit of the measured bodies, None if the chain is used."""
    found = fit_chain(context, prepared, inputs.movement, inputs.grid, references)
    if not inputs.body_sets:
        return check_and_calibrate(context, prepared, inputs.movement, found, references.chosen.parameters), None
    return found, fit_segments(context, inputs.body_sets, prepared, inputs.movement, pinned=found, tables=references)


def _make_events(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial | None, dynamics: Table, tree: Tree
) -> Table:
    """Return events.parquet; for sit-to-stand, it contains details of every rise."""
    movement, recorded = inputs.movement, inputs.recorded
    late = float((tree.facts["clock"] or {}).get("applied_s") or 0.0)
    states, names = context.table("states.parquet"), [f"sd_dtheta_{j + 1}" for j in range(recorded.q.shape[1])]
    rejected, segments = states.facts.get("rejected", ()), inputs.chain.segments
    if movement.posture is None:
        measured = find_measured(recorded.time, rejected, segments)
        return make_events([each.leave_out(recorded.time, measured, ("start", "end")) for each in movement.repetitions])
    # the posture depends on the segments up to the hip
    measured = find_measured(recorded.time, rejected, segments[: recorded.knee + 3])
    return make_sit_to_stand_events(
        read_wrench(context)[0],
        recorded,
        movement,
        compute_missing_force(prepared, dynamics.columns),
        share=context.settings.seat_off_share,
        seat_measured=recorded.seat is not None,
        measured=measured,
        modelled=_find_modelled(context, inputs, prepared),
        # the speed is a norm of joint velocities, so its standard deviation is at most the largest of theirs
        speed_sd=states.stack(names).max(axis=1) if set(names) <= set(states.names) else None,
        clock_offset=late if abs(late) > OFFSET_LARGE else 0.0,
    )


def _find_modelled(context: Context, inputs: TrialInputs, prepared: PreparedTrial | None) -> BoolArray:
    """Return True (T,) except where the low-passed motion contains samples with rejected markers."""
    rejected = context.table("states.parquet").facts.get("rejected", ())
    measured = find_measured(inputs.recorded.time, rejected, inputs.chain.segments)
    reach = 0 if prepared is None else prepared.lowpass.reach_samples
    return np.asarray(np.convolve(~measured, np.ones(2 * reach + 1), "same") < 0.5)


def _mark_contact(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial | None, found: tuple[Table, Table, Tree]
) -> Table:
    """Return dynamics.parquet with the column ``contact``; torques that are unknown there become NaN.

    The torque of a joint is the moment of all forces that the motion of the segments beyond it needs, so a force on
    these segments that no plate measures makes it unknown. A chair pushes on the thigh (`seat_segment`): the joints
    from the ground to the knee are unknown. Unless the setting says so, part of the chair's force may act on the
    pelvis; the standard deviation of the next joint, the hip, includes the moment of the whole missing force with
    :data:`_SEAT_LEVER`. A hand on an unmeasured support is beyond all joints. If the movement gives a smaller mass
    than standing (`load-shared`), something carries the body at unknown times, so every sample counts as contact. All
    torques are unknown where markers of a segment are rejected.

    Within the reach of the low-pass after contact, the smoothed motion follows a sudden release too late. The standard
    deviations there include the moment of the difference between modelled and measured wrench.

    ``found`` are events.parquet, dynamics.parquet and dynamics.h5.
    """
    events, dynamics, tree = found
    segments, time = inputs.chain.segments, dynamics["time"]
    given = context.settings.seat_segment
    seat = inputs.recorded.knee + 1 if given is None else find_seat_segment(context, segments)  # from 0, the base
    masses = [(each.value, each.limit) for each in tree.reasons if each.code == "load-shared"]
    by_hand = np.full(len(time), any(moving and standing and moving < standing for moving, standing in masses))
    if "support" in events.names:
        seated = -np.inf  # the hand may push from the end of the repetition before
        for stand, end, support in events.stack(["stand", "end", "support"]):
            if support > SUPPORT_LIMIT:
                by_hand |= (time > seated) & ~(time > stand + _LET_GO)
            seated = np.nanmax([seated, stand, end])
    on_chair, unmeasured = inputs.movement.carried, ~_find_modelled(context, inputs, prepared)
    columns: dict[str, Any] = {"contact": on_chair | by_hand}
    joints = inputs.recorded.q.shape[1]
    late = np.zeros((len(time), joints))
    if prepared is not None and on_chair.any():
        near = np.convolve(on_chair, np.ones(2 * prepared.lowpass.reach_samples + 1), "same") > 0
        wrong = dynamics.stack(WRENCH_COMPONENTS) - dynamics.stack([f"{name}_model" for name in WRENCH_COMPONENTS])
        moment = np.einsum("tcj,tc->tj", prepared.motion.jacobian, np.nan_to_num(wrong))
        late = np.where((near & ~dynamics["in_fit"])[:, None], np.nan_to_num(moment), 0.0)
    for j in range(1, joints + 1):
        unknown = by_hand | unmeasured | (on_chair & (j <= seat))
        torque, sd = dynamics[f"tau_{j}"], np.hypot(dynamics[f"sd_tau_{j}"], late[:, j - 1])
        if j == seat + 1 and given is None:
            missing = dynamics["Fy_model"] - np.nan_to_num(dynamics["Fy"], nan=0.0)
            sd = np.where(on_chair, np.hypot(dynamics[f"sd_tau_{j}"], _SEAT_LEVER * missing), sd)
        columns |= {f"tau_{j}": np.where(unknown, np.nan, torque), f"sd_tau_{j}": np.where(unknown, np.nan, sd)}
    facts: dict[str, Any] = {"legs": "none"}
    if context.trial.protocol != "robot-joint":
        facts = {"legs": "both", "positive": name_directions(inputs.chain.joint_names, find_facing(inputs.recorded))}
    return replace(dynamics.with_columns(**columns), facts=facts)


def _identify(context: Context, inputs: TrialInputs, prepared: PreparedTrial) -> tuple[Table, Tree, PreparedTrial]:
    """Return dynamics.parquet, dynamics.h5 and the prepared trial with the motion that is used."""
    movement, threshold = inputs.movement, read_cop_threshold(context)
    references = build_reference_bodies(context, prepared.recorded, movement)
    found, segments = _fit(context, inputs, prepared, references)
    motion = inputs.motion_facts
    if segments is None:
        result = _describe_chain(context, inputs, prepared, found, references)
    else:
        result = _describe_bodies(context, inputs, prepared, segments)
        motion = motion | segments.facts | {"joints": describe_gaps(segments.bodies, read_joint_names(context))}
    columns = artefacts.make_columns(result)
    facts = artefacts.make_facts(result, read_joint_names(context)) | {
        "external": make_gain_facts(prepared, found.fit),
        "torque": compare_torque(context, columns),
        "motion": motion,
        **make_scale_facts(result.found),
    }
    if inputs.board is not None:
        facts["board"] = inputs.board
    if segments is not None:
        facts["pins"] = compare_motions(prepared, found, movement, segments, threshold)
    cautions = (
        *_find_cautions(context, result),
        *check_torques(context, result, movement.free),
        *validation.explain_validation(facts["held_out"]),
        *explain_motion(facts),
        *explain_board(context, facts),
    )
    prior = explain_foot_prior(context, result.found)
    reasons = (*movement.reasons, *references.chosen.reasons, *prior, *cautions)
    tree = Tree(DYNAMICS_TREE, artefacts.make_data(result), facts, reasons)
    return Table(DYNAMICS_TABLE, columns), tree, result.prepared


def _describe_chain(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, found: Identification, references: ReferenceBodies
) -> artefacts.IdentifiedDynamics:
    q, threshold, chain = prepared.recorded.q, read_cop_threshold(context), inputs.chain
    sigma_v = np.asarray(context.table("states.parquet").facts["sigma_v"], dtype=np.float64)
    snap = np.broadcast_to(sigma_v, (q.shape[1],))  # standard deviation of the process noise, rad/s⁴
    correlation = correlate_errors(q, chain.centres, chain.marker_segment, chain.local, snap)

    def model_of(each: Identification) -> Prediction:
        return predict(prepared, each, estimate_chain_noise(prepared, each, correlation, inputs.centre_sd), threshold)

    model = model_of(found)
    if found.with_foot is not None:
        model = model.replace_torques(model_of(found.with_foot))
    excited = measure_excitation(prepared, found, choose_weak_share(context))
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


def _describe_bodies(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, segments: SegmentFit
) -> artefacts.IdentifiedDynamics:
    threshold = read_cop_threshold(context)
    excited = measure_excitation(prepared, segments.in_chain, choose_weak_share(context))
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


def choose_weak_share(context: Context) -> float:
    """Return the relative standard deviation above which a parameter is weak; a robot has a smaller default."""
    given: float | None = context.settings.weak_share
    return given or (WEAK_ROBOT if context.trial.protocol == "robot-joint" else WEAK)


def _find_cautions(context: Context, result: artefacts.IdentifiedDynamics) -> tuple[Reason, ...]:
    """Return cautions about the identification, and about quantities that the fitted components do not determine."""
    facts = context.table("wrench.parquet").facts
    standing, given = facts.get("mass_kg"), context.trial.subject.mass
    recommended = describe_recommendations(result.excitation, result.recommendations, read_joint_names(context))
    reasons = find_cautions(
        result.prepared,
        result.found,
        result.excitation,
        recommended,
        given=given,
        standing=standing,
        calibration=read_calibration(context),
    )
    contradictions = check_sensors(result.chain, result.in_chain.fit)
    if not contradictions:  # a sensor with a wrong sign changes the mass too
        _refuse_shared_load(reasons)
    implausible = judge_mass(context, standing or get_identified_mass(result.prepared, result.found))
    reasons += () if implausible is None else (implausible,)
    reasons += contradictions
    stands = standing is not None and context.trial.protocol == "sit-to-stand"
    reasons += explain_scales(result.found, given, stands=stands)
    if undetermined := artefacts.find_undetermined(result):
        text = (
            f"the fitted components {', '.join(context.settings.components)} do not determine "
            f"{', '.join(undetermined)}, which have no values; fit at least Fy and tauz (`identify-dim: {{components: "
            "[Fy, tauz]}`)"
        )
        reasons = (*reasons, Reason("components-short", text))
    if context.trial.protocol == "free" and standing is None and given is None:
        text = (
            "the identified mass could not be compared with the mass of the standing person "
            f"({facts.get('why') or 'the plates do not measure it'}) or with `subject: {{mass: …}}`: if a chair or a "
            "support carries part of the body, the parameters are wrong, and no other check detects this"
        )
        reasons = (*reasons, Reason("mass-unchecked", text))
    return reasons


def _refuse_other_mass(context: Context) -> None:
    """Raise Refused if the given mass is far from the standing one and no load in the hands explains it."""
    facts, given = context.table("wrench.parquet").facts, context.trial.subject.mass
    standing = facts.get("mass_kg")
    if standing is None or given is None or abs(standing / given - 1.0) <= MASS_CONTRADICTS:
        return
    lightest, heaviest = facts.get("mass_range_kg") or (standing, standing)
    if abs(lightest / given - 1.0) <= _SAME and heaviest > (1.0 + _SAME) * lightest:
        return  # the person stands with and without a load; `mass-contradiction` remains a caution
    beside = (facts.get("registration") or {}).get("foot_beside") is not None
    cause = "One foot stands beside the plates. " if beside else ""
    raise Refused(
        "mass-contradiction",
        f"the plates measure {standing:.1f} kg while the person stands, but `subject: {{mass: …}}` is {given:g} kg: a "
        f"difference of {100 * (standing / given - 1.0):+.0f} %, expected within ± {100 * MASS_CONTRADICTS:.0f} %. No "
        f"load that is taken up or put down explains it. {cause}Check the mass, that the recording is of this person, "
        "that both feet are on plates that are used, the units and the calibration of the plates, and whether the "
        "person holds an object all the time",
        standing,
        given,
    )


def _refuse_shared_load(reasons: Sequence[Reason]) -> None:
    """Raise Refused if the identified mass is far from the standing one."""
    for each in reasons:
        far = each.value and each.limit and abs(each.value / each.limit - 1.0) > MASS_CONTRADICTS
        if each.code == "load-shared" and far:
            raise Refused(each.code, each.message, each.value, each.limit)


def _explain_obstacle(context: Context, inputs: TrialInputs, obstacle: NotIdentifiable) -> tuple[Table, Tree]:
    """Return dynamics.parquet and dynamics.h5 of a trial without an identification."""
    recorded, movement, threshold = inputs.recorded, inputs.movement, read_cop_threshold(context)
    references = build_reference_bodies(context, recorded, movement)
    reference, facts = artefacts.make_facts_without_model(
        obstacle.why, recorded, references, movement.free, cop_threshold=threshold, gravity=context.settings.gravity
    )
    columns = artefacts.make_empty_columns(recorded, reference, threshold)
    data = artefacts.make_empty_data(recorded.centres, inputs.grid, obstacle.mass, references.chosen.parameters)
    reasons = (*movement.reasons, *references.chosen.reasons, Reason(obstacle.code, obstacle.why))
    implausible = judge_mass(context, obstacle.mass)
    if implausible is not None:
        reasons = (*reasons, implausible)
    stands = obstacle.mass is not None and context.trial.protocol == "sit-to-stand"
    if stands and context.trial.subject.mass is None:
        reasons = (*reasons, ON_TRUST)
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, reasons)
