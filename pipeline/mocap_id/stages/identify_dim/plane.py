"""Stage identify-dim in the plane: identifies the dynamics, and describes and averages the repetitions.

:func:`identify_dim` is the whole stage, :func:`_identify` the method: the fit, the model's wrench and torques, and what
is said about them. The inputs come from :mod:`trial_inputs`, which also chooses the motion of the masses.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex
from mocap_id.design.proposal import describe_recommendations, recommend_if_doubtful
from mocap_id.dynamics.base_parameters import base_names, list_base_units, name_parameters, structural_base
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
from mocap_id.dynamics.fit import describe_clock
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.instrument_errors import correlate_errors
from mocap_id.dynamics.prediction import Prediction, centre_of_pressure, compare_wrenches, estimate_chain_noise, predict
from mocap_id.dynamics.preparation import PreparedTrial, measure_arcs
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS, planar_regressor
from mocap_id.errors import Refused
from mocap_id.kinematics.joint import count_positions
from mocap_id.protocols.body_names import name_directions
from mocap_id.protocols.movement import Movement, find_facing
from mocap_id.protocols.repetitions import SUPPORT_LIMIT
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings, validation
from mocap_id.stages.identify_dim.dynamics_artefacts import (
    NO_FACTS,
    describe_solver,
    make_base,
    make_columns,
    make_data,
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
    filter_measured,
    fit_segments,
    make_scale_facts,
    read_calibration,
)
from mocap_id.stages.identify_dim.trial_data import (
    MASS_CONTRADICTS,
    NotIdentifiable,
    ReferenceBodies,
    build_reference_bodies,
    compare_references,
    describe_comparison,
    explain_board,
    find_seat_segment,
    judge_mass,
    read_cop_threshold,
    read_joint_names,
    read_kinematic_error,
    read_skeleton,
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
_FEW = 3  # marker positions on a segment; clusters have at least as many
_FOOT_SD = 0.001  # m; from the variation of people's feet, which have 3 % of the body's mass
_TORQUE = 5.0  # N·m, largest rms error of a torque without a caution
_ONE_IN_100 = 2.576  # standard deviations that a normal error exceeds in one of 100 cases


def identify_dim(context: Context) -> Outputs:
    """Return events.parquet, dynamics.parquet, dynamics.h5 and phases.parquet of a trial in the plane."""
    _refuse_other_mass(context)
    inputs = read_inputs(context)
    recorded, movement, prepared = inputs.recorded, inputs.movement, inputs.prepared
    if inputs.obstacle is None:
        assert prepared is not None
        table, tree, prepared = _identify(context, inputs, prepared)
    else:
        table, tree = _explain_obstacle(context, inputs, inputs.obstacle)

    # samples without rejected markers, and those whose low-passed motion contains only such samples
    states, segments = context.table("states.parquet"), inputs.chain.segments
    rejected = states.facts.get("rejected", ())
    measured = find_measured(recorded.time, rejected, segments)
    reach = 0 if prepared is None else prepared.lowpass.reach_samples
    modelled = np.asarray(np.convolve(~measured, np.ones(2 * reach + 1), "same") < 0.5)

    # events: for sit-to-stand with the details of every rise
    if movement.posture is None:
        events = make_events(
            [each.leave_out(recorded.time, measured, ("start", "end")) for each in movement.repetitions]
        )
    else:
        late = float((tree.facts["clock"] or {}).get("applied_s") or 0.0)
        names = [f"sd_dtheta_{j + 1}" for j in range(recorded.q.shape[1])]
        events = make_sit_to_stand_events(
            read_wrench(context)[0],
            recorded,
            movement,
            compute_missing_force(prepared, table.columns),
            share=context.settings.seat_off_share,
            seat_measured=recorded.seat is not None,
            # the posture depends on the segments up to the hip
            measured=find_measured(recorded.time, rejected, segments[: recorded.knee + 3]),
            modelled=modelled,
            # the speed is a norm of joint velocities, so its standard deviation is at most the largest of theirs
            speed_sd=states.stack(names).max(axis=1) if set(names) <= set(states.names) else None,
            clock_offset=late if abs(late) > OFFSET_LARGE else 0.0,
        )
    table = _mark_contact(context, inputs, prepared, ~modelled, (events, table, tree))
    return events, table, tree, average_signals(context, events, table, *find_zeros(context, movement.posture))


def identify_trial(context: Context) -> tuple[PreparedTrial, Movement, Identification] | NotIdentifiable:
    """Return the prepared trial, its movement and its identification, or the reason why nothing can be identified.

    The results are for the pinned chain. With measured poses, its parameters are computed from those of the bodies.
    """
    inputs = read_inputs(context)
    if inputs.obstacle is not None:
        return inputs.obstacle
    assert inputs.prepared is not None
    references = build_reference_bodies(context, inputs.prepared.recorded, inputs.movement)
    found, segments = _fit(context, inputs, inputs.prepared, references)
    return inputs.prepared, inputs.movement, found if segments is None else segments.in_chain


def fit_chain(
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
    asked, ankle, few = settings.reference_pulls, read_skeleton(context).covariance[:1], _has_few_markers(context)
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
        foot_sd=float(np.hypot(_FOOT_SD, np.sqrt(ankle[0, 0, 0]))) if with_prior else None,
        plate_sd=prepared.recorded.position_sd or read_calibration(context).position if for_torques_only else None,
    )
    return combine_with_sensors(found, prepared, movement.free, grid, reference, consistency=consistency)


def _has_few_markers(context: Context) -> bool:
    """Return whether a moving segment of a person has markers at only one or two positions."""
    chain = read_skeleton(context)
    local = as_complex(chain.local)
    counts = [count_positions(local[chain.marker_segment == k]) for k in range(1, len(chain.centres) + 1)]
    return context.trial.protocol != "robot-joint" and min(counts) < _FEW


def _fit(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, references: ReferenceBodies
) -> tuple[Identification, SegmentFit | None]:
    """Return the identification of the pinned chain, and the fit of the measured bodies, None if the chain is used."""
    found = fit_chain(context, prepared, inputs.movement, inputs.grid, references)
    if inputs.bodies is None:
        return check_and_calibrate(context, prepared, inputs.movement, found, references.chosen.parameters), None
    return found, fit_segments(context, inputs.bodies, prepared, inputs.movement, pinned=found, tables=references)


def _identify(context: Context, inputs: TrialInputs, prepared: PreparedTrial) -> tuple[Table, Tree, PreparedTrial]:
    """Return dynamics.parquet, dynamics.h5 and the prepared trial with the motion that is used.

    ``prepared``, ``pinned`` and ``in_chain`` belong to the pinned chain; ``trial``, ``found`` and ``tables`` to the
    motion that is used: measured poses (``segments``) or the pinned chain.
    """
    movement, threshold, joints = inputs.movement, read_cop_threshold(context), read_joint_names(context)
    references = build_reference_bodies(context, prepared.recorded, movement)
    pinned, segments = _fit(context, inputs, prepared, references)

    # wrench and torques of the model, and predictions of repetitions by a model of the others
    motion = inputs.motion_facts
    if segments is None:
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
        validated = validation.validate(prepared, movement, found, model.wrench)
        prior_share = np.full(len(found.base), np.nan if found.uses_reference else 0.0)
    else:
        trial, found, in_chain = segments.prepared, segments.found, segments.in_chain
        tables, grid = segments.references, segments.grid
        model = predict(trial, found, segments.noise(), threshold)
        validated, prior_share = segments.validation, segments.prior_share
        motion = motion | segments.facts | {"joints": describe_gaps(segments.bodies, joints)}
    excited = measure_excitation(prepared, in_chain, choose_weak_share(context))
    recommendations = recommend_if_doubtful(prepared, in_chain, excited)

    # dynamics.parquet; clock offset and bias of Fx are removed from the measured wrench
    fit, left_out, position_sd = found.fit, validated.held_out, trial.recorded.position_sd
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
    if left_out is not None:
        series["{}_held_out"] = left_out.wrench, centre_of_pressure(left_out.wrench, threshold) - lower
    columns = make_columns(
        trial.recorded.time,
        WRENCH_COMPONENTS,
        series,
        torque=model.torque,
        torque_sd=model.torque_sd,
        in_fit=fit.in_fit,
    )
    if trial.recorded.external:
        columns |= {f"{name}_external": column for name, column in zip(WRENCH_COMPONENTS, elsewhere.T, strict=True)}

    # datasets of dynamics.h5
    centres = trial.recorded.centres
    held_out = None if left_out is None else (left_out.base, left_out.offset)
    bodies: tuple[FloatArray, FloatArray, FloatArray] | None = None
    if segments is not None:
        covariance = found.covariance if found.calibration is None else found.covariance - found.calibration.covariance
        bodies = found.full, tables.chosen.parameters, covariance
        if left_out is not None:
            full = np.array([segments.chain_map.apply(each) for each in left_out.base])
            held_out = full @ prepared.base.regrouping.T, left_out.offset
    base = make_base(
        base_names(prepared.base, centres),
        in_chain.base,
        np.sqrt(np.diag(in_chain.covariance)),
        in_chain.covariance,
        units=list_base_units(prepared.base),
        regrouping=prepared.base.regrouping,
        excitation=excited,
        prior_share=prior_share,
    )
    data = make_data(
        base,
        name_parameters(len(centres) + 1),
        in_chain.full,
        reference=references.chosen.parameters,
        bodies=bodies,
        grid=grid,
        masses=found.solution.masses,
        held_out=held_out,
    )

    # facts of dynamics.h5; with measured poses, filtered wrenches are compared
    rows, modelled, plates, others = trial.regressor, model.wrench, measured, elsewhere
    if segments is not None:
        rows, modelled, others = trial.filtered, trial.filtered @ found.base, 0.0 * elsewhere
        plates = filter_measured(trial, found)
    moved = trial.motion.joint
    # columns without values, except the torques of joints whose two sides are in one body
    inner = {f"tau_{j + 1}" for j in range(moved.shape[1]) if not np.isfinite(moved[:, j]).any()}
    undetermined = ", ".join(name for name in model.undetermined if name not in inner)
    contact = movement.contact
    facts = {
        **NO_FACTS,
        "condition_number": in_chain.fit.condition,
        "condition_number_scaled": in_chain.fit.condition_scaled,
        "clock_offset_s": fit.total_offset if fit.offset_known else None,
        "clock_offset_sd_s": found.offset_sd if fit.offset_known else None,
        "clock": describe_clock(trial, fit),
        **describe_comparison(compare_wrenches(modelled, plates, fit.in_fit, threshold)),
        "samples": int(fit.in_fit.sum()),
        "reference_table": tables.chosen.table,
        "rivals": compare_references(tables, rows, plates, fit.in_fit, threshold, external=others),
        "held_out": validation.make_facts(
            validated,
            modelled,
            rows @ tables.chosen.parameters - others,
            plates,
            threshold,
            filtered=segments is not None,
        ),
        "consistency": found.solution.consistency,
        "solver": describe_solver(found.solution, found.solution.requested),
        "reference_pulls": found.uses_reference,
        "cutoff_hz": trial.lowpass.cutoff,
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
        "external": make_gain_facts(prepared, found.fit),
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
        **make_scale_facts(found),
        "torque": compare_torque(context, columns),
    }
    if undetermined:
        facts["why"] = (
            f"the fitted components of the wrench do not determine {undetermined}: see `identify-dim: "
            "{components: …}`"
        )
    if inputs.board is not None:
        facts["board"] = inputs.board
    if segments is not None:
        facts["pins"] = compare_motions(prepared, pinned, movement, segments, threshold)

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
    stands = standing is not None and context.trial.protocol == "sit-to-stand"
    reasons = [*movement.reasons, *references.chosen.reasons]
    if found.with_foot is not None:
        reasons.append(_FOOT_IN_TORQUES)
    elif found.uses_reference and context.settings.reference_pulls is not True:
        reasons.append(_FOOT_PRIOR)
    reasons += [*cautions, *(() if implausible is None else (implausible,)), *contradictions]
    reasons += explain_scales(found, given, stands=stands)
    if undetermined:
        text = (
            f"the fitted components {', '.join(context.settings.components)} do not determine {undetermined}, which "
            "have no values; fit at least Fy and tauz (`identify-dim: {components: [Fy, tauz]}`)"
        )
        reasons.append(Reason("components-short", text))
    if context.trial.protocol == "free" and standing is None and given is None:
        why = context.table("wrench.parquet").facts.get("why") or "the plates do not measure it"
        text = (
            f"the identified mass could not be compared with the mass of the standing person ({why}) or with `subject: "
            "{mass: …}`: if a chair or a support carries part of the body, the parameters are wrong, and no other "
            "check detects this"
        )
        reasons.append(Reason("mass-unchecked", text))
    reasons += [
        *_check_torques(context, trial, found, model, movement.free),
        *validation.explain_validation(facts["held_out"]),
        *explain_motion(facts),
        *explain_board(context, facts),
    ]
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, tuple(reasons)), trial


def choose_weak_share(context: Context) -> float:
    """Return the relative standard deviation above which a parameter is weak; a robot has a smaller default."""
    given: float | None = context.settings.weak_share
    return given or (WEAK_ROBOT if context.trial.protocol == "robot-joint" else WEAK)


_FOOT_PRIOR = Reason(
    "foot-prior",
    "a segment has markers at only one or two positions. The foot's first moment is therefore taken from the reference "
    "body and the position of the ankle, not from the data alone; the torque of the ankle then follows from the centre "
    "of pressure. Set `identify-dim: {reference_pulls: false}` to use the data alone",
    level="ok",
)
_FOOT_IN_TORQUES = Reason(
    "foot-prior",
    "the torques also use the first moment of the reference body's foot, which the data hardly determine; parameters "
    "and wrench depend on the data alone. Set `identify-dim: {reference_pulls: false}` to use the data alone for both",
    level="ok",
)


def _check_torques(
    context: Context, trial: PreparedTrial, found: Identification, model: Prediction, free: BoolArray
) -> tuple[Reason, ...]:
    """Return a caution about torques of the pinned chain that may be wrong by more than 5 N·m rms.

    The errors of parameters and geometry are constant in a trial and normal over trials; errors of the motion add their
    mean square. The caution is for torques whose error exceeds 5 N·m in more than one of 100 trials. Errors of scale
    are left out, because they are the same in all trials of a laboratory. ``free`` (T,) marks the samples in which only
    the ground touches the body.
    """
    used = free & np.isfinite(model.torque_sd).any(axis=1)
    untested = bool(trial.recorded.external) and not _has_few_markers(context)
    if context.trial.protocol == "robot-joint" or untested or trial.prior is not None or not used.any():
        return ()
    constant, noise = (np.nanmean(sd[used] ** 2, axis=0) for sd in (model.torque_lasting_sd, model.torque_noise_sd))
    measured = trial.measured(found.fit.offset)
    off = np.asarray((measured - model.wrench)[:, WRENCH_COMPONENTS.index("tauz")])
    excess = max(float(np.nanmean(off[used] ** 2) - np.mean(off[found.fit.in_fit] ** 2)), 0.0)
    error = np.sqrt(_ONE_IN_100**2 * constant + noise + excess)
    large = np.flatnonzero(error > _TORQUE)
    if not len(large):
        return ()
    names = read_joint_names(context)
    text = ", ".join(f"{names[j]} {error[j]:.1f} N·m" for j in large)
    worst = large[np.argmax(error[large])]
    why = "The positions of the joints and the masses of the segments after them are uncertain"
    if excess > _ONE_IN_100**2 * constant[worst]:
        at = trial.recorded.time[used][np.nanargmax(np.abs(off[used]))]
        why = f"The model differs from the plate around {at:.1f} s: fill marker gaps there, or exclude it by `window:`"
    message = (
        f"in one of 100 trials like this one, the rms error of a torque exceeds these values: {text} (expected at most "
        f"{_TORQUE:g} N·m). {why}. Use the torques with their intervals"
    )
    return (Reason("torque-uncertain", message, float(error[worst]), _TORQUE),)


def _mark_contact(
    context: Context,
    inputs: TrialInputs,
    prepared: PreparedTrial | None,
    unmeasured: BoolArray,
    found: tuple[Table, Table, Tree],
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

    ``unmeasured`` (T,) marks samples with rejected markers; ``found`` are events.parquet, dynamics.parquet and
    dynamics.h5.
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
    on_chair = inputs.movement.carried
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


def _explain_obstacle(context: Context, inputs: TrialInputs, obstacle: NotIdentifiable) -> tuple[Table, Tree]:
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
    columns = make_columns(
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
    unknown = np.full((len(value), len(value)), np.nan)
    data = make_data(
        make_base(
            base_names(base, recorded.centres),
            value,
            unknown[0],
            unknown,
            units=list_base_units(base),
            regrouping=base.regrouping,
        ),
        name_parameters(len(recorded.centres) + 1),
        np.full(4 * (len(recorded.centres) + 1), np.nan),
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
