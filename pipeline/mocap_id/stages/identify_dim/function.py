"""identify-dim: base parameters, clock offset, predicted wrench and torques; repetitions, their events and averages."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from mocap_id import recording
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.acceleration_noise import acceleration_correlation
from mocap_id.dynamics.excitation import WEAK, WEAK_ROBOT, excitation
from mocap_id.dynamics.grid import PointGrid, segment_grid
from mocap_id.dynamics.identify import Identification, identify
from mocap_id.dynamics.judge import judge
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.loose_prior import even_prior
from mocap_id.dynamics.measured_motion import GIVES_WAY, SURELY
from mocap_id.dynamics.predict import chain_noise, predict
from mocap_id.dynamics.prepare import FitSettings, Prepared, Recorded, prepare
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.errors import StoreError
from mocap_id.protocols.movement import Movement, read_movement
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings, surroundings, validation
from mocap_id.stages.identify_dim import dynamics_artefacts as artefacts
from mocap_id.stages.identify_dim.encoder_torque import torque_facts
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies, measured_bodies, with_prior
from mocap_id.stages.identify_dim.motion_reasons import motion_reasons
from mocap_id.stages.identify_dim.repetition_averages import averages
from mocap_id.stages.identify_dim.rivals import Rivals, rivals
from mocap_id.stages.identify_dim.segment_fit import (
    SegmentFit,
    fit_segments,
    pinned_facts,
    poses_predict_better,
)
from mocap_id.stages.identify_dim.sit_to_stand_events import missing_force, sit_to_stand_events
from mocap_id.stages.identify_dim.unknown import Unknown, not_excited, without_wrench
from mocap_id.store import Table, Tree
from mocap_id.store.schemas import DYNAMICS_TABLE, DYNAMICS_TREE
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class _Chain:
    """What the stage needs of chain.h5."""

    centres: FloatArray
    segment: IntArray
    local: FloatArray

    def correlation(self, q: FloatArray, snap: FloatArray) -> FloatArray:
        """Of the errors of the joint accelerations, (T, n, n)."""
        return acceleration_correlation(q, self.centres, self.segment, self.local, snap)

    @classmethod
    def of(cls, tree: Tree) -> _Chain:
        joints: Any = tree.data["joints"]
        markers: Any = tree.data["markers"]
        return cls(
            centres=np.asarray(joints["centre"], dtype=np.float64),
            segment=np.asarray(markers["segment"], dtype=np.int64),
            local=np.asarray(markers["local"], dtype=np.float64),
        )


@dataclass(frozen=True)
class _Read:
    """A trial read through its protocol; ``unknown`` says why nothing can be identified from it.

    ``bodies`` are those that move on their own measured poses, in every way to count them; empty where the pinned
    chain moves the masses.
    """

    chain: _Chain
    recorded: Recorded
    prepared: Prepared | None
    movement: Movement
    grid: PointGrid
    unknown: Unknown | None
    bodies: tuple[MeasuredBodies, ...]
    joints: dict[str, Any]


def identify_dim(context: Context) -> Outputs:
    """Identify the inertial parameters from the states and the plates' wrench."""
    read = _read(context)
    shown: Prepared | None = None
    if read.prepared is None or read.unknown is not None:
        assert read.unknown is not None
        table, tree = _nothing(context, read.recorded, read.grid, read.unknown, read.movement)
    else:
        table, tree, shown = _identified(context, read, read.prepared)
    events = _events(context, read.recorded, shown or read.prepared, read.movement, table.frame)
    return events, table, tree, averages(context, events.frame, table.frame)


def identification(context: Context) -> tuple[Prepared, Movement, Identification] | Unknown:
    """What stands behind the artefacts: the trial made ready, read through its protocol, and what was identified.

    On the pinned chain, and for a trial on measured poses with the base parameters that these gave.
    """
    read = _read(context)
    if read.prepared is None or read.unknown is not None:
        assert read.unknown is not None
        return read.unknown
    bodies = rivals(context, read.prepared.recorded, read.movement)
    found = _fit(context, read.prepared, read.movement, read.grid, bodies)
    if read.bodies:
        found = fit_segments(context, read.bodies, read.prepared, read.movement, pinned=found, tables=bodies).in_chain
    return read.prepared, read.movement, found


def _read(context: Context) -> _Read:
    settings: IdentifyDimSettings = context.settings
    chain = _Chain.of(context.tree("chain.h5"))
    recorded = _recorded(context, chain)
    unknown = without_wrench(context, recorded)
    prepared = None if unknown else prepare(recorded, _fit_settings(settings))
    recorded, prepared, of_seat = surroundings.settle(recorded, prepared)
    grid = segment_grid(chain.centres, chain.segment, chain.local, settings.grid)
    movement = _movement(context, recorded, prepared, of_seat)
    if prepared is not None:
        unknown = not_excited(context, prepared, movement)
    ways, joints = _measured(context, recorded)
    read = _Read(chain, recorded, prepared, movement, grid, unknown, ways, joints)
    if prepared is None or unknown is not None or not ways:
        return replace(read, bodies=())
    even = even_prior(_mass(context, recorded), ways[-1].poses.centroid)
    felt = with_prior(ways[-1], recorded, prepared.settings, even)
    freely = replace(read, movement=_movement(context, recorded, felt, of_seat))
    if not_excited(context, prepared, freely.movement) is not None:
        freely = read
    if ways[0].loosest > SURELY or settings.motion == "segments" or _poses_win(context, freely):
        return freely
    why = "a joint's gap is little above the noise, and the pinned chain predicts left-out repetitions better"
    return replace(read, bodies=(), joints=joints | {"source": "chain", "why": why})


def _movement(context: Context, recorded: Recorded, prepared: Prepared | None, of_seat: tuple[Reason, ...]) -> Movement:
    """The trial read through its protocol, by the forces that this motion needs."""
    settings: IdentifyDimSettings = context.settings
    movement = read_movement(
        context.trial.protocol,
        recorded,
        prepared,
        settings.contact,
        weight_share=settings.seat_off_share,
        knee_bend=settings.knee_bend_rad,
        stands=context.table("wrench.parquet").facts.get("mass_kg") is not None,
    )
    return replace(movement, reasons=(*of_seat, *movement.reasons))


def _poses_win(context: Context, read: _Read) -> bool:
    """Whether the bodies' own poses predict left-out repetitions better than the pinned chain."""
    assert read.prepared is not None
    tables = rivals(context, read.prepared.recorded, read.movement)
    found = _fit(context, read.prepared, read.movement, read.grid, tables)
    segments = fit_segments(context, read.bodies, read.prepared, read.movement, pinned=found, tables=tables)
    return poses_predict_better(read.prepared, found, read.movement, segments)


def _measured(context: Context, recorded: Recorded) -> tuple[tuple[MeasuredBodies, ...], dict[str, Any]]:
    """The bodies that move on their own poses, and the facts of that choice; none where the pinned chain is used."""
    wanted = context.settings.motion or ("chain" if context.trial.protocol == "robot-joint" else "segments")
    if wanted == "chain":
        return (), {"source": "chain", "why": "asked for" if context.settings.motion else "a robot's joint holds"}
    ways = measured_bodies(context, recorded)
    if not ways:
        return (), {"source": "chain", "why": "a segment has too few markers to show its own pose"}
    gap = {
        name: {"gap_m": gap.size, "acceleration_m_s2": gap.acceleration, "pinned": gap.pinned}
        for joint, name in enumerate(_joint_names(context))
        if (gap := ways[0].gap.get(joint)) is not None
    }
    if ways[0].loosest <= GIVES_WAY:
        return (), {"source": "chain", "why": "every joint's gap is at the noise", "joints": gap}
    return ways, {"source": "segments", "why": "a joint gives way", "joints": gap}


def _mass(context: Context, recorded: Recorded) -> float:
    """What the plates carry, kg: of the person standing where that is known."""
    standing: float | None = context.table("wrench.parquet").facts.get("mass_kg")
    return standing or float(np.nanmedian(recorded.surroundings[:, 1])) / float(context.settings.gravity)


def _events(
    context: Context, recorded: Recorded, prepared: Prepared | None, movement: Movement, frame: pd.DataFrame
) -> Table:
    """events.parquet, with what the protocol tells beside the events."""
    if movement.posture is None:
        return artefacts.events_table(movement.repetitions)
    return sit_to_stand_events(
        context.table("wrench.parquet"),
        recorded,
        movement,
        missing_force(prepared, frame),
        share=context.settings.seat_off_share,
        seat_measured=recorded.seat is not None,
    )


def _identified(context: Context, read: _Read, prepared: Prepared) -> tuple[Table, Tree, Prepared]:
    bodies, movement, threshold = (
        rivals(context, prepared.recorded, read.movement),
        read.movement,
        _cop_threshold(context),
    )
    found = _fit(context, prepared, movement, read.grid, bodies)
    if not read.bodies:
        result = _of_chain(context, read, prepared, found, bodies)
        more: dict[str, Any] = {}
    else:
        segments = fit_segments(context, read.bodies, prepared, movement, pinned=found, tables=bodies)
        result = _of_bodies(context, read, prepared, segments, threshold)
        more = segments.facts
    frame = artefacts.dynamics_frame(result)
    facts = artefacts.dynamics_facts(result, frame, _joint_names(context)) | {
        "external": surroundings.facts(prepared, found.fit),
        "torque": torque_facts(context, frame),
        "motion": read.joints | more,
    }
    if read.bodies:
        facts["pins"] = pinned_facts(prepared, found, movement, segments, threshold)
    judged = (*_judgement(context, result), *validation.reasons(facts["held_out"]), *motion_reasons(facts))
    reasons = (*movement.reasons, *bodies.chosen.reasons, *judged)
    return (
        Table(DYNAMICS_TABLE, frame),
        Tree(DYNAMICS_TREE, artefacts.dynamics_data(result), facts, reasons),
        result.prepared,
    )


def _of_chain(
    context: Context, read: _Read, prepared: Prepared, found: Identification, bodies: Rivals
) -> artefacts.Identified:
    q, threshold = prepared.recorded.q, _cop_threshold(context)
    noise = chain_noise(prepared, found, read.chain.correlation(q, _snap(context, q.shape[1])))
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
        prior_share=np.zeros(len(found.base)),
    )


def _of_bodies(
    context: Context, read: _Read, prepared: Prepared, segments: SegmentFit, threshold: float
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


def _fit(context: Context, prepared: Prepared, movement: Movement, grid: PointGrid, bodies: Rivals) -> Identification:
    settings: IdentifyDimSettings = context.settings
    return identify(
        prepared,
        movement.free,
        grid,
        bodies.chosen.parameters,
        _geometry_error(context),
        consistency=settings.consistency or "grid",
        reference_sd=settings.reference_sd,
        reference_pulls=settings.reference_pulls,
    )


def _joint_names(context: Context) -> list[str]:
    joints: Any = context.tree("chain.h5").data["joints"]
    numbers = [f"joint {j}" for j in range(1, len(joints["centre"]) + 1)]
    return [str(name) for name in joints.get("name", numbers)]


def _geometry_error(context: Context) -> KinematicError:
    """What skin has done to the chain and does to the angles, in the chain's own frames."""
    skin = skin_artefact.from_tree(context.tree("skin.h5"))
    centres, turned = skin.frames_turned()
    return KinematicError(lambda q: skin.errors(q)[0] + turned, centres)


def _judgement(context: Context, result: artefacts.Identified) -> tuple[Reason, ...]:
    """What to know before believing the numbers, what the fitted components leave open included."""
    facts = context.table("wrench.parquet").facts
    standing, given = facts.get("mass_kg"), context.trial.subject.mass
    reasons = judge(
        result.prepared, result.found, result.told, given=given, standing=standing, joints=_joint_names(context)
    )
    reasons += surroundings.doubts(result.chain, result.in_chain.fit)
    if result.model.untold:
        open_ = Reason(
            "components-short",
            f"fitted to {', '.join(context.settings.components)} alone, the base parameters do not tell "
            f"{', '.join(result.model.untold)}: no values are given for these; fit Fy and tauz at least "
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
    frame = artefacts.empty_frame(recorded, reference, threshold)
    data = artefacts.empty_data(recorded.centres, grid, unknown.mass, bodies.chosen.parameters)
    reasons = (*movement.reasons, *bodies.chosen.reasons, Reason(unknown.code, unknown.why))
    return Table(DYNAMICS_TABLE, frame), Tree(DYNAMICS_TREE, data, facts, reasons)


def _recorded(context: Context, chain: _Chain) -> Recorded:
    """States and wrench on their common times."""
    states, wrench = context.table("states.parquet").frame, context.table("wrench.parquet").frame
    time = states["time"].to_numpy(dtype=np.float64)
    stamped = wrench["time"].to_numpy(dtype=np.float64)
    if len(time) != len(stamped) or not np.allclose(time, stamped, atol=1e-6):
        raise StoreError(
            f"trial {context.trial.trial}, identify-dim: states.parquet has {len(time)} samples and wrench.parquet "
            f"{len(stamped)}, expected the same times; run the trial again from planarise"
        )
    joints = range(1, len(chain.centres) + 1)

    def columns(name: str) -> FloatArray:
        return np.column_stack([states[f"{name}_{j}"].to_numpy(dtype=np.float64) for j in joints])

    measured = wrench[list(WRENCH_COMPONENTS)].to_numpy(dtype=np.float64)
    sound = wrench["plate_ok"].to_numpy(dtype=np.bool_)
    recorded = Recorded(
        time=time,
        q=columns("theta"),
        dq=columns("dtheta"),
        ddq=columns("ddtheta"),
        ddq_sd=columns("sd_ddtheta"),
        observed=np.logical_and.reduce([states[f"observed_{j}"].to_numpy(dtype=np.bool_) for j in joints]),
        wrench=np.where(sound[:, None], measured, np.nan),
        centres=chain.centres,
        external=surroundings.external(context, context.settings.seat_plate, context.settings.seat_segment),
    )
    analog_rate = context.table("wrench.parquet").facts["analog_rate_hz"]
    return replace(recorded, averaged=recording.averaging_width(analog_rate, recorded.rate))


def _fit_settings(settings: IdentifyDimSettings) -> FitSettings:
    return FitSettings(
        components=tuple(WRENCH_COMPONENTS.index(name) for name in settings.components),
        cutoff=settings.cutoff_hz,
        offset_limit=settings.clock_offset_limit_s,
        apply_offset=settings.apply_clock_offset,
        plate_bias=settings.plate_bias,
        plate_zero=(settings.plate_zero_sd_n, settings.plate_zero_sd_nm),
        block=settings.block_s,
        gravity=settings.gravity,
    )
