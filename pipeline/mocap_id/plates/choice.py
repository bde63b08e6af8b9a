"""Which plates carry the feet, which the chair, which nothing; and the mass that they show."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import ConfigError
from mocap_id.recording.decimation import PlateSamples
from mocap_id.recording.lab_plates import LOADED_N
from mocap_id.recording.model import Plate
from mocap_id.recording.posture import body_height, shows_standing, upright

Use: TypeAlias = Literal["feet", "seat", "unloaded", "ignored"]

GRAVITY = 9.81

_OFFSET_SHARE = 0.05
"""A plate that reads less than this share of the most loaded one's force carries nothing."""

_STEADY = 0.05
"""Of the load that a plate loses when the body stands up: a chair's own weight sways by less, feet by more."""

_STILL_M_S = 0.02
"""Vertical speed of the body of somebody who stands nearly still."""

_SPEED_OVER_S = 0.1
"""The speed is a difference over this time to either side, so that marker noise does not count as motion."""

_ENOUGH_S = 0.2

_LEAST_KG = 2.0

_CONFIGURED = "by the configuration"


@dataclass(frozen=True)
class PlateChoice:
    """What every plate is used for.

    Parameters
    ----------
    uses : tuple of {"feet", "seat", "unloaded", "ignored"}
        One a plate, in their order; ``ignored`` plates cannot be used or were left out by the configuration.
    loads : tuple of float
        Mean upward force of each, N, over the chosen frames; NaN where it cannot be used.
    why : tuple of str
        One sentence a plate.
    """

    uses: tuple[Use, ...]
    loads: tuple[float, ...]
    why: tuple[str, ...]

    def indexes(self, use: Use) -> tuple[int, ...]:
        """Positions (from 0) of the plates of this use."""
        return tuple(i for i, each in enumerate(self.uses) if each == use)

    def facts(self, plates: Sequence[Plate]) -> list[dict[str, Any]]:
        """JSON rows: index, kind, use, mean_vertical_N, why."""
        return [
            {
                "index": plate.index,
                "kind": plate.kind,
                "use": use,
                "mean_vertical_N": None if not np.isfinite(load) else load,
                "why": why,
            }
            for plate, use, load, why in zip(plates, self.uses, self.loads, self.why, strict=True)
        ]


def choose_plates(
    plates: Sequence[Plate],
    samples: Sequence[PlateSamples],
    positions: FloatArray,
    *,
    feet: Collection[int] = (),
    seat: Collection[int] = (),
) -> PlateChoice:
    """Tell the feet's plates from a chair's and from unloaded ones.

    A plate whose load stays under 20 N, or under a twentieth of the most loaded one's, is unloaded: such a reading is
    an offset. A chair's plate is loaded while the body is low and loses most of its load when it stands, or all but a
    steady rest, the chair's weight; a load that survives standing is the feet's, and where none does, there is no
    chair. The configuration overrules this.

    Parameters
    ----------
    plates : sequence of Plate
    samples : sequence of PlateSamples
        Every plate at the marker times.
    positions : (F, M, 3) array
        The markers at these times, lab axes with Z up, m; NaN where unseen.
    feet, seat : collection of int
        Plate numbers (from 1) of the configuration; where either is given, plates named in neither are left out.

    Raises
    ------
    ConfigError
        The configuration names a plate that is not there, or one plate twice.
    """
    _check_names(plates, feet, seat)
    tall, low = upright(positions)
    loads = tuple(_mean(each.force[:, 2], each.ok) for each in samples)
    threshold = max([LOADED_N, *(_OFFSET_SHARE * _peak(each) for each in samples)])
    chosen: list[tuple[Use, str]] = []
    for plate, each in zip(plates, samples, strict=True):
        if not plate.usable or not each.ok.any():
            chosen.append(("ignored", plate.problem or "no good sample in these frames"))
        elif _peak(each) >= threshold and _dead(each):
            chosen.append(
                (
                    "ignored",
                    f"it reads the same {each.force[each.ok, 2][0]:.0f} N throughout: not connected, or saturated",
                )
            )
        elif plate.index in feet and _peak(each) < LOADED_N:
            chosen.append(("unloaded", f"named as the feet's, but its load stays under {LOADED_N:.0f} N"))
        elif feet or seat:
            use: Use = "feet" if plate.index in feet else "seat" if plate.index in seat else "ignored"
            chosen.append((use, _CONFIGURED))
        else:
            chosen.append(_told_apart(each, tall, low, threshold))
    if not any(use == "feet" for use, _ in chosen) and not (feet or seat):
        # nobody stands on a chair's plate alone: this is a jump, or a walk past
        chosen = [("feet", "it is loaded") if use == "seat" else (use, why) for use, why in chosen]
    return PlateChoice(tuple(use for use, _ in chosen), loads, tuple(why for _, why in chosen))


def doubtful(samples: Sequence[PlateSamples], choice: PlateChoice, positions: FloatArray) -> dict[int, str]:
    """Plates whose load contradicts what the configuration says of them, by their position (from 0), and how.

    Parameters
    ----------
    samples, choice, positions
        As of :func:`choose_plates`.
    """
    tall, low = upright(positions)
    if not low.any():
        return {}
    threshold = max([LOADED_N, *(_OFFSET_SHARE * _peak(each) for each in samples)])
    found: dict[int, str] = {}
    for index in (index for index, why in enumerate(choice.why) if why == _CONFIGURED):
        each = samples[index]
        told, why = _told_apart(each, tall, low, threshold)
        standing, loaded = _mean(each.force[:, 2], each.ok & tall), _loaded(each, tall)
        if choice.uses[index] == "seat" and told == "feet" and standing > loaded / 2:
            found[index] = f"carries {standing:.0f} N while the person stands and up to {loaded:.0f} N before"
        elif choice.uses[index] == "feet" and told == "seat":
            found[index] = f"carries {why}"
    return found


def standing_mass(positions: FloatArray, rate: float, vertical: FloatArray) -> tuple[float | None, str | None]:
    """Mass from the feet's force while the person stands still or nearly.

    Without a rise the load alone cannot tell standing from sitting: the posture must show it
    (:func:`mocap_id.recording.posture.shows_standing`).

    Parameters
    ----------
    positions : (F, M, 3) array
        m, lab axes.
    rate : float
        Hz.
    vertical : (F,) array
        Upward force of the feet's plates, N; NaN where unknown.

    Returns
    -------
    mass : float or None
        kg.
    why : str or None
        Why there is none.
    """
    tall, _ = upright(positions)
    half = min(max(1, round(_SPEED_OVER_S * rate)), (len(positions) - 1) // 2)
    height = body_height(positions)
    speed, stop = np.full(len(positions), np.nan), len(positions) - half
    speed[half:stop] = (height[2 * half :] - height[: stop - half]) * rate / max(2 * half, 1)
    with np.errstate(invalid="ignore"):
        still = tall & (np.abs(speed) < _STILL_M_S) & np.isfinite(vertical)
    if still.sum() < max(2, _ENOUGH_S * rate):
        return None, "the person never stands still on the plates"
    if not shows_standing(positions, still):
        return None, (
            "nothing shows that the person stands where the body is highest and still: its markers are as broad as "
            "those of somebody seated, or lie in one line, and a chair may carry part of the weight"
        )
    mass = float(np.median(vertical[still])) / GRAVITY
    return (mass, None) if mass > _LEAST_KG else (None, "the plates carry no weight while the person stands")


def _dead(samples: PlateSamples) -> bool:
    """Whether the load never changes, not even by noise, as that of no plate does that somebody stands on."""
    vertical = samples.force[samples.ok, 2]
    return bool(np.ptp(vertical) <= 1e-6 * np.max(np.abs(vertical)))


def _check_names(plates: Sequence[Plate], feet: Collection[int], seat: Collection[int]) -> None:
    known = [plate.index for plate in plates]
    for name, group in (("feet", feet), ("seat", seat)):
        missing = sorted(set(group) - set(known))
        if missing:
            raise ConfigError(f"plates: {name}: {missing} - the recording has the plates {known}")
    both = sorted(set(feet) & set(seat))
    if both:
        raise ConfigError(f"plates: {both} named as feet and as seat")


def _told_apart(samples: PlateSamples, tall: BoolArray, low: BoolArray, threshold: float) -> tuple[Use, str]:
    vertical = samples.force[:, 2]
    if _peak(samples) < threshold:
        return "unloaded", f"its load stays at {_peak(samples):.0f} N"
    standing, seated = _mean(vertical, samples.ok & tall), _mean(vertical, samples.ok & low)
    if np.isfinite(standing) and np.isfinite(seated):
        if seated > threshold and standing < seated / 2:
            return "seat", f"{seated:.0f} N while the body is low, {standing:.0f} N while it stands"
        lost = _loaded(samples, tall) - standing
        if lost > threshold and _sway(samples, tall) < _STEADY * lost:
            return (
                "seat",
                f"up to {standing + lost:.0f} N before the body stands, a steady {standing:.0f} N while it does",
            )
    return "feet", "its load survives standing" if np.isfinite(seated) else "it is loaded"


def _peak(samples: PlateSamples) -> float:
    """Vertical force that all but a twentieth of the good samples stay under, N."""
    vertical = samples.force[samples.ok, 2]
    return float(np.percentile(np.abs(vertical), 95)) if vertical.size else 0.0


def _loaded(samples: PlateSamples, tall: BoolArray) -> float:
    """Vertical force that a tenth of the samples exceeds in which the body does not stand, N."""
    vertical = samples.force[samples.ok & ~tall, 2]
    return float(np.percentile(vertical, 90)) if vertical.size else 0.0


def _sway(samples: PlateSamples, tall: BoolArray) -> float:
    """Range that four fifths of the vertical force keep to while the body stands, N."""
    low, high = np.percentile(samples.force[samples.ok & tall, 2], [10, 90])
    return float(high - low)


def _mean(values: FloatArray, where: BoolArray) -> float:
    return float(values[where].mean()) if where.any() else float("nan")
