"""Facts of wrench.parquet about the force plates, and reasons about their use, units, samples and recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import Refused
from mocap_id.plates import GRAVITY, PlateChoice, weigh_person
from mocap_id.plates.direction import ForceCourse
from mocap_id.recording import Plate, Recording, ThinnedFrames
from mocap_id.recording.marker_posture import find_upright
from mocap_id.stages.planarise.wrenches import ExternalWrenches
from mocap_id.stages.trial_keys import BalanceBoard
from mocap_id.verdict import Reason

_UNRELATED, FOLLOWS = 0.62, 0.7
"""Correlation of vertical force and acceleration below which the two do not belong together, or are doubtful. It is at
least 0.86 in good recordings, and at most 0.57 with the forces of another movement."""

_BELONGS_LATE = 0.85
"""Correlation from which the forces belong to the markers with a clock offset above 1 s."""

_MOVES_N = 15.0
"""Least variation of the vertical force, expected from the movement, for which the correlation is judged, N."""

_FEW = 0.05  # fraction of the frames; fewer frames without plate samples give a note, more give a caution


def describe_plates(
    source: Recording, thinned: ThinnedFrames, choice: PlateChoice, external: ExternalWrenches, threshold: float
) -> tuple[dict[str, Any], tuple[Reason, ...]]:
    """Return facts about the plates and the standing mass, and a reason if no plate can be used."""
    plates = source.plates
    feet = choice.indices("feet")
    mass: float | None = None
    spread: list[float] | None = None
    why: str | None = "the recording has no force plates"
    reasons: tuple[Reason, ...] = ()
    if feet:
        vertical = sum((thinned.samples[index].force[:, 2] for index in feet), np.zeros(len(thinned.time)))
        vertical = vertical + external.vertical
        mass, why = weigh_person(thinned.positions, thinned.rate, vertical)
        upright = vertical[find_upright(thinned.positions)[0] & np.isfinite(vertical)]
        if mass is not None:
            spread = (np.percentile(upright, [10, 90]) / GRAVITY).tolist()
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
        "mass_range_kg": spread,  # 10th and 90th percentile while upright: a load in the hands widens it
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


def judge_course(
    course: ForceCourse | None, markers: Sequence[Path], forces: Path | BalanceBoard | None
) -> tuple[Reason, ...]:
    """Return a caution if the vertical force hardly follows the body; raise Refused if it does not follow it at all."""
    if course is None or course.expected < _MOVES_N or course.correlation >= FOLLOWS:
        return ()
    if course.correlation_far >= _BELONGS_LATE:
        return ()  # the forces belong to the markers; the clock offset is estimated in identify-dim
    file = forces.balance_board if isinstance(forces, BalanceBoard) else forces
    of = f"{file.name} and {markers[0].name}" if file is not None else f"the forces and markers of {markers[0].name}"
    found = (
        "the vertical force does not follow the vertical acceleration of the body: their correlation is "
        f"{course.correlation:.2f} for clock offsets up to 1 s, and at most {course.correlation_far:.2f} for all "
        "others, expected above 0.9"
    )
    if course.correlation >= _UNRELATED:
        text = (
            f"{found}. Check that {of} belong to the same recording, the rates of both, and whether something other "
            "than the plates carries the person"
        )
        return (Reason("forces-unrelated", text, course.correlation, FOLLOWS),)
    raise Refused(
        "forces-unrelated",
        f"{of} do not belong together: {found}. Give the forces of this recording, check that both have the right "
        "rate, or leave the forces out to get the kinematics alone",
        course.correlation,
        _UNRELATED,
    )
