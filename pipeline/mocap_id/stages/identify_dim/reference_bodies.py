"""Allometric reference bodies for comparison with the identified one."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.allometry import TableName
from mocap_id.dynamics.comparison import compare
from mocap_id.dynamics.preparation import TrialData
from mocap_id.protocols.body_names import GROUND
from mocap_id.protocols.movement import Movement, find_facing
from mocap_id.protocols.posture import measure_standing_angles
from mocap_id.protocols.reference_body import ReferenceBody, build_reference_body, make_empty_reference
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.trial_data import read_skeleton


@dataclass(frozen=True)
class ReferenceBodies:
    """Reference bodies on the chain of a trial.

    Parameters
    ----------
    chosen : ReferenceBody
        Body by the table of the settings.
    every : tuple of ReferenceBody
        One body for each table, in a fixed order; empty if none applies.
    """

    chosen: ReferenceBody
    every: tuple[ReferenceBody, ...]


def reference_bodies(context: Context, recorded: TrialData, movement: Movement) -> ReferenceBodies:
    """Return the bodies by all tables for a sit-to-stand; other protocols have none."""
    settings, subject, chain = context.settings, context.trial.subject, recorded.centres
    if context.trial.protocol != "sit-to-stand":
        return ReferenceBodies(make_empty_reference(len(chain), None), ())
    if read_skeleton(context).segments[:1] == (GROUND,):
        return ReferenceBodies(
            make_empty_reference(len(chain), "the tables describe people whose foot stands flat"), ()
        )
    if not np.isfinite(recorded.q).all(axis=1).any():
        return ReferenceBodies(make_empty_reference(len(chain), "the joint angles are never known together"), ())
    mass = context.table("wrench.parquet").facts.get("mass_kg")
    if mass is None and movement.contact is not None and np.isfinite(movement.contact.weight):
        mass = movement.contact.weight / settings.gravity
    bodies = {
        name: build_reference_body(
            name,
            chain,
            find_facing(recorded),
            height=subject.height,
            mass=subject.mass,
            sex=subject.sex,
            plate_mass=mass,
            standing=None if movement.posture is None else measure_standing_angles(recorded.q, movement.posture),
        )
        for name in get_args(TableName)
    }
    chosen = bodies[settings.reference]
    return ReferenceBodies(chosen, () if chosen.table is None else tuple(bodies.values()))


def reference_facts(
    bodies: ReferenceBodies,
    regressor: FloatArray,
    measured: FloatArray,
    samples: BoolArray,
    threshold: float,
    *,
    external: FloatArray,
) -> dict[str, Any] | None:
    """Return facts about the reference bodies and the errors of their wrench and centre of pressure.

    Parameters
    ----------
    bodies : ReferenceBodies
    regressor : (T, 3, 4(n + 1)) array
        Full regressor, unfiltered.
    measured : (T, 3) array
        Wrench of the ground, N and N·m.
    samples : (T,) bool array
        Samples off the seat, the same as for the identified model.
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    external : (T, 3) array
        Other external wrenches on the body.
    """
    if not bodies.every:
        return None
    found = {}
    for body in bodies.every:
        compared = compare(regressor @ body.parameters - external, measured, samples, threshold)
        wrench = {name: None if one is None else asdict(one) for name, one in compared.wrench.items()}
        found[str(body.table)] = {
            "height_m": body.height,
            "mass_kg": body.mass,
            "assumed": list(body.assumed),
            "wrench": wrench,
            "cop_rms_m": compared.cop_rms,
        }
    return found
