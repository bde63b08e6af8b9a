"""Whether the plates are where the recording says they are, as planarise reports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.plates.direction import Turned, turned
from mocap_id.plates.registration import Registration, register, standing_lean
from mocap_id.recording import Plate, PlateSamples
from mocap_id.verdict import Reason

_MARGIN_M = 0.05
"""From the outermost markers of a foot to its border, shoe and skin included; good recordings need up to 27 mm."""

_LEAN = np.radians(2.0)
"""Of the force under somebody who stands still; good recordings show up to 0.7°, the bias of an ordinary plate."""

_INCLINED = np.radians(1.5)
"""Of a plate's normal by its corners; corners that were measured with a marker are within 0.25°."""

_TURNED, _TURNED_ALONE = np.radians(30.0), np.radians(90.0)
"""About the vertical: of all plates together, and of one foot's, which pushes to the side too."""

_COHERENT, _FORCE_N = 0.7, 5.0
"""The direction of a force that follows the movement less, or is smaller, tells nothing."""

_SUNK_M, _HOVERING_M = 0.008, 0.12
"""The lowest marker of a foot is not below the surface, and no farther above it than an ankle."""


@dataclass(frozen=True)
class Checked:
    """Facts for wrench.parquet, and doubts about the plates' places."""

    facts: dict[str, Any]
    reasons: tuple[Reason, ...]


def check(
    plates: Sequence[Plate], samples: Sequence[PlateSamples], positions: FloatArray, rate: float, *, person: bool
) -> Checked:
    """Hold the feet's plates against the markers.

    Parameters
    ----------
    plates, samples : sequences
        Those under the feet, and their wrench at the times of the positions.
    positions : (F, M, 3) array
        Lab axes with Z up, m.
    rate : float
        Hz.
    person : bool
        A robot has no feet and no stance.
    """
    if not plates:
        return Checked({}, ())
    total = np.sum([each.force for each in samples], axis=0)
    found = register(plates, samples, positions) if person else []
    lean = standing_lean(total, positions, rate) if person else None
    whole = turned(total, positions, rate)
    alone = [turned(each.force, positions, rate) for each in samples] if len(plates) > 1 else []
    facts = {
        "plates": [_fact(each) for each in found],
        "standing_lean_deg": None if lean is None else np.degrees(lean).tolist(),
        "turned": _direction(whole),
    }
    reasons = [reason for each in found for reason in (_misplaced(each), _height(each))]
    reasons += [_tilted(found, lean), *_turned(plates, whole, alone)]
    return Checked(facts, tuple(reason for reason in reasons if reason is not None))


def _fact(found: Registration) -> dict[str, Any]:
    return {
        "index": found.index,
        "cop_off_feet_m": found.off_feet,
        "cop_off_feet_limit_m": None if found.off_feet is None else _MARGIN_M + found.allowance,
        "feet_over_surface_m": found.over_surface,
        "inclined_deg": None if found.inclined is None else float(np.degrees(found.inclined)),
    }


def _direction(found: Turned | None) -> dict[str, float] | None:
    if found is None:
        return None
    return {"angle_deg": float(np.degrees(found.angle)), "coherence": found.coherence, "rms": found.size}


def _misplaced(found: Registration) -> Reason | None:
    limit = _MARGIN_M + found.allowance
    if found.off_feet is None or found.off_feet <= limit:
        return None
    return Reason(
        "plate-misplaced",
        f"the centre of pressure of plate {found.index} lies up to {100 * found.off_feet:.0f} cm outside the markers "
        f"of the feet that stand on it, expected at most {100 * limit:.0f} cm: the ground cannot push there. The "
        "plate's corners (or its ORIGIN, moments or points of application) do not fit the cameras' axes; measure them "
        "anew and correct the file. Until then tauz, the centre of pressure and all parameters are off",
        value=found.off_feet,
        limit=limit,
    )


def _height(found: Registration) -> Reason | None:
    over = found.over_surface
    if over is None or -_SUNK_M <= over <= _HOVERING_M:
        return None
    sunk = over < 0
    return Reason(
        "plate-height",
        f"the lowest marker of the feet is {abs(100 * over):.1f} cm {'below' if sunk else 'above'} the surface of "
        f"plate {found.index}, expected {'above it' if sunk else f'at most {100 * _HOVERING_M:.0f} cm'}: the corners' "
        "heights do not fit the cameras' floor; measure them anew. The moment is off by this height times Fx",
        value=over,
        limit=-_SUNK_M if sunk else _HOVERING_M,
    )


def _tilted(found: Sequence[Registration], lean: FloatArray | None) -> Reason | None:
    """A plate whose corners incline it, or under which a standing person would have to fall over."""
    inclined = max((each.inclined for each in found if each.inclined is not None), default=0.0)
    corners = f"the corners incline a plate by {np.degrees(inclined):.1f}°, expected under {np.degrees(_INCLINED):.1f}°"
    if inclined > _INCLINED and (lean is None or _explains(found, lean)):
        shown = (
            ", and nobody stands still to show whether it is"
            if lean is None
            else f", and the force under the standing person leans with them, by {np.degrees(np.hypot(*lean)):.1f}°: "
            "they are wrong"
        )
        text = f"{corners}{shown}. Measure them anew; a part of the weight may count as Fx, and all parameters be off"
        return Reason("plate-tilted", text, value=float(np.degrees(inclined)), limit=float(np.degrees(_INCLINED)))
    if lean is not None and np.hypot(*lean) > _LEAN:
        leaning = float(np.degrees(np.hypot(*lean)))
        text = (
            f"the force under the standing person leans by {leaning:.1f}° from the vertical, expected under "
            f"{np.degrees(_LEAN):.1f}°: a plate is tilted, its channels leak, or it was not zeroed. Level and zero it; "
            "a part of the weight counts as Fx, and all parameters are off"
        )
        return Reason("plate-tilted", text, value=leaning, limit=float(np.degrees(_LEAN)))
    if inclined <= _INCLINED:
        return None
    text = f"{corners}; the force under the standing person is vertical, so that it is taken for an inclined plate"
    value, limit = float(np.degrees(inclined)), float(np.degrees(_INCLINED))
    return Reason("plate-tilted", text, value=value, limit=limit, level="ok")


def _explains(found: Sequence[Registration], lean: FloatArray) -> bool:
    """Whether the force leans as it would if level plates had these corners: by their normals, weighed by the loads."""
    total = sum(each.load for each in found)
    expected = sum((each.normal[:2] * each.load for each in found if each.normal is not None), np.zeros(2)) / total
    return bool(lean @ expected > 0.5 * (expected @ expected))


def _turned(plates: Sequence[Plate], whole: Turned | None, alone: Sequence[Turned | None]) -> list[Reason]:
    """Plates whose horizontal forces point away from the accelerations; one of several where their sum looks right."""
    if whole is not None and _points_away(whole, _TURNED):
        return [_turned_reason("the plates" if len(plates) > 1 else f"plate {plates[0].index}", whole, _TURNED)]
    return [
        _turned_reason(f"plate {plate.index}", each, _TURNED_ALONE)
        for plate, each in zip(plates, alone, strict=False)
        if each is not None and _points_away(each, _TURNED_ALONE)
    ]


def _points_away(found: Turned, limit: float) -> bool:
    return found.coherence >= _COHERENT and found.size >= _FORCE_N and abs(found.angle) > limit


def _turned_reason(name: str, found: Turned, limit: float) -> Reason:
    angle = float(np.degrees(found.angle))
    return Reason(
        "plate-turned",
        f"the horizontal force of {name} points {angle:.0f}° away from where the body is accelerated (about the "
        f"vertical), expected within ± {np.degrees(limit):.0f}°: the corners are in another order, the plate's axes "
        "are turned, or Fx and Fy have the wrong sign. Correct the file; Fx, tauz and all parameters are wrong",
        value=abs(angle),
        limit=float(np.degrees(limit)),
    )
