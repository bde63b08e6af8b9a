"""Facts of wrench.parquet about the force plates, and reasons about their use, units and missing samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.plates import PlateChoice, weigh_person
from mocap_id.recording import Plate, Recording, ThinnedFrames
from mocap_id.stages.planarise.wrenches import ExternalWrenches
from mocap_id.verdict import Reason

_FEW = 0.05  # fraction of the frames; fewer frames without plate samples give a note, more give a caution


def describe_plates(
    source: Recording, thinned: ThinnedFrames, choice: PlateChoice, external: ExternalWrenches, threshold: float
) -> tuple[dict[str, Any], tuple[Reason, ...]]:
    """Return facts about the plates and the standing mass, and a reason if no plate can be used."""
    plates = source.plates
    feet = choice.indices("feet")
    mass: float | None = None
    why: str | None = "the recording has no force plates"
    reasons: tuple[Reason, ...] = ()
    if feet:
        vertical = sum((thinned.samples[index].force[:, 2] for index in feet), np.zeros(len(thinned.time)))
        mass, why = weigh_person(thinned.positions, thinned.rate, vertical + external.vertical)
    else:
        if plates:
            causes = "; ".join(f"plate {plate.index}: {text}" for plate, text in zip(plates, choice.why, strict=True))
            why = f"none of the force plates is under the feet ({causes})"
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


def doubt_units(assumptions: Sequence[str]) -> tuple[Reason, ...]:
    """Return a caution for each assumed unit of the feet's plates, because all forces and masses depend on it."""
    return tuple(
        Reason(
            "plate-unit-assumed",
            f"{assumption}; if the unit is different, set `planarise: {{force_unit: …, moment_unit: …}}`.",
        )
        for assumption in assumptions
    )


def describe_losses(
    plates: Sequence[Plate], time: FloatArray, dropout: BoolArray, corrected: float
) -> tuple[Reason, ...]:
    """Return reasons for samples of the feet's plates that cannot be used in an identification.

    ``time`` (F,) are the marker times, s; ``dropout`` (F,) marks the frames from :func:`mocap_id.plates.find_dropouts`;
    ``corrected`` is the clock offset by which the times of the plates were corrected, s.
    """
    reasons = [
        reason
        for plate in plates
        for reason in (_describe_saturation(plate, time), _describe_short_plate(plate, time, corrected))
    ]
    return tuple(reason for reason in (*reasons, _describe_dropout(time, dropout)) if reason is not None)


def _describe_saturation(plate: Plate, time: FloatArray) -> Reason | None:
    if plate.saturated is None:
        return None
    stamped = plate.start + np.arange(len(plate.ok)) / plate.rate
    share = float(plate.saturated[(stamped >= time[0]) & (stamped <= time[-1])].mean())
    if share == 0.0:
        return None
    return Reason(
        "plate-saturated",
        f"plate {plate.index} is at the end of its range in {100 * share:.1f} % of its samples, expected none: they "
        "are left out, and with them the largest forces of the movement. Choose a larger range of its amplifier",
        value=share,
        limit=0.0,
    )


def _describe_short_plate(plate: Plate, time: FloatArray, corrected: float) -> Reason | None:
    """Return a reason if frames are before the plate's first sample or after its last by more than one interval."""
    slack = 1.0 / plate.rate + float(np.median(np.diff(time)))
    end = plate.start + (len(plate.ok) - 1) / plate.rate
    share = float(np.mean((time < plate.start - slack) | (time > end + slack)))
    if share == 0.0:
        return None
    clocks = f" (on the cameras' clock: {corrected:+.2f} s)" if corrected else ""
    return Reason(
        "plate-short",
        f"the forces of plate {plate.index} run from {plate.start:.2f} to {end:.2f} s{clocks} and the markers from "
        f"{time[0]:.2f} to {time[-1]:.2f} s: {100 * share:.0f} % of the frames have no force and are not used "
        "for the identification. Export both completely, and check that they belong to the same trial",
        value=share,
        limit=_FEW,
        level="caution" if share > _FEW else "ok",
    )


def _describe_dropout(time: FloatArray, dropout: BoolArray) -> Reason | None:
    if not dropout.any():
        return None
    first = time[np.argmax(dropout)]
    return Reason(
        "plate-dropout",
        f"the plates show no load in {100 * dropout.mean():.0f} % of the frames, from {first:.2f} s on, while the "
        "person stands on them; possible causes are a loose cable, a reset of the amplifier, or a step off the plates. "
        "These frames are left out; check the plates' signal there, or set a `window:` without them",
        value=float(dropout.mean()),
        limit=0.0,
    )
