"""A trial read through its protocol: states and wrench, the motion that moves the masses, the samples to fit on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.acceleration_noise import acceleration_correlation
from mocap_id.dynamics.bands import held_out_cost
from mocap_id.dynamics.grid import PointGrid, segment_grid
from mocap_id.dynamics.identify import Identification, identify
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.loose_prior import even_prior
from mocap_id.dynamics.measured_motion import GIVES_WAY, SURELY, USUAL
from mocap_id.dynamics.prepare import FitSettings, Prepared, Recorded, prepare
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.errors import StoreError
from mocap_id.protocols.movement import Movement, read_movement
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings, surroundings, validation
from mocap_id.stages.identify_dim.left_out import LeftOut, poses_preferred
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies, loose_prior, measured_bodies, with_prior
from mocap_id.stages.identify_dim.rivals import Rivals, rivals
from mocap_id.stages.identify_dim.unknown import Unknown, not_excited, without_wrench
from mocap_id.store import Tree
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class ChainGeometry:
    """What the stage needs of chain.h5."""

    centres: FloatArray
    segment: IntArray
    local: FloatArray

    def correlation(self, q: FloatArray, snap: FloatArray) -> FloatArray:
        """Of the errors of the joint accelerations, (T, n, n)."""
        return acceleration_correlation(q, self.centres, self.segment, self.local, snap)

    @classmethod
    def of(cls, tree: Tree) -> ChainGeometry:
        joints: Any = tree.data["joints"]
        markers: Any = tree.data["markers"]
        return cls(
            centres=np.asarray(joints["centre"], dtype=np.float64),
            segment=np.asarray(markers["segment"], dtype=np.int64),
            local=np.asarray(markers["local"], dtype=np.float64),
        )


@dataclass(frozen=True)
class Reading:
    """A trial read through its protocol; ``unknown`` says why nothing can be identified from it.

    ``bodies`` move on their own measured poses; there is one entry for each way to count them, and none where the
    pinned chain moves the masses. ``centre_sd`` (n,) is what the gaps of joints that may give way leave open of the
    chain's joint centres, m.
    """

    chain: ChainGeometry
    recorded: Recorded
    prepared: Prepared | None
    movement: Movement
    grid: PointGrid
    unknown: Unknown | None
    bodies: tuple[MeasuredBodies, ...]
    joints: dict[str, Any]
    centre_sd: FloatArray


def read_trial(context: Context) -> Reading:
    """Read a trial, choose the motion that moves its masses, and find the samples to identify on."""
    settings: IdentifyDimSettings = context.settings
    chain = ChainGeometry.of(context.tree("chain.h5"))
    recorded = _recorded(context, chain)
    unknown = without_wrench(context, recorded)
    prepared = None if unknown else prepare(recorded, _fit_settings(settings))
    recorded, prepared, of_seat = surroundings.settle(recorded, prepared)
    grid = segment_grid(chain.centres, chain.segment, chain.local, settings.grid)
    movement = _movement(context, recorded, prepared, of_seat)
    if prepared is not None:
        unknown = not_excited(context, prepared, movement)
    ways, joints, centre_sd = _measured(context, recorded)
    read = Reading(chain, recorded, prepared, movement, grid, unknown, ways, joints, centre_sd)
    if prepared is None or unknown is not None or not ways:
        return replace(read, bodies=())
    way, surely = _best_way(context, read, prepared), ways[0].loosest > SURELY or settings.motion == "segments"
    if not (surely or poses_preferred(_left_out(context, read, prepared, way))):
        why = (
            "a joint's gap is little above the noise, and the pinned chain predicts left-out repetitions clearly better"
        )
        return replace(read, bodies=(), joints=joints | {"source": "chain", "why": why})
    even = even_prior(_mass(context, recorded), way.poses.centroid)
    felt = with_prior(way, recorded, prepared.settings, even)
    freely = replace(read, movement=_movement(context, recorded, felt, of_seat))
    return read if not_excited(context, prepared, freely.movement) is not None else freely


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


def _best_way(context: Context, read: Reading, prepared: Prepared) -> MeasuredBodies:
    """The way to count the bodies that predicts left-out repetitions best with the usual cut-offs."""
    if len(read.bodies) == 1:
        return read.bodies[0]

    def cost(way: MeasuredBodies) -> float:
        return held_out_cost(_left_out(context, read, prepared, way).on_poses(USUAL))

    return min(reversed(read.bodies), key=cost)


def _left_out(context: Context, read: Reading, prepared: Prepared, bodies: MeasuredBodies) -> LeftOut:
    """Left-out repetitions of the trial with some bodies."""
    table = rivals(context, prepared.recorded, read.movement).chosen
    mass = _mass(context, prepared.recorded) if table.mass is None else table.mass
    prior = loose_prior(bodies, prepared.recorded.q, read.movement.free, table, mass)
    prior = replace(prior, spans=np.array(validation.spans(read.movement)))
    return LeftOut(prepared, read.movement, bodies, prior)


def _measured(context: Context, recorded: Recorded) -> tuple[tuple[MeasuredBodies, ...], dict[str, Any], FloatArray]:
    """The bodies that move on their own poses, the facts of that choice, and what gaps leave open of the centres (n,).

    There are no bodies where the pinned chain is used.
    """
    asked, centre_sd = context.settings.motion, np.zeros(len(recorded.centres))
    if context.trial.protocol == "robot-joint" and asked != "segments":
        return (), {"source": "chain", "why": "asked for" if asked else "a robot's joint holds"}, centre_sd
    ways = measured_bodies(context, recorded)
    for joint, each in ways[0].gap.items() if ways else ():
        centre_sd[joint] = 0.0 if each.pinned else np.sqrt(each.centre_variance)
    if asked == "chain":
        return (), {"source": "chain", "why": "asked for"}, centre_sd
    if not ways:
        why = "a segment shows its own pose too seldom: too few of its markers are seen"
        return (), {"source": "chain", "why": why}, centre_sd
    gap = gap_facts(ways[0], joint_names(context))
    if ways[0].loosest <= GIVES_WAY:
        return (), {"source": "chain", "why": "every joint's gap is at the noise", "joints": gap}, centre_sd
    return ways, {"source": "segments", "why": "a joint gives way", "joints": gap}, centre_sd


def gap_facts(bodies: MeasuredBodies, names: Sequence[str]) -> dict[str, Any]:
    """JSON of the gaps: by the names of the joints between two bodies."""
    return {
        names[joint]: {"gap_m": _known(gap.size), "acceleration_m_s2": _known(gap.acceleration), "pinned": gap.pinned}
        for joint, gap in bodies.gap.items()
    }


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _mass(context: Context, recorded: Recorded) -> float:
    """What the plates carry, kg: of the person standing where that is known."""
    standing: float | None = context.table("wrench.parquet").facts.get("mass_kg")
    return standing or float(np.nanmedian(recorded.surroundings[:, 1])) / float(context.settings.gravity)


def fit_chain(
    context: Context, prepared: Prepared, movement: Movement, grid: PointGrid, bodies: Rivals
) -> Identification:
    """Identify the pinned chain."""
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


def joint_names(context: Context) -> list[str]:
    """Names of the chain's joints; numbers where it has none."""
    joints: Any = context.tree("chain.h5").data["joints"]
    numbers = [f"joint {j}" for j in range(1, len(joints["centre"]) + 1)]
    return [str(name) for name in joints.get("name", numbers)]


def _geometry_error(context: Context) -> KinematicError:
    """What skin has done to the chain and does to the angles, in the chain's own frames."""
    skin = skin_artefact.from_tree(context.tree("skin.h5"))
    centres, turned = skin.frames_turned()
    return KinematicError(lambda q: skin.errors(q)[0] + turned, centres)


def _recorded(context: Context, chain: ChainGeometry) -> Recorded:
    """States and wrench on their common times."""
    states, wrench = context.table("states.parquet"), context.table("wrench.parquet")
    time, stamped = states["time"], wrench["time"]
    if len(time) != len(stamped) or not np.allclose(time, stamped, atol=1e-6):
        raise StoreError(
            f"trial {context.trial.trial}, identify-dim: states.parquet has {len(time)} samples and wrench.parquet "
            f"{len(stamped)}, expected the same times; run the trial again from planarise"
        )
    joints = range(1, len(chain.centres) + 1)

    def columns(name: str) -> FloatArray:
        return states.stack([f"{name}_{j}" for j in joints])

    recorded = Recorded(
        time=time,
        q=columns("theta"),
        dq=columns("dtheta"),
        ddq=columns("ddtheta"),
        ddq_sd=columns("sd_ddtheta"),
        observed=np.logical_and.reduce([states[f"observed_{j}"] for j in joints]),
        wrench=np.where(wrench["plate_ok"][:, None], wrench.stack(WRENCH_COMPONENTS), np.nan),
        centres=chain.centres,
        external=surroundings.external(context, context.settings.seat_plate, context.settings.seat_segment),
    )
    return replace(recorded, averaged=recording.averaging_width(wrench.facts["analog_rate_hz"], recorded.rate))


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
