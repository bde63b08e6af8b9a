"""Reference bodies from allometric tables, for comparison with the identified body."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.allometry import TableName
from mocap_id.dynamics.comparison import Comparison, compare
from mocap_id.dynamics.preparation import TrialData
from mocap_id.protocols.body_names import GROUND
from mocap_id.protocols.movement import Movement, find_facing
from mocap_id.protocols.posture import measure_standing_angles
from mocap_id.protocols.reference_body import ReferenceBody, build_reference_body, make_empty_reference
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.trial_data import read_skeleton


@dataclass(frozen=True)
class ReferenceBodies:
    """Reference bodies with the chain of a trial."""

    chosen: ReferenceBody  # body from the table in the settings
    every: tuple[ReferenceBody, ...]  # bodies from all tables, in a fixed order; empty without a reference body


def build_reference_bodies(context: Context, recorded: TrialData, movement: Movement) -> ReferenceBodies:
    """Return the reference bodies of a sit-to-stand trial; for other protocols, there is no reference body."""
    settings, subject, chain = context.settings, context.trial.subject, recorded.centres
    if context.trial.protocol != "sit-to-stand":
        return ReferenceBodies(make_empty_reference(len(chain), None), ())
    if read_skeleton(context).segments[:1] == (GROUND,):
        return ReferenceBodies(
            make_empty_reference(len(chain), "the tables are for people whose feet are flat on the ground"), ()
        )
    if not np.isfinite(recorded.q).all(axis=1).any():
        return ReferenceBodies(make_empty_reference(len(chain), "no sample has all joint angles"), ())
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


def compare_references(
    bodies: ReferenceBodies,
    regressor: FloatArray,
    measured: FloatArray,
    samples: BoolArray,
    threshold: float,
    *,
    external: FloatArray,
) -> dict[str, Any] | None:
    """Return JSON about the reference bodies and the errors of their wrench, by table; None without reference bodies.

    Parameters
    ----------
    regressor : (T, 3, 4(n + 1)) array
        Regressor of the full parameters.
    measured : (T, 3) array
        Wrench of the ground, N and N·m.
    samples : (T,) bool array
        Samples to compare.
    threshold : float
        Largest vertical force without a centre of pressure, N.
    external : (T, 3) array
        Other external wrenches on the body, N and N·m.
    """
    if not bodies.every:
        return None
    found = {}
    for body in bodies.every:
        compared = compare(regressor @ body.parameters - external, measured, samples, threshold)
        found[str(body.table)] = {
            "height_m": body.height,
            "mass_kg": body.mass,
            "assumed": list(body.assumed),
            **describe_comparison(compared),
        }
    return found


def describe_comparison(compared: Comparison) -> dict[str, Any]:
    """Return JSON about a comparison of wrenches and centres of pressure."""
    wrench = {name: None if one is None else asdict(one) for name, one in compared.wrench.items()}
    return {"wrench": wrench, "cop_rms_m": compared.cop_rms}
