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
from mocap_id.dynamics.predict import predict
from mocap_id.dynamics.prepare import FitSettings, Prepared, Recorded, prepare
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.errors import StoreError
from mocap_id.protocols.movement import Movement, read_movement
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings, surroundings, validation
from mocap_id.stages.identify_dim import dynamics_artefacts as artefacts
from mocap_id.stages.identify_dim.encoder_torque import torque_facts
from mocap_id.stages.identify_dim.repetition_averages import averages
from mocap_id.stages.identify_dim.rivals import Rivals, rivals
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
    """A trial read through its protocol; ``unknown`` says why nothing can be identified from it."""

    chain: _Chain
    recorded: Recorded
    prepared: Prepared | None
    movement: Movement
    grid: PointGrid
    unknown: Unknown | None


def identify_dim(context: Context) -> Outputs:
    """Identify the inertial parameters from the states and the plates' wrench."""
    read = _read(context)
    if read.prepared is None or read.unknown is not None:
        assert read.unknown is not None
        table, tree = _nothing(context, read.recorded, read.grid, read.unknown, read.movement)
    else:
        table, tree = _identified(context, read.chain, read.prepared, read.movement, read.grid)
    events = _events(context, read.recorded, read.prepared, read.movement, table.frame)
    return events, table, tree, averages(context, events.frame, table.frame)


def identification(context: Context) -> tuple[Prepared, Movement, Identification] | Unknown:
    """What stands behind the artefacts: the trial made ready, read through its protocol, and what was identified."""
    read = _read(context)
    if read.prepared is None or read.unknown is not None:
        assert read.unknown is not None
        return read.unknown
    bodies = rivals(context, read.prepared.recorded, read.movement)
    return read.prepared, read.movement, _fit(context, read.prepared, read.movement, read.grid, bodies)


def _read(context: Context) -> _Read:
    settings: IdentifyDimSettings = context.settings
    chain = _Chain.of(context.tree("chain.h5"))
    recorded = _recorded(context, chain)
    unknown = without_wrench(context, recorded)
    prepared = None if unknown else prepare(recorded, _fit_settings(settings))
    recorded, prepared, of_seat = surroundings.settle(recorded, prepared)
    movement = read_movement(
        context.trial.protocol,
        recorded,
        prepared,
        settings.contact,
        weight_share=settings.seat_off_share,
        knee_bend=settings.knee_bend_rad,
        stands=context.table("wrench.parquet").facts.get("mass_kg") is not None,
    )
    movement = replace(movement, reasons=(*of_seat, *movement.reasons))
    grid = segment_grid(chain.centres, chain.segment, chain.local, settings.grid)
    if prepared is not None:
        unknown = not_excited(context, prepared, movement)
    return _Read(chain, recorded, prepared, movement, grid, unknown)


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


def _identified(
    context: Context, chain: _Chain, prepared: Prepared, movement: Movement, grid: PointGrid
) -> tuple[Table, Tree]:
    bodies = rivals(context, prepared.recorded, movement)
    q, threshold = prepared.recorded.q, _cop_threshold(context)
    found = _fit(context, prepared, movement, grid, bodies)
    model = predict(prepared, found, chain.correlation(q, _snap(context, q.shape[1])), threshold)
    result = artefacts.Identified(
        prepared=prepared,
        found=found,
        told=excitation(prepared, found, weak_share(context)),
        model=model,
        grid=grid,
        rivals=bodies,
        contact=movement.contact,
        validation=validation.validate(prepared, movement, found, model.wrench),
        cop_threshold=threshold,
    )
    frame = artefacts.dynamics_frame(result)
    facts = artefacts.dynamics_facts(result, frame, _joint_names(context)) | {
        "external": surroundings.facts(prepared, found.fit),
        "torque": torque_facts(context, frame),
    }
    judged = (*_judgement(context, result), *validation.reasons(facts["held_out"]))
    reasons = (*movement.reasons, *bodies.chosen.reasons, *judged)
    return Table(DYNAMICS_TABLE, frame), Tree(DYNAMICS_TREE, artefacts.dynamics_data(result), facts, reasons)


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
        consistency=settings.consistency,
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
    reasons += surroundings.doubts(result.prepared, result.found.fit)
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
