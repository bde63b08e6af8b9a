"""Inputs of the identification in the plane: prepared trial, movement, and motion of the masses (chain or poses)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.consistency import PointGrid, build_grid
from mocap_id.dynamics.fit import Fit, determines_parameters, fit
from mocap_id.dynamics.identification import score_left_out
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.preparation import (
    PreparedTrial,
    SampledWrench,
    TrialData,
    blank_incomplete,
    prepare,
    profile_offset,
)
from mocap_id.dynamics.priors import build_even_prior
from mocap_id.dynamics.regressor import SEAT, ExternalWrench
from mocap_id.dynamics.scale_check import WrenchGain, estimate_gains
from mocap_id.kinematics.cluster_poses import BENDS_M
from mocap_id.protocols.movement import Movement, find_movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.segment_fit import ASKED_FOR
from mocap_id.stages.identify_dim.trial_data import (
    NotIdentifiable,
    build_reference_bodies,
    check_excitation,
    check_wrench,
    locate_board,
    make_fit_settings,
    read_joint_names,
    read_skeleton,
    read_trial_data,
)
from mocap_id.stages.identify_dim.validation import (
    MeasuredBodies,
    RepetitionPredictor,
    estimate_hidden_gaps,
    find_measured_bodies,
    make_body_prior,
    pin_joints,
    pin_joints_that_hold,
    prepare_bodies,
)
from mocap_id.store.views import Skeleton
from mocap_id.verdict import Reason

_BENT = 1.4  # error of the chain's hip in one direction, relative to its shift by a bending trunk; half is corrected


@dataclass(frozen=True)
class TrialInputs:
    """Inputs of the identification of a trial in the plane."""

    chain: Skeleton  # chain of the trial
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


def read_inputs(context: Context) -> TrialInputs:
    """Return the data of a trial, the motion chosen for its masses, and the usable samples."""
    settings: IdentifyDimSettings = context.settings
    chain = read_skeleton(context)
    recorded = read_trial_data(context, chain)
    obstacle = check_wrench(context, recorded)
    prepared: PreparedTrial | None = None
    chair_reasons: tuple[Reason, ...] = ()
    if obstacle is None:
        prepared, chair_reasons = _check_chair(prepare(recorded, make_fit_settings(settings, recorded)))
        recorded = prepared.recorded
    grid = build_grid(chain.centres, chain.marker_segment, chain.local, settings.grid)
    movement = _find_movement(context, recorded, prepared, chair_reasons)
    board: dict[str, Any] | None = None
    if prepared is not None:
        obstacle = check_excitation(context, prepared, movement)
        if obstacle is None:
            prepared, board = locate_board(context, prepared, movement)
            recorded = prepared.recorded
    candidates, facts, centre_sd = _choose_motion(context, recorded)
    inputs = TrialInputs(chain, recorded, prepared, movement, grid, obstacle, None, facts, centre_sd, board)
    if prepared is None or obstacle is not None or not candidates:
        return inputs

    # the bodies that predict left-out repetitions best with the usual cut-offs
    standing: float | None = context.table("wrench.parquet").facts.get("mass_kg")
    mass = standing or float(np.nanmedian(recorded.surroundings[:, 1])) / float(settings.gravity)
    on_chain, table = prepared, build_reference_bodies(context, recorded, movement).chosen

    def predict_with(bodies: MeasuredBodies) -> RepetitionPredictor:
        prior = make_body_prior(bodies, recorded.q, movement, table, mass if table.mass is None else table.mass)
        return RepetitionPredictor(on_chain, movement, bodies, prior)

    bodies = candidates[0]
    if len(candidates) > 1:

        def cost(each: MeasuredBodies) -> float:
            return score_left_out(predict_with(pin_joints(each)).predict_on_poses(USUAL))

        bodies = min(reversed(candidates), key=cost)

    # pins of the joints that hold; if all hold, the chain is used
    if settings.motion == "segments":
        bodies = pin_joints(bodies)
    else:
        hip = chain.joints.index("hip") if "hip" in chain.joints else None
        bodies = pin_joints_that_hold(bodies, predict_with, hip)
    if settings.motion == "chain" or not bodies.loose:
        why = "the gap of a joint is above the noise, but left-out repetitions are not predicted better without its pin"
        why = ASKED_FOR if settings.motion else why
        joints = describe_gaps(bodies, chain.joint_names)
        return replace(inputs, motion_facts=facts | {"source": "chain", "why": why, "joints": joints})
    on_poses = prepare_bodies(bodies, recorded, prepared.settings, build_even_prior(mass, bodies.poses.centroid))
    on_bodies = _find_movement(context, recorded, on_poses, chair_reasons)
    if check_excitation(context, prepared, on_bodies) is not None:
        on_bodies = movement
    return replace(inputs, bodies=bodies, movement=on_bodies)


def _find_movement(
    context: Context, recorded: TrialData, prepared: PreparedTrial | None, chair_reasons: tuple[Reason, ...]
) -> Movement:
    """Return repetitions, contact and usable samples according to the trial's protocol."""
    settings: IdentifyDimSettings = context.settings
    movement = find_movement(
        context.trial.protocol,
        recorded,
        prepared,
        settings.contact,
        weight_share=settings.seat_off_share,
        knee_bend=settings.knee_bend_rad,
        stands=context.table("wrench.parquet").facts.get("mass_kg") is not None,
    )
    return replace(movement, reasons=(*chair_reasons, *movement.reasons))


def _choose_motion(
    context: Context, recorded: TrialData
) -> tuple[tuple[MeasuredBodies, ...], dict[str, Any], FloatArray]:
    """Return bodies with measured poses, facts about the choice, and the standard deviations ``centre_sd`` (n,), m.

    There are no bodies if the pinned chain is used.
    """
    requested, centre_sd = context.settings.motion, np.zeros(len(recorded.centres))
    if context.trial.protocol == "robot-joint" and requested != "segments":
        return (), {"source": "chain", "why": ASKED_FOR if requested else "the joint of a robot is pinned"}, centre_sd
    body_sets = find_measured_bodies(context, recorded)
    first = next(body_sets, None)
    if first is not None:
        # a gap that follows the angle of its joint, as far as skin does not explain it
        of_fit = np.nan_to_num(np.einsum("jkk->j", read_skeleton(context).covariance) / 2)
        shifts = np.zeros((len(centre_sd), 2)) if first.poses.shift is None else first.poses.shift
        for joint in first.gap:
            hidden = float(estimate_hidden_gaps(first.poses, [joint])[joint])
            bend = float(np.linalg.norm(shifts[joint]))
            moved = _BENT * bend if bend >= BENDS_M else 0.0  # the chain's hip is not corrected for a bending trunk
            centre_sd[joint] = np.hypot(np.sqrt(max(hidden - of_fit[joint], 0.0)), moved)
    gap = {} if first is None else describe_gaps(first, read_joint_names(context))
    if requested == "chain":
        sets = () if first is None or not first.loose else (first, *body_sets)
        return sets, {"source": "chain", "why": ASKED_FOR, "joints": gap}, centre_sd
    if first is None:
        why = "the pose of a segment cannot be measured: its markers are too few, or missing too often"
        return (), {"source": "chain", "why": why}, centre_sd
    if not first.loose:
        return (), {"source": "chain", "why": "the gaps of all joints are within the noise", "joints": gap}, centre_sd
    return (
        (first, *body_sets),
        {"source": "segments", "why": "the two sides of a joint separate", "joints": gap},
        centre_sd,
    )


def describe_gaps(bodies: MeasuredBodies, names: Sequence[str]) -> dict[str, Any]:
    """Return JSON about the gap of each joint between two bodies, by the name of the joint."""

    def replace_nan(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return {
        names[joint]: {
            "gap_m": replace_nan(gap.size),
            "acceleration_m_s2": replace_nan(gap.acceleration),
            "pinned": gap.pinned,
        }
        for joint, gap in bodies.gap.items()
    }


_SENSOR_RANGE = 1.0  # s, largest clock offset of a sensor that is tried, in both directions
_SENSOR_LEAST = 2.0  # s, shortest duration of the samples for this
_SENSOR_LATE, _SENSOR_BETTER = 0.02, 1.2  # smallest offset that is reported, s, and smallest ratio of the residuals


def _check_chair(prepared: PreparedTrial) -> tuple[PreparedTrial, tuple[Reason, ...]]:
    """Return the trial, without the chair's wrench if it contradicts the body's motion, and a note or caution.

    Without a plate under the chair, the trial is unchanged and the tuple is empty.
    """
    recorded = prepared.recorded
    if recorded.seat is None:
        return prepared, ()
    everything = np.ones(len(recorded.time), dtype=bool)
    determined = determines_parameters(prepared, everything)
    gains = estimate_gains(prepared, fit(prepared, everything)) if determined else ()
    wrong = [gain for gain in gains if gain.name == SEAT and gain.contradicts]
    if not wrong:
        text = (
            f"the chair is on its own force plate: its wrench on segment {recorded.seat.segment} is measured, so "
            "samples with contact are also used for the identification"
        )
        return prepared, (Reason("seat-measured", text, level="ok"),)
    without = replace(recorded, external=tuple(each for each in recorded.external if each.name != SEAT))
    gain = _find_worst(wrong)
    text = (
        f"the forces of ground and chair add up best with the chair's {gain.component} times {gain.value:.2f} ± "
        f"{gain.sd:.2f}, expected 1: its plate does not measure the wrench of the chair on the body (wrong sign, "
        "corners or units, another object on the plate, or a chair leg beside it). It was left out, with all samples "
        "with contact"
    )
    reason = Reason("seat-contradiction", text, value=gain.value, limit=1.0)
    return prepare(without, prepared.settings), (reason,)


def check_sensors(prepared: PreparedTrial, found: Fit) -> tuple[Reason, ...]:
    """Return a caution for every sensor whose wrench or clock contradicts the motion of the body."""
    wrong = [gain for gain in estimate_gains(prepared, found) if gain.name != SEAT and gain.contradicts]
    clocks = tuple(_check_clock(prepared, found, each) for each in prepared.recorded.external if not each.by_plates)
    return tuple(reason for reason in clocks if reason is not None) + tuple(
        Reason(
            "external-contradiction",
            f"the forces add up best with the {gain.component} of `{name}` times {gain.value:.2f} ± {gain.sd:.2f}, "
            "expected 1: check its sign (`force: on-sensor`), its axes, its point of application (`at:`), its segment "
            "and its clock (`clock_offset_s:`) under `external:`. It was used without a change",
            value=gain.value,
            limit=1.0,
        )
        for name in dict.fromkeys(gain.name for gain in wrong)
        for gain in [_find_worst([each for each in wrong if each.name == name])]
    )


def _check_clock(prepared: PreparedTrial, found: Fit, sensor: ExternalWrench) -> Reason | None:
    """Return a caution if the forces add up clearly better with another clock offset of a sensor."""
    components, time = list(prepared.settings.components), prepared.recorded.time
    filtered = prepared.lowpass(blank_incomplete(sensor.wrench))[:, components]
    sampled = SampledWrench.of(time, filtered)
    around = np.linspace(-_SENSOR_RANGE, _SENSOR_RANGE, 21)
    known = np.isfinite(sampled(time[found.samples] - around[:, None])).all(axis=(0, 2))
    samples = found.samples[known]
    if len(samples) * prepared.lowpass.step < _SENSOR_LEAST * prepared.recorded.rate:
        return None
    rest = prepared.filtered_measured(samples, time[samples] - found.offset)[:, components] - filtered[samples]
    rows = found.design[known, :, :-1]

    def measured(times: FloatArray) -> FloatArray:
        return (rest + sampled(times)) * found.weights

    every = np.ones(len(components))
    offset, at_end = profile_offset(rows, measured, time[samples], every, _SENSOR_RANGE, prior=found.prior)
    flat = rows.reshape(-1, rows.shape[-1])
    targets = np.stack([measured(time[samples] - each).reshape(-1) for each in (0.0, offset)], axis=1)
    left = np.linalg.norm(targets - flat @ np.linalg.lstsq(flat, targets, rcond=None)[0], axis=0)
    if at_end or abs(offset) <= _SENSOR_LATE or left[0] < _SENSOR_BETTER * left[1]:
        return None
    return Reason(
        "external-clock",
        f"the forces add up best if the clock of `{sensor.name}` is moved by {offset:+.2f} s, expected at most ± "
        f"{_SENSOR_LATE:g} s (residual {left[0] / left[1]:.1f} times as large without). It was not moved: add this "
        "time to its `clock_offset_s:` under `external:`, and check its start",
        value=offset,
        limit=_SENSOR_LATE,
    )


def make_gain_facts(prepared: PreparedTrial, found: Fit) -> list[dict[str, Any]]:
    """Return JSON about each external wrench: name, segment, and the fitted gain of each component (1 is correct)."""
    gains = estimate_gains(prepared, found)
    return [
        {
            "name": each.name,
            "segment": each.segment,
            "factors": {g.component: {"value": g.value, "sd": g.sd} for g in gains if g.name == each.name},
        }
        for each in prepared.recorded.external
    ]


def _find_worst(wrong: Sequence[WrenchGain]) -> WrenchGain:
    """Return the gain whose deviation from 1 has the largest effect relative to its limit."""
    return max(wrong, key=lambda gain: abs(gain.value - 1.0) * gain.size / gain.limit)
