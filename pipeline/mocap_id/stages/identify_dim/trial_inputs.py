"""Inputs of the identification: the prepared trial, its movement, and the motion of its masses (chain or poses)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.body_prior import build_even_prior
from mocap_id.dynamics.cutoffs import score_left_out
from mocap_id.dynamics.measured_motion import GIVES_WAY, SURELY, USUAL
from mocap_id.dynamics.point_grid import PointGrid, build_grid
from mocap_id.dynamics.preparation import PreparedTrial, TrialData, prepare
from mocap_id.protocols.movement import Movement, find_movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.board_position import settle_board
from mocap_id.stages.identify_dim.identifiability import NotIdentifiable, check_excitation, check_wrench
from mocap_id.stages.identify_dim.measured_bodies import (
    MeasuredBodies,
    make_body_prior,
    measured_bodies,
    pin,
    prepare_bodies,
)
from mocap_id.stages.identify_dim.model_selection import RepetitionPredictor, poses_preferred
from mocap_id.stages.identify_dim.motion_comparison import ASKED_FOR
from mocap_id.stages.identify_dim.reference_bodies import reference_bodies
from mocap_id.stages.identify_dim.trial_data import fit_settings, joint_names, read_skeleton, read_trial_data
from mocap_id.stages.identify_dim.wrench_checks import check_chair
from mocap_id.store.views import Skeleton
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class TrialInputs:
    """Everything that the identification of a trial needs.

    Parameters
    ----------
    chain : Skeleton
    recorded : TrialData
    prepared : PreparedTrial or None
        On the pinned chain; None without a usable wrench.
    movement : Movement
        Repetitions, contact and usable samples by the trial's protocol.
    grid : PointGrid
        Point masses of the chain's segments.
    obstacle : NotIdentifiable or None
        Why nothing can be identified.
    body_sets : tuple of MeasuredBodies
        Bodies with measured poses; an entry for each way to divide the person. Empty if the pinned chain is used.
    motion_facts : dict
        JSON facts about the choice between chain and poses.
    centre_sd : (n,) array
        Standard deviation of each joint centre from the gap of its joint, m.
    board : dict or None
        Fact ``board`` of dynamics.h5: where a balance board stands.
    """

    chain: Skeleton
    recorded: TrialData
    prepared: PreparedTrial | None
    movement: Movement
    grid: PointGrid
    obstacle: NotIdentifiable | None
    body_sets: tuple[MeasuredBodies, ...]
    motion_facts: dict[str, Any]
    centre_sd: FloatArray
    board: dict[str, Any] | None = None


def read_inputs(context: Context) -> TrialInputs:
    """Read a trial, choose the motion of its masses, and find the samples for the identification."""
    settings: IdentifyDimSettings = context.settings
    chain = read_skeleton(context)
    recorded = read_trial_data(context, chain)
    obstacle = check_wrench(context, recorded)
    prepared: PreparedTrial | None = None
    chair_reasons: tuple[Reason, ...] = ()
    if obstacle is None:
        prepared, chair_reasons = check_chair(prepare(recorded, fit_settings(settings, recorded)))
        recorded = prepared.recorded
    grid = build_grid(chain.centres, chain.marker_segment, chain.local, settings.grid)
    movement = _movement(context, recorded, prepared, chair_reasons)
    board: dict[str, Any] | None = None
    if prepared is not None:
        obstacle = check_excitation(context, prepared, movement)
        if obstacle is None:
            prepared, board = settle_board(context, prepared, movement)
            recorded = prepared.recorded
    body_sets, facts, centre_sd = _body_sets(context, recorded)
    inputs = TrialInputs(chain, recorded, prepared, movement, grid, obstacle, body_sets, facts, centre_sd, board)
    if prepared is None or obstacle is not None or not body_sets:
        return replace(inputs, body_sets=())
    bodies = _best_bodies(context, inputs, prepared)
    surely = body_sets[0].loosest > SURELY or settings.motion == "segments"
    if not (surely or poses_preferred(_predictor(context, inputs, prepared, bodies))):
        why = (
            "a joint's gap is little above the noise, and the pinned chain predicts left-out repetitions clearly better"
        )
        return replace(inputs, body_sets=(), motion_facts=facts | {"source": "chain", "why": why})
    even = build_even_prior(_mass(context, recorded), bodies.poses.centroid)
    on_poses = prepare_bodies(bodies, recorded, prepared.settings, even)
    movement = _movement(context, recorded, on_poses, chair_reasons)
    if check_excitation(context, prepared, movement) is not None:
        return inputs
    return replace(inputs, movement=movement)


def _movement(
    context: Context, recorded: TrialData, prepared: PreparedTrial | None, chair_reasons: tuple[Reason, ...]
) -> Movement:
    """Return the movement by the trial's protocol, with the forces that the prepared motion requires."""
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


def _best_bodies(context: Context, inputs: TrialInputs, prepared: PreparedTrial) -> MeasuredBodies:
    """Return the bodies that predict left-out repetitions best with the usual cut-offs."""
    if len(inputs.body_sets) == 1:
        return inputs.body_sets[0]

    def cost(bodies: MeasuredBodies) -> float:
        return score_left_out(_predictor(context, inputs, prepared, bodies).on_poses(USUAL))

    return min(reversed(inputs.body_sets), key=cost)


def _predictor(
    context: Context, inputs: TrialInputs, prepared: PreparedTrial, bodies: MeasuredBodies
) -> RepetitionPredictor:
    table = reference_bodies(context, prepared.recorded, inputs.movement).chosen
    mass = _mass(context, prepared.recorded) if table.mass is None else table.mass
    prior = make_body_prior(bodies, prepared.recorded.q, inputs.movement, table, mass)
    return RepetitionPredictor(prepared, inputs.movement, bodies, prior)


def _body_sets(context: Context, recorded: TrialData) -> tuple[tuple[MeasuredBodies, ...], dict[str, Any], FloatArray]:
    """Return the bodies with measured poses, the facts of this choice, and the standard deviation of the centres (n,).

    There are no bodies if the pinned chain is used.
    """
    requested, centre_sd = context.settings.motion, np.zeros(len(recorded.centres))
    if context.trial.protocol == "robot-joint" and requested != "segments":
        return (), {"source": "chain", "why": ASKED_FOR if requested else "a robot's joint holds"}, centre_sd
    body_sets = measured_bodies(context, recorded)
    first = next(body_sets, None)
    if first is not None:
        for joint, each in first.gap.items():
            centre_sd[joint] = 0.0 if each.pinned else np.sqrt(each.excess)
    gap = {} if first is None else gap_facts(first, joint_names(context))
    if requested == "chain":
        return (), {"source": "chain", "why": ASKED_FOR, "joints": gap}, centre_sd
    if first is None:
        why = "the markers of a segment do not show its own pose: they are too few, or visible too seldom"
        return (), {"source": "chain", "why": why}, centre_sd
    if first.loosest <= GIVES_WAY:
        return (), {"source": "chain", "why": "every joint's gap is at the noise", "joints": gap}, centre_sd
    return (
        tuple(pin(each) for each in (first, *body_sets)),
        {"source": "segments", "why": "a joint gives way", "joints": gap},
        centre_sd,
    )


def gap_facts(bodies: MeasuredBodies, names: Sequence[str]) -> dict[str, Any]:
    """Return JSON of the gaps by the names of the joints between two bodies."""
    return {
        names[joint]: {"gap_m": _known(gap.size), "acceleration_m_s2": _known(gap.acceleration), "pinned": gap.pinned}
        for joint, gap in bodies.gap.items()
    }


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _mass(context: Context, recorded: TrialData) -> float:
    """Return the mass of the standing person or, if unknown, the median vertical force as a mass, kg."""
    standing: float | None = context.table("wrench.parquet").facts.get("mass_kg")
    return standing or float(np.nanmedian(recorded.surroundings[:, 1])) / float(context.settings.gravity)
