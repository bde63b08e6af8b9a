"""identify-dim: base parameters, clock offset, predicted wrench and torques; repetitions, their events and averages."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.excitation import WEAK, WEAK_ROBOT, excitation
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.judge import judge
from mocap_id.dynamics.predict import chain_noise, predict
from mocap_id.dynamics.prepare import Prepared, Recorded
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import dynamics_artefacts as artefacts
from mocap_id.stages.identify_dim import surroundings, validation
from mocap_id.stages.identify_dim.encoder_torque import torque_facts
from mocap_id.stages.identify_dim.motion_reasons import motion_reasons
from mocap_id.stages.identify_dim.pins import pinned_facts
from mocap_id.stages.identify_dim.reading import Reading, fit_chain, gap_facts, joint_names, read_trial
from mocap_id.stages.identify_dim.repetition_averages import averages
from mocap_id.stages.identify_dim.rivals import Rivals, rivals
from mocap_id.stages.identify_dim.segment_fit import SegmentFit, fit_segments
from mocap_id.stages.identify_dim.sit_to_stand_events import events_table, missing_force, sit_to_stand_events
from mocap_id.stages.identify_dim.unknown import Unknown
from mocap_id.store import Table, Tree
from mocap_id.store.schemas import DYNAMICS_TABLE, DYNAMICS_TREE
from mocap_id.verdict import Reason


def identify_dim(context: Context) -> Outputs:
    """Identify the inertial parameters from the states and the plates' wrench."""
    read = read_trial(context)
    shown: Prepared | None = None
    if read.prepared is None or read.unknown is not None:
        assert read.unknown is not None
        table, tree = _nothing(context, read.recorded, read.grid, read.unknown, read.movement)
    else:
        table, tree, shown = _identified(context, read, read.prepared)
    events = _events(context, read.recorded, shown or read.prepared, read.movement, table)
    return events, table, tree, averages(context, events, table)


def identification(context: Context) -> tuple[Prepared, Movement, Identification] | Unknown:
    """The trial made ready, its movement and its identification, from which the artefacts are made.

    On the pinned chain, and for a trial on measured poses with the base parameters that these gave.
    """
    read = read_trial(context)
    if read.prepared is None or read.unknown is not None:
        assert read.unknown is not None
        return read.unknown
    bodies = rivals(context, read.prepared.recorded, read.movement)
    found = fit_chain(context, read.prepared, read.movement, read.grid, bodies)
    if read.bodies:
        found = fit_segments(context, read.bodies, read.prepared, read.movement, pinned=found, tables=bodies).in_chain
    return read.prepared, read.movement, found


def _events(
    context: Context, recorded: Recorded, prepared: Prepared | None, movement: Movement, dynamics: Table
) -> Table:
    """events.parquet, with what the protocol tells beside the events."""
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


def _identified(context: Context, read: Reading, prepared: Prepared) -> tuple[Table, Tree, Prepared]:
    bodies, movement, threshold = (
        rivals(context, prepared.recorded, read.movement),
        read.movement,
        _cop_threshold(context),
    )
    found = fit_chain(context, prepared, movement, read.grid, bodies)
    if not read.bodies:
        result = _of_chain(context, read, prepared, found, bodies)
        more: dict[str, Any] = {}
    else:
        segments = fit_segments(context, read.bodies, prepared, movement, pinned=found, tables=bodies)
        result = _of_bodies(context, read, prepared, segments, threshold)
        more = segments.facts | {"joints": gap_facts(segments.bodies, joint_names(context))}
    columns = artefacts.dynamics_columns(result)
    facts = artefacts.dynamics_facts(result, joint_names(context)) | {
        "external": surroundings.facts(prepared, found.fit),
        "torque": torque_facts(context, columns),
        "motion": read.joints | more,
    }
    if read.bodies:
        facts["pins"] = pinned_facts(prepared, found, movement, segments, threshold)
    judged = (*_judgement(context, result), *validation.reasons(facts["held_out"]), *motion_reasons(facts))
    reasons = (*movement.reasons, *bodies.chosen.reasons, *judged)
    return (
        Table(DYNAMICS_TABLE, columns),
        Tree(DYNAMICS_TREE, artefacts.dynamics_data(result), facts, reasons),
        result.prepared,
    )


def _of_chain(
    context: Context, read: Reading, prepared: Prepared, found: Identification, bodies: Rivals
) -> artefacts.Identified:
    q, threshold = prepared.recorded.q, _cop_threshold(context)
    noise = chain_noise(prepared, found, read.chain.correlation(q, _snap(context, q.shape[1])), read.centre_sd)
    model = predict(prepared, found, noise, threshold)
    return artefacts.Identified(
        prepared=prepared,
        found=found,
        chain=prepared,
        in_chain=found,
        told=excitation(prepared, found, weak_share(context)),
        model=model,
        grid=read.grid,
        rivals=bodies,
        chain_reference=bodies.chosen.parameters,
        contact=read.movement.contact,
        validation=validation.validate(prepared, read.movement, found, model.wrench),
        cop_threshold=threshold,
        prior_share=np.full(len(found.base), np.nan if found.pulled else 0.0),
    )


def _of_bodies(
    context: Context, read: Reading, prepared: Prepared, segments: SegmentFit, threshold: float
) -> artefacts.Identified:
    model = predict(segments.prepared, segments.found, segments.noise(), threshold)
    return artefacts.Identified(
        prepared=segments.prepared,
        found=segments.found,
        chain=prepared,
        in_chain=segments.in_chain,
        told=excitation(prepared, segments.in_chain, weak_share(context)),
        model=model,
        grid=segments.grid,
        rivals=segments.rivals,
        chain_reference=segments.chain_reference,
        contact=read.movement.contact,
        validation=segments.validation,
        cop_threshold=threshold,
        prior_share=segments.prior_share,
        folded=segments.folded,
    )


def weak_share(context: Context) -> float:
    """Standard deviation by size above which a parameter is weak: a robot's are wanted to per cents."""
    given: float | None = context.settings.weak_share
    return given or (WEAK_ROBOT if context.trial.protocol == "robot-joint" else WEAK)


def _judgement(context: Context, result: artefacts.Identified) -> tuple[Reason, ...]:
    """What to know before believing the numbers, what the fitted components leave open included."""
    facts = context.table("wrench.parquet").facts
    standing, given = facts.get("mass_kg"), context.trial.subject.mass
    reasons = judge(
        result.prepared, result.found, result.told, given=given, standing=standing, joints=joint_names(context)
    )
    reasons += surroundings.doubts(result.chain, result.in_chain.fit)
    if short := artefacts.components_short(result):
        open_ = Reason(
            "components-short",
            f"fitted to {', '.join(context.settings.components)} alone, the base parameters do not tell "
            f"{', '.join(short)}: no values are given for these; fit Fy and tauz at least "
            "(`identify-dim: {components: [Fy, tauz]}`)",
        )
        reasons = (*reasons, open_)
    if context.trial.protocol == "free" and standing is None and given is None:
        unchecked = Reason(
            "mass-unchecked",
            "the identified mass could not be held against that of the person standing "
            f"({facts.get('why') or 'the plates do not show it'}) nor against `subject: {{mass: …}}`: if a chair or a "
            "support carries a part of the body, the parameters are wrong and nothing shows it",
        )
        reasons = (*reasons, unchecked)
    return reasons


def _cop_threshold(context: Context) -> float:
    """Vertical force up to which there is no centre of pressure, N: the one that planarise went by."""
    return float(context.table("wrench.parquet").facts["cop_threshold_N"])


def _snap(context: Context, joints: int) -> FloatArray:
    """Standard deviation of each joint's process noise (n,), rad/s⁴."""
    return np.broadcast_to(np.asarray(context.table("states.parquet").facts["sigma_v"], dtype=np.float64), (joints,))


def _nothing(
    context: Context, recorded: Recorded, grid: PointGrid, unknown: Unknown, movement: Movement
) -> tuple[Table, Tree]:
    """The artefacts of a trial whose parameters stay unknown."""
    bodies, threshold = rivals(context, recorded, movement), _cop_threshold(context)
    reference, facts = artefacts.unknown_facts(
        unknown.why,
        recorded,
        bodies,
        movement.free,
        cop_threshold=threshold,
        gravity=context.settings.gravity,
    )
    columns = artefacts.empty_columns(recorded, reference, threshold)
    data = artefacts.empty_data(recorded.centres, grid, unknown.mass, bodies.chosen.parameters)
    reasons = (*movement.reasons, *bodies.chosen.reasons, Reason(unknown.code, unknown.why))
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, reasons)
