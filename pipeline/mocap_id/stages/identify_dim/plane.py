"""Stage identify-dim in the plane: identifies the dynamics, and describes and averages the repetitions.

:func:`identify_dim` is the whole stage, :func:`prepare_trial` reads the trial and chooses the motion of the masses,
:func:`describe_identified` is the method: the fit, the model's wrench and torques, and what is said about them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, as_complex
from mocap_id.design.proposal import describe_recommendations, recommend_if_doubtful
from mocap_id.dynamics.built_in_sensors import combine_with_sensors
from mocap_id.dynamics.cautions import (
    OFFSET_LARGE,
    WEAK,
    WEAK_ROBOT,
    estimate_gains,
    find_cautions,
    get_identified_mass,
    measure_excitation,
)
from mocap_id.dynamics.consistency import PointGrid, build_grid
from mocap_id.dynamics.identification import Identification, identify, score_left_out
from mocap_id.dynamics.instrument_errors import correlate_errors
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.prediction import Prediction, centre_of_pressure, estimate_chain_noise, predict
from mocap_id.dynamics.preparation import PreparedTrial, TrialData, measure_arcs, prepare
from mocap_id.dynamics.priors import build_even_prior
from mocap_id.dynamics.regressor import (
    WRENCH_COMPONENTS,
    base_names,
    list_base_units,
    name_parameters,
    planar_regressor,
    structural_base,
)
from mocap_id.errors import Refused
from mocap_id.kinematics.clusters import BENDS_M
from mocap_id.kinematics.joint import count_positions
from mocap_id.protocols.body_names import name_directions
from mocap_id.protocols.movement import Movement, find_facing, find_movement
from mocap_id.protocols.repetitions import SUPPORT_LIMIT
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.dynamics_artefacts import (
    NO_FACTS,
    describe_fit,
    describe_validation,
    explain_validation,
    make_datasets,
    make_dynamics_columns,
    validate,
)
from mocap_id.stages.identify_dim.events import (
    average_signals,
    compute_missing_force,
    find_zeros,
    make_events,
    make_sit_to_stand_events,
)
from mocap_id.stages.identify_dim.segment_fit import (
    ASKED_FOR,
    ON_TRUST,
    BodyFit,
    MeasuredBodies,
    Predictor,
    check_and_calibrate,
    compare_motions,
    compare_torque,
    estimate_hidden_gaps,
    explain_motion,
    explain_scales,
    filter_measured,
    find_measured_bodies,
    fit_bodies,
    make_body_prior,
    make_predictor,
    pin_joints,
    pin_joints_that_hold,
    prepare_bodies,
    read_calibration,
)
from mocap_id.stages.identify_dim.trial_data import (
    FOOT_SD,
    MASS_CONTRADICTS,
    NotIdentifiable,
    ReferenceBodies,
    build_reference_bodies,
    check_chair,
    check_excitation,
    check_sensors,
    check_wrench,
    compare_references,
    describe_errors,
    explain_board,
    find_seat_segment,
    judge_mass,
    locate_board,
    make_fit_settings,
    read_cop_threshold,
    read_kinematic_error,
    read_trial_data,
    read_wrench,
)
from mocap_id.store import Table, Tree
from mocap_id.store.artefacts import Skeleton, find_measured
from mocap_id.store.provenance import DYNAMICS_TABLE, DYNAMICS_TREE
from mocap_id.verdict import Reason

_LET_GO = 0.4  # s after `stand`: in simulations, a person comes to rest up to 0.37 s later
_SEAT_LEVER = 0.04  # m, horizontal distance between the hip and the part of the chair's force that acts on the pelvis
_SAME = 0.1
"""Relative difference of two masses up to which they are the same, while the person stands without a load."""
_FEW = 3  # marker positions on a segment; clusters have at least as many
_TORQUE = 5.0  # N·m, largest rms error of a torque without a caution
_ONE_IN_100 = 2.576  # standard deviations that a normal error exceeds in one of 100 cases
_BENT = 1.4  # error of the chain's hip in one direction, relative to its shift by a bending trunk; half is corrected


def identify_dim(context: Context) -> Outputs:
    """Return events.parquet, dynamics.parquet, dynamics.h5 and phases.parquet of a trial in the plane."""
    _refuse_other_mass(context)
    inputs = prepare_trial(context)
    recorded, movement, prepared = inputs.recorded, inputs.movement, inputs.prepared
    if inputs.obstacle is None:
        assert prepared is not None
        dynamics, tree, prepared = describe_identified(context, inputs, prepared)
    else:
        dynamics, tree = describe_unidentified(context, inputs, inputs.obstacle)

    # samples without rejected markers, and those whose low-passed motion contains only such samples
    states, segments, time = context.table("states.parquet"), inputs.chain.segments, recorded.time
    rejected = states.facts.get("rejected", ())
    measured = find_measured(time, rejected, segments)
    reach = 0 if prepared is None else prepared.lowpass.reach_samples
    modelled = np.asarray(np.convolve(~measured, np.ones(2 * reach + 1), "same") < 0.5)

    # events: for sit-to-stand with the details of every rise
    joints = recorded.q.shape[1]
    if movement.posture is None:
        repetitions = [each.leave_out(time, measured, ("start", "end")) for each in movement.repetitions]
        events = make_events([asdict(each) for each in repetitions])
    else:
        late = float((tree.facts["clock"] or {}).get("applied_s") or 0.0)
        names = [f"sd_dtheta_{j + 1}" for j in range(joints)]
        events = make_sit_to_stand_events(
            read_wrench(context)[0],
            recorded,
            movement,
            compute_missing_force(prepared, dynamics.columns),
            share=context.settings.seat_off_share,
            seat_measured=recorded.seat is not None,
            # the posture depends on the segments up to the hip
            measured=find_measured(time, rejected, segments[: recorded.knee + 3]),
            modelled=modelled,
            # the speed is a norm of joint velocities, so its standard deviation is at most the largest of theirs
            speed_sd=states.stack(names).max(axis=1) if set(names) <= set(states.names) else None,
            clock_offset=late if abs(late) > OFFSET_LARGE else 0.0,
        )

    # contact with unmeasured force. The torque of a joint is the moment of all forces that the motion of the segments
    # beyond it needs, so such a force on these segments makes it unknown. A chair pushes on the thigh (`seat_segment`):
    # the joints from the ground to the knee are unknown. A hand on a support is beyond all joints; it may push from the
    # end of the repetition before. If the movement gives a smaller mass than standing, something carries the body at
    # unknown times, so every sample counts as contact. All torques are unknown where markers of a segment are rejected.
    given = context.settings.seat_segment
    seat = recorded.knee + 1 if given is None else find_seat_segment(context, segments)  # from 0, the base
    masses = [(each.value, each.limit) for each in tree.reasons if each.code == "load-shared"]
    by_hand = np.full(len(time), any(moving and standing and moving < standing for moving, standing in masses))
    if "support" in events.names:
        seated = -np.inf
        for stand, end, support in events.stack(["stand", "end", "support"]):
            if support > SUPPORT_LIMIT:
                by_hand |= (time > seated) & ~(time > stand + _LET_GO)
            seated = np.nanmax([seated, stand, end])
    on_chair = movement.carried
    columns: dict[str, Any] = {"contact": on_chair | by_hand}
    # within the reach of the low-pass after contact, the smoothed motion follows a sudden release too late: standard
    # deviations include the moment of the difference between modelled and measured wrench
    late_moment = np.zeros((len(time), joints))
    if prepared is not None and on_chair.any():
        near = np.convolve(on_chair, np.ones(2 * reach + 1), "same") > 0
        wrong = dynamics.stack(WRENCH_COMPONENTS) - dynamics.stack([f"{name}_model" for name in WRENCH_COMPONENTS])
        moment = np.einsum("tcj,tc->tj", prepared.motion.jacobian, np.nan_to_num(wrong))
        late_moment = np.where((near & ~dynamics["in_fit"])[:, None], np.nan_to_num(moment), 0.0)
    for j in range(1, joints + 1):
        unknown = by_hand | ~modelled | (on_chair & (j <= seat))
        torque, sd = dynamics[f"tau_{j}"], np.hypot(dynamics[f"sd_tau_{j}"], late_moment[:, j - 1])
        if j == seat + 1 and given is None:  # part of the chair's force may act on the pelvis
            missing = dynamics["Fy_model"] - np.nan_to_num(dynamics["Fy"], nan=0.0)
            sd = np.where(on_chair, np.hypot(dynamics[f"sd_tau_{j}"], _SEAT_LEVER * missing), sd)
        columns |= {f"tau_{j}": np.where(unknown, np.nan, torque), f"sd_tau_{j}": np.where(unknown, np.nan, sd)}
    facts: dict[str, Any] = {"legs": "none"}
    if context.trial.protocol != "robot-joint":
        facts = {"legs": "both", "positive": name_directions(inputs.chain.joint_names, find_facing(recorded))}
    dynamics = replace(dynamics.with_columns(**columns), facts=facts)
    return events, dynamics, tree, average_signals(context, events, dynamics, *find_zeros(context, movement.posture))


@dataclass(frozen=True)
class PlanarTrial:
    """A trial in the plane before its identification."""

    chain: Skeleton
    recorded: TrialData  # joint states and wrenches
    prepared: PreparedTrial | None  # trial on the pinned chain; None without a usable wrench
    movement: Movement  # repetitions, contact and usable samples
    grid: PointGrid  # point masses of the chain's segments
    obstacle: NotIdentifiable | None  # reason why nothing can be identified; None if there is none
    bodies: MeasuredBodies | None  # bodies with measured poses, pinned at the joints that hold; None for the chain
    motion_facts: dict[str, Any]  # JSON about the choice between chain and poses
    centre_sd: FloatArray  # (n,) standard deviation of each joint centre from the gap of its joint, m
    # fact ``board`` of dynamics.h5: position of a balance board; None without a board
    board: dict[str, Any] | None = None


def prepare_trial(context: Context) -> PlanarTrial:
    """Return the data of a trial, the motion chosen for its masses, and the usable samples."""
    settings: IdentifyDimSettings = context.settings
    chain, standing = Skeleton(context.tree("chain.h5")), context.table("wrench.parquet").facts.get("mass_kg")
    recorded = read_trial_data(context, chain)
    obstacle = check_wrench(context, recorded)
    prepared, board = None, None
    of_chair: tuple[Reason, ...] = ()
    if obstacle is None:
        components = (WRENCH_COMPONENTS.index(name) for name in settings.components)
        fitted = (component for component in components if component in recorded.measures)
        prepared = prepare(recorded, make_fit_settings(settings, fitted, recorded.clock.search))
        prepared, of_chair = check_chair(prepared)
        recorded = prepared.recorded

    def find_repetitions(trial: PreparedTrial | None) -> Movement:
        movement = find_movement(
            context.trial.protocol,
            recorded,
            trial,
            settings.contact,
            weight_share=settings.seat_off_share,
            knee_bend=settings.knee_bend_rad,
            stands=standing is not None,
        )
        return replace(movement, reasons=(*of_chair, *movement.reasons))

    grid = build_grid(chain.centres, chain.marker_segment, chain.local, settings.grid)
    movement = find_repetitions(prepared)
    if prepared is not None:
        obstacle = check_excitation(context, prepared, movement)
        if obstacle is None:
            prepared, board = locate_board(context, prepared, movement)
            recorded = prepared.recorded
    candidates, facts, centre_sd = _choose_motion(context, recorded, chain)
    inputs = PlanarTrial(chain, recorded, prepared, movement, grid, obstacle, None, facts, centre_sd, board)
    if prepared is None or obstacle is not None or not candidates:
        return inputs

    # the bodies that predict left-out repetitions best with the usual cut-offs
    mass: float = standing or float(np.nanmedian(recorded.surroundings[:, 1])) / float(settings.gravity)
    on_chain, table = prepared, build_reference_bodies(context, recorded, movement).chosen

    def predict_with(bodies: MeasuredBodies) -> Predictor:
        prior = make_body_prior(bodies, recorded.q, movement, table, mass if table.mass is None else table.mass)
        return make_predictor(on_chain, movement, bodies, prior)

    bodies = candidates[0]
    if len(candidates) > 1:
        bodies = min(reversed(candidates), key=lambda each: score_left_out(predict_with(pin_joints(each))(USUAL)))

    # pins of the joints that hold; if all hold, the chain is used
    if settings.motion == "segments":
        bodies = pin_joints(bodies)
    else:
        hip = chain.joints.index("hip") if "hip" in chain.joints else None
        bodies = pin_joints_that_hold(bodies, predict_with, hip)
    if settings.motion == "chain" or not bodies.loose:
        why = "the gap of a joint is above the noise, but left-out repetitions are not predicted better without its pin"
        why = ASKED_FOR if settings.motion else why
        joints = _describe_gaps(bodies, chain.joint_names)
        return replace(inputs, motion_facts=facts | {"source": "chain", "why": why, "joints": joints})
    on_poses = prepare_bodies(bodies, recorded, prepared.settings, build_even_prior(mass, bodies.poses.centroid))
    on_bodies = find_repetitions(on_poses)
    if check_excitation(context, prepared, on_bodies) is not None:
        on_bodies = movement
    return replace(inputs, bodies=bodies, movement=on_bodies)


def _choose_motion(
    context: Context, recorded: TrialData, chain: Skeleton
) -> tuple[tuple[MeasuredBodies, ...], dict[str, Any], FloatArray]:
    """Return bodies with measured poses, facts about the choice, and ``centre_sd``; no bodies for the pinned chain."""
    requested, centre_sd = context.settings.motion, np.zeros(len(recorded.centres))
    if context.trial.protocol == "robot-joint" and requested != "segments":
        return (), {"source": "chain", "why": ASKED_FOR if requested else "the joint of a robot is pinned"}, centre_sd
    body_sets = find_measured_bodies(context, recorded)
    first = next(body_sets, None)
    if first is None:
        if requested == "chain":
            return (), {"source": "chain", "why": ASKED_FOR, "joints": {}}, centre_sd
        why = "the pose of a segment cannot be measured: its markers are too few, or missing too often"
        return (), {"source": "chain", "why": why}, centre_sd

    # a gap that follows the angle of its joint, as far as skin does not explain it
    of_fit = np.nan_to_num(np.einsum("jkk->j", chain.covariance) / 2)
    shifts = np.zeros((len(centre_sd), 2)) if first.poses.shift is None else first.poses.shift
    for joint in first.gap:
        hidden = float(estimate_hidden_gaps(first.poses, [joint])[joint])
        bend = float(np.linalg.norm(shifts[joint]))
        moved = _BENT * bend if bend >= BENDS_M else 0.0  # the chain's hip is not corrected for a bending trunk
        centre_sd[joint] = np.hypot(np.sqrt(max(hidden - of_fit[joint], 0.0)), moved)
    source, why = "segments", "the two sides of a joint separate"
    if requested == "chain":
        source, why = "chain", ASKED_FOR
    elif not first.loose:
        source, why = "chain", "the gaps of all joints are within the noise"
    facts = {"source": source, "why": why, "joints": _describe_gaps(first, chain.joint_names)}
    return (first, *body_sets) if first.loose else (), facts, centre_sd


def _describe_gaps(bodies: MeasuredBodies, names: Sequence[str]) -> dict[str, Any]:
    """Return JSON about the gap of each joint between two bodies, by the name of the joint."""
    return {
        names[joint]: {
            "gap_m": gap.size if np.isfinite(gap.size) else None,
            "acceleration_m_s2": gap.acceleration if np.isfinite(gap.acceleration) else None,
            "pinned": gap.pinned,
        }
        for joint, gap in bodies.gap.items()
    }


def identify_trial(context: Context) -> tuple[PreparedTrial, Movement, Identification] | NotIdentifiable:
    """Return the prepared trial, its movement and its identification, or the reason why nothing can be identified.

    The results are for the pinned chain. With measured poses, its parameters are computed from those of the bodies.
    """
    inputs = prepare_trial(context)
    if inputs.obstacle is not None:
        return inputs.obstacle
    assert inputs.prepared is not None
    references = build_reference_bodies(context, inputs.prepared.recorded, inputs.movement)
    found, bodies = _fit(context, inputs, inputs.prepared, references)
    return inputs.prepared, inputs.movement, found if bodies is None else bodies.in_chain


def identify_on_chain(
    context: Context, prepared: PreparedTrial, movement: Movement, grid: PointGrid, references: ReferenceBodies
) -> Identification:
    """Return the identification of the pinned chain.

    The prior of the foot (4.13) is the standard deviation of the foot's first moment divided by the body's mass. A
    robot has none, and neither has a person if the standard deviation of the ankle's position is unknown. With measured
    forces of a chair or on a hand, there is a prior only for few markers, because other cases were not tested. Few
    markers need it for the parameters too; otherwise only the torques use it.
    """
    settings: IdentifyDimSettings = context.settings
    consistency, reference = settings.consistency or "grid", references.chosen.parameters
    chain, asked = Skeleton(context.tree("chain.h5")), settings.reference_pulls
    ankle, few = chain.covariance[:1], _has_few_markers(context, chain)
    with_prior = asked in {None, "foot"} and context.trial.protocol != "robot-joint" and bool(np.isfinite(ankle).any())
    if asked is None and prepared.recorded.external and not few:
        with_prior = False
    for_torques_only = not few and asked != "foot"
    found = identify(
        prepared,
        movement.free,
        grid,
        reference,
        read_kinematic_error(context),
        consistency=consistency,
        reference_sd=settings.reference_sd,
        reference_pulls=asked is True,
        foot_sd=float(np.hypot(FOOT_SD, np.sqrt(ankle[0, 0, 0]))) if with_prior else None,
        plate_sd=prepared.recorded.position_sd or read_calibration(context).position if for_torques_only else None,
    )
    return combine_with_sensors(found, prepared, movement.free, grid, reference, consistency=consistency)


def _has_few_markers(context: Context, chain: Skeleton) -> bool:
    """Return whether a moving segment of a person has markers at only one or two positions."""
    local = as_complex(chain.local)
    counts = [count_positions(local[chain.marker_segment == k]) for k in range(1, len(chain.centres) + 1)]
    return context.trial.protocol != "robot-joint" and min(counts) < _FEW


def _fit(
    context: Context, inputs: PlanarTrial, prepared: PreparedTrial, references: ReferenceBodies
) -> tuple[Identification, BodyFit | None]:
    """Return the identification of the pinned chain, and that of the measured bodies or None if the chain is used."""
    found = identify_on_chain(context, prepared, inputs.movement, inputs.grid, references)
    if inputs.bodies is None:
        return check_and_calibrate(context, prepared, inputs.movement, found, references.chosen.parameters), None
    return found, fit_bodies(context, inputs.bodies, prepared, inputs.movement, pinned=found, tables=references)


def describe_identified(
    context: Context, inputs: PlanarTrial, prepared: PreparedTrial
) -> tuple[Table, Tree, PreparedTrial]:
    """Return dynamics.parquet, dynamics.h5 and the prepared trial with the motion that is used.

    ``prepared``, ``pinned`` and ``in_chain`` belong to the pinned chain; ``trial``, ``found`` and ``tables`` to the
    motion that is used: measured poses (``bodies``) or the pinned chain.
    """
    movement, threshold, joints = inputs.movement, read_cop_threshold(context), inputs.chain.joint_names
    references = build_reference_bodies(context, prepared.recorded, movement)
    pinned, bodies = _fit(context, inputs, prepared, references)

    # wrench and torques of the model, and predictions of repetitions by a model of the others
    motion = inputs.motion_facts
    if bodies is None:
        trial, found, in_chain, tables, grid = prepared, pinned, pinned, references, inputs.grid
        q, chain = prepared.recorded.q, inputs.chain
        sigma_v = np.asarray(context.table("states.parquet").facts["sigma_v"], dtype=np.float64)
        snap = np.broadcast_to(sigma_v, (q.shape[1],))  # standard deviation of the process noise, rad/s⁴
        correlation = correlate_errors(q, chain.centres, chain.marker_segment, chain.local, snap)

        def model_of(each: Identification) -> Prediction:
            noise = estimate_chain_noise(prepared, each, correlation, inputs.centre_sd)
            return predict(prepared, each, noise, threshold)

        model = model_of(found)
        if found.with_foot is not None:
            model = model.replace_torques(model_of(found.with_foot))
        left_out = validate(prepared, movement, found, model.wrench)
        held_out = None if isinstance(left_out, str) else (left_out.base, left_out.offset)
        prior_share = np.full(len(found.base), np.nan if found.uses_reference else 0.0)
    else:
        assert inputs.bodies is not None
        trial, found, in_chain = bodies.prepared, bodies.found, bodies.in_chain
        tables, grid = bodies.references, bodies.grid
        model = predict(trial, found, bodies.noise, threshold)
        left_out, held_out, prior_share = bodies.left_out, bodies.held_out, bodies.prior_share
        motion = motion | {
            "bands_hz": dict(zip(("x", "y", "angle"), bodies.bands, strict=True)),
            "bands_why": bodies.bands_why,
            "bodies": list(inputs.bodies.names),
            "used": list(inputs.bodies.used),
            "prior": bodies.prior.source,
            "prior_share": prior_share.tolist(),
            "bodies_condition_number": found.fit.condition,
            "bodies_condition_number_scaled": found.fit.condition_scaled,
            "joints": _describe_gaps(inputs.bodies, joints),
        }
    excited = measure_excitation(prepared, in_chain, choose_weak_share(context))
    recommendations = recommend_if_doubtful(prepared, in_chain, excited)

    # dynamics.parquet; clock offset and bias of Fx are removed from the measured wrench
    fit, position_sd = found.fit, trial.recorded.position_sd
    elsewhere = trial.elsewhere(fit.offset)
    measured = np.asarray(trial.ground(fit.offset) - np.array([found.plate_bias or 0.0, 0.0, 0.0]))
    reference = trial.regressor @ tables.chosen.parameters - elsewhere
    lower: FloatArray | float = 0.0  # distance along x from the centre of pressure at a board's cells to its surface
    if trial.recorded.surface:
        vertical = np.where(model.wrench[:, 1] > threshold, model.wrench[:, 1], np.nan)
        lower = trial.recorded.surface * model.wrench[:, 0] / vertical
    wrench_sd, cop_sd = model.wrench_sd, model.cop_sd
    if position_sd is not None:  # the position of a balance board is uncertain
        wrench_sd = wrench_sd.copy()
        wrench_sd[:, 2] = np.hypot(wrench_sd[:, 2], position_sd * model.wrench[:, 1])
        cop_sd = np.hypot(cop_sd, position_sd)
    series = {
        "{}": (measured, centre_of_pressure(measured, threshold) - lower),
        "{}_model": (model.wrench, model.cop - lower),
        "sd_{}_model": (wrench_sd, cop_sd),
        "{}_reference": (reference, centre_of_pressure(reference, threshold) - lower),
    }
    if not isinstance(left_out, str):
        series["{}_held_out"] = left_out.wrench, centre_of_pressure(left_out.wrench, threshold) - lower
    time = trial.recorded.time
    columns = make_dynamics_columns(
        time, WRENCH_COMPONENTS, series, torque=model.torque, torque_sd=model.torque_sd, in_fit=fit.in_fit
    )
    if trial.recorded.external:
        columns |= {f"{name}_external": column for name, column in zip(WRENCH_COMPONENTS, elsewhere.T, strict=True)}

    # datasets of dynamics.h5
    centres = trial.recorded.centres
    of_bodies = None
    if bodies is not None:
        covariance = found.covariance if found.calibration is None else found.covariance - found.calibration.covariance
        of_bodies = found.full, tables.chosen.parameters, covariance
    data = make_datasets(
        base_names(prepared.base, centres),
        in_chain.base,
        name_parameters(len(centres) + 1),
        units=list_base_units(prepared.base),
        regrouping=prepared.base.regrouping,
        sd=np.sqrt(np.diag(in_chain.covariance)),
        covariance=in_chain.covariance,
        full=in_chain.full,
        excitation=excited,
        prior_share=prior_share,
        reference=references.chosen.parameters,
        bodies=of_bodies,
        grid=grid,
        masses=found.solution.masses,
        held_out=held_out,
    )

    # facts of dynamics.h5; with measured poses, filtered wrenches are compared
    rows, modelled, plates, others = trial.regressor, model.wrench, measured, elsewhere
    if bodies is not None:
        rows, modelled, others = trial.filtered, trial.filtered @ found.base, 0.0 * elsewhere
        plates = filter_measured(trial, found)
    moved = trial.motion.joint
    # columns without values, except the torques of joints whose two sides are in one body
    inner = {f"tau_{j + 1}" for j in range(moved.shape[1]) if not np.isfinite(moved[:, j]).any()}
    undetermined = ", ".join(name for name in model.undetermined if name not in inner)
    contact, gains = movement.contact, estimate_gains(prepared, found.fit)
    scales = None
    if found.scales is not None:
        causes, suspects = found.scales
        scales = {"suspects": list(suspects), "causes": {name: asdict(cause) for name, cause in causes.items()}}
    facts = {
        **NO_FACTS,
        "condition_number": in_chain.fit.condition,
        "condition_number_scaled": in_chain.fit.condition_scaled,
        **describe_fit(trial, found, found.solution.requested),
        **describe_errors(modelled, plates, fit.in_fit, threshold),
        "reference_table": tables.chosen.table,
        "rivals": compare_references(tables, rows, plates, fit.in_fit, threshold, external=others),
        "held_out": describe_validation(
            movement,
            left_out,
            modelled,
            rows @ tables.chosen.parameters - others,
            measured=plates,
            threshold=threshold,
            filtered=bodies is not None,
        ),
        "consistency": found.solution.consistency,
        "reference_pulls": found.uses_reference,
        "plate_bias_N": None if found.plate_bias is None else {"Fx": found.plate_bias, "Fx_sd": found.plate_bias_sd},
        "untold": list(model.undetermined),
        "arc_deg": np.degrees(measure_arcs(trial.recorded.q, fit.in_fit)).tolist(),
        "contact": None
        if contact is None
        else {
            "chair": contact.chair,
            "rule": contact.rule,
            "converged": contact.converged,
            "standing_weight_N": contact.weight if np.isfinite(contact.weight) else None,
            "threshold_N": contact.threshold,
        },
        # fitted gain of each component of the other wrenches; 1 is correct
        "external": [
            {
                "name": each.name,
                "segment": each.segment,
                "factors": {g.component: {"value": g.value, "sd": g.sd} for g in gains if g.name == each.name},
            }
            for each in prepared.recorded.external
        ],
        # the best change of the movement for each base parameter; empty if no parameter is doubtful
        "advice": [
            {
                "name": name,
                "change": None if one is None else one.change,
                "joint": None if one is None or one.joint is None else joints[one.joint],
                "sd_ratio": None if one is None else one.ratio,
                "text": None if one is None else one.describe(joints).removesuffix(","),
            }
            for name, one in zip(excited.names, recommendations, strict=bool(recommendations))
        ],
        "motion": motion,
        "scales": scales,
        "calibration_covariance": None if found.calibration is None else found.calibration.covariance.tolist(),
        "torque": compare_torque(context, columns),
    }
    if undetermined:
        facts["why"] = (
            f"the fitted components of the wrench do not determine {undetermined}: see `identify-dim: "
            "{components: …}`"
        )
    if inputs.board is not None:
        facts["board"] = inputs.board
    if bodies is not None:
        facts["pins"] = compare_motions(prepared, pinned, movement, bodies, threshold)

    # cautions about the identification, and about quantities that the fitted components do not determine
    standing, given = context.table("wrench.parquet").facts.get("mass_kg"), context.trial.subject.mass
    cautions = find_cautions(
        trial,
        found,
        excited,
        describe_recommendations(excited, recommendations, joints),
        given=given,
        standing=standing,
        calibration=read_calibration(context),
    )
    contradictions = check_sensors(prepared, in_chain.fit)
    for each in cautions:  # a sensor with a wrong sign changes the mass too
        far = each.value and each.limit and abs(each.value / each.limit - 1.0) > MASS_CONTRADICTS
        if each.code == "load-shared" and far and not contradictions:
            raise Refused(each.code, each.message, each.value, each.limit)
    implausible = judge_mass(context, standing or get_identified_mass(trial, found))
    out = Findings((*movement.reasons, *references.chosen.reasons))
    if found.with_foot is not None:
        out.say(
            "foot-prior",
            "the torques also use the first moment of the reference body's foot, which the data hardly determine; "
            "parameters and wrench depend on the data alone. Set `identify-dim: {reference_pulls: false}` to use the "
            "data alone for both",
            level="ok",
        )
    elif found.uses_reference and context.settings.reference_pulls is not True:
        out.say(
            "foot-prior",
            "a segment has markers at only one or two positions. The foot's first moment is therefore taken from the "
            "reference body and the position of the ankle, not from the data alone; the torque of the ankle then "
            "follows from the centre of pressure. Set `identify-dim: {reference_pulls: false}` to use the data alone",
            level="ok",
        )
    out.reasons += [*cautions, *(() if implausible is None else (implausible,)), *contradictions]
    stands = standing is not None and context.trial.protocol == "sit-to-stand"
    explain_scales(out, found, given, stands=stands)
    if undetermined:
        out.say(
            "components-short",
            f"the fitted components {', '.join(context.settings.components)} do not determine {undetermined}, which "
            "have no values; fit at least Fy and tauz (`identify-dim: {components: [Fy, tauz]}`)",
        )
    if context.trial.protocol == "free" and standing is None and given is None:
        why = context.table("wrench.parquet").facts.get("why") or "the plates do not measure it"
        out.say(
            "mass-unchecked",
            f"the identified mass could not be compared with the mass of the standing person ({why}) or with `subject: "
            "{mass: …}`: if a chair or a support carries part of the body, the parameters are wrong, and no other "
            "check detects this",
        )
    _check_torques(out, context, inputs, trial, found=found, model=model)
    explain_validation(out, facts["held_out"])
    explain_motion(out, facts)
    explain_board(out, context, facts)
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, tuple(out.reasons)), trial


def choose_weak_share(context: Context) -> float:
    """Return the relative standard deviation above which a parameter is weak; a robot has a smaller default."""
    given: float | None = context.settings.weak_share
    return given or (WEAK_ROBOT if context.trial.protocol == "robot-joint" else WEAK)


def _check_torques(
    out: Findings,
    context: Context,
    inputs: PlanarTrial,
    trial: PreparedTrial,
    *,
    found: Identification,
    model: Prediction,
) -> None:
    """Add a caution about torques of the pinned chain that may be wrong by more than 5 N·m rms.

    The errors of parameters and geometry are constant in a trial and normal over trials; errors of the motion add their
    mean square. The caution is for torques whose error exceeds 5 N·m in more than one of 100 trials. Errors of scale
    are left out, because they are the same in all trials of a laboratory.
    """
    chain = inputs.chain
    used = inputs.movement.free & np.isfinite(model.torque_sd).any(axis=1)
    untested = bool(trial.recorded.external) and not _has_few_markers(context, chain)
    if context.trial.protocol == "robot-joint" or untested or trial.prior is not None or not used.any():
        return
    constant, noise = (np.nanmean(sd[used] ** 2, axis=0) for sd in (model.torque_lasting_sd, model.torque_noise_sd))
    measured = trial.measured(found.fit.offset)
    off = np.asarray((measured - model.wrench)[:, WRENCH_COMPONENTS.index("tauz")])
    excess = max(float(np.nanmean(off[used] ** 2) - np.mean(off[found.fit.in_fit] ** 2)), 0.0)
    error = np.sqrt(_ONE_IN_100**2 * constant + noise + excess)
    large = np.flatnonzero(error > _TORQUE)
    if not len(large):
        return
    text = ", ".join(f"{chain.joint_names[j]} {error[j]:.1f} N·m" for j in large)
    worst = large[np.argmax(error[large])]
    why = "The positions of the joints and the masses of the segments after them are uncertain"
    if excess > _ONE_IN_100**2 * constant[worst]:
        at = trial.recorded.time[used][np.nanargmax(np.abs(off[used]))]
        why = f"The model differs from the plate around {at:.1f} s: fill marker gaps there, or exclude it by `window:`"
    out.say(
        "torque-uncertain",
        f"in one of 100 trials like this one, the rms error of a torque exceeds these values: {text} (expected at most "
        f"{_TORQUE:g} N·m). {why}. Use the torques with their intervals",
        float(error[worst]),
        _TORQUE,
    )


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


def describe_unidentified(context: Context, inputs: PlanarTrial, obstacle: NotIdentifiable) -> tuple[Table, Tree]:
    """Return dynamics.parquet and dynamics.h5 of a trial without an identification.

    They contain the wrenches of plate and reference body, and the mass if it is known. Reference bodies are compared in
    the samples without contact with the chair.
    """
    recorded, movement, threshold = inputs.recorded, inputs.movement, read_cop_threshold(context)
    references = build_reference_bodies(context, recorded, movement)
    rows = planar_regressor(recorded.centres, recorded.q, recorded.dq, recorded.ddq, context.settings.gravity)
    reference = rows @ references.chosen.parameters - recorded.elsewhere
    measured = recorded.as_measured(recorded.wrench)
    absent = np.full(recorded.q.shape, np.nan)
    columns = make_dynamics_columns(
        recorded.time,
        WRENCH_COMPONENTS,
        {
            "{}": (measured, centre_of_pressure(recorded.wrench, threshold)),
            "{}_reference": (reference, centre_of_pressure(reference, threshold)),
        },
        torque=absent,
        torque_sd=absent,
        in_fit=np.zeros(len(absent), dtype=np.bool_),
    )
    base = structural_base(recorded.centres)
    value = np.full(len(base.kept), np.nan)
    value[0] = np.nan if obstacle.mass is None else obstacle.mass
    data = make_datasets(
        base_names(base, recorded.centres),
        value,
        name_parameters(len(recorded.centres) + 1),
        units=list_base_units(base),
        regrouping=base.regrouping,
        reference=references.chosen.parameters,
        grid=inputs.grid,
    )
    facts = {
        **NO_FACTS,
        "reference_table": references.chosen.table,
        "rivals": compare_references(references, rows, measured, movement.free, threshold, external=recorded.elsewhere),
        "why": obstacle.why,
    }
    implausible = judge_mass(context, obstacle.mass)
    reasons = [*movement.reasons, *references.chosen.reasons, Reason(obstacle.code, obstacle.why)]
    if implausible is not None:
        reasons.append(implausible)
    if obstacle.mass is not None and context.trial.protocol == "sit-to-stand" and context.trial.subject.mass is None:
        reasons.append(ON_TRUST)
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, tuple(reasons))
