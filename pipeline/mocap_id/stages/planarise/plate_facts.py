"""Facts and reasons about the force plates that are used, in the plane and in space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_id.plates import PlateChoice, standing_mass
from mocap_id.recording import Recording, ThinnedFrames
from mocap_id.stages.planarise.external_wrenches import ExternalWrenches
from mocap_id.verdict import Reason


def wrench_facts(
    source: Recording, thinned: ThinnedFrames, choice: PlateChoice, external: ExternalWrenches, threshold: float
) -> tuple[dict[str, Any], tuple[Reason, ...]]:
    """Return the facts of wrench.parquet (use of the plates, standing mass) and a reason if no plate is usable."""
    plates = source.plates
    feet = choice.indices("feet")
    mass: float | None = None
    why: str | None = "the recording has no force plates"
    reasons: tuple[Reason, ...] = ()
    if feet:
        vertical = sum((thinned.samples[index].force[:, 2] for index in feet), np.zeros(len(thinned.time)))
        mass, why = standing_mass(thinned.positions, thinned.rate, vertical + external.vertical)
    else:
        if plates:
            found = "; ".join(f"plate {plate.index}: {text}" for plate, text in zip(plates, choice.why, strict=True))
            why = f"none of the force plates is under the feet ({found})"
        advice = " If there is a MOT file, name it: `recording: {markers: …, forces: …}`."
        message = f"{why}: only the kinematics can be identified."
        reasons = (Reason("no-plate", message + (advice if source.format == "TRC" and not plates else "")),)
    facts = {
        "plates": choice.facts(plates),
        "external": list(external.facts),
        "mass_kg": mass,
        "why": why,
        "analog_rate_hz": source.analog_rate,
        "cop_threshold_N": threshold,
    }
    return facts, reasons


def unit_doubts(assumptions: Sequence[str]) -> tuple[Reason, ...]:
    """Return a caution for each assumed unit of the feet's plates; all forces and masses depend on it."""
    return tuple(
        Reason(
            "plate-unit-assumed",
            f"{assumption}; if the unit is another, give `planarise: {{force_unit: …, moment_unit: …}}`.",
        )
        for assumption in assumptions
    )
