"""Classification of force plates as under the feet, under a chair or unloaded, and the mass of the person."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import ConfigError
from mocap_id.recording.lab_plates import LOADED_N
from mocap_id.recording.marker_posture import body_height, shows_standing, upright
from mocap_id.recording.model import Plate
from mocap_id.recording.resampling import PlateSamples

Use: TypeAlias = Literal["feet", "seat", "unloaded", "ignored"]

GRAVITY = 9.81  # m/s^2

_OFFSET_SHARE = 0.05
"""A plate is unloaded if its force is less than this share of that of the most loaded plate."""

_STEADY = 0.05
"""Share of the load lost in standing up. The remaining force of an empty chair varies by less, that of feet by more."""

_STILL_M_S = 0.02
"""Largest vertical speed of a person who stands nearly still."""

_SPEED_OVER_S = 0.1
"""Speeds are differences over this time to either side, to suppress marker noise."""

_MIN_TOTAL_S = 0.2

_MIN_MASS_KG = 2.0

_CONFIGURED = "by the configuration"


@dataclass(frozen=True)
class PlateChoice:
    """Use of every plate.

    Parameters
    ----------
    uses : tuple of {"feet", "seat", "unloaded", "ignored"}
        Use of each plate; ``ignored`` plates are unusable or not named in the configuration.
    loads : tuple of float
        Mean upward force of each plate over the chosen frames, N; NaN if unusable.
    why : tuple of str
        Reason for each use.
    """

    uses: tuple[Use, ...]
    loads: tuple[float, ...]
    why: tuple[str, ...]

    def indices(self, use: Use) -> tuple[int, ...]:
        """Return the indices (from 0) of the plates with this use."""
        return tuple(i for i, each in enumerate(self.uses) if each == use)

    def facts(self, plates: Sequence[Plate]) -> list[dict[str, Any]]:
        """Return JSON rows with index, kind, use, mean_vertical_N and why."""
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
    """Find which plates are under the feet, which under a chair and which unloaded.

    A plate is unloaded if its force stays under 20 N, or under a twentieth of that of the most loaded plate. A plate
    under a chair is loaded while the body is low; when the person stands, its load drops to less than half or to a
    constant value, the weight of the chair. Plates that stay loaded are under the feet. If there are none, there is no
    chair either. The configuration has priority.

    Parameters
    ----------
    plates : sequence of Plate
    samples : sequence of PlateSamples
        Wrench of every plate at the marker times.
    positions : (F, M, 3) array
        Markers at these times, lab axes with Z up, m; NaN where not visible.
    feet, seat : collection of int
        Plate numbers (from 1) in the configuration. If any is given, all other plates are ignored.

    Raises
    ------
    ConfigError
        The configuration names a plate that does not exist, or a plate twice.
    """
    _check_names(plates, feet, seat)
    tall, low = upright(positions)
    loads = tuple(_mean(each.force[:, 2], each.ok) for each in samples)
    threshold = max([LOADED_N, *(_OFFSET_SHARE * _peak(each) for each in samples)])
    chosen: list[tuple[Use, str]] = []
    for plate, each in zip(plates, samples, strict=True):
        if not plate.usable or not each.ok.any():
            chosen.append(("ignored", plate.problem or "it has no valid sample in these frames"))
        elif _peak(each) >= threshold and _is_constant(each):
            constant = each.force[each.ok, 2][0]
            chosen.append(("ignored", f"it reads the same {constant:.0f} N throughout: not connected, or saturated"))
        elif plate.index in feet and _peak(each) < LOADED_N:
            chosen.append(("unloaded", f"named under `feet`, but its load stays under {LOADED_N:.0f} N"))
        elif feet or seat:
            use: Use = "feet" if plate.index in feet else "seat" if plate.index in seat else "ignored"
            chosen.append((use, _CONFIGURED))
        else:
            chosen.append(_classify(each, tall, low, threshold))
    if not any(use == "feet" for use, _ in chosen) and not (feet or seat):
        # without a plate under the feet there is no chair: this is a jump or walking
        chosen = [("feet", "it is loaded") if use == "seat" else (use, why) for use, why in chosen]
    return PlateChoice(tuple(use for use, _ in chosen), loads, tuple(why for _, why in chosen))


def find_contradictions(samples: Sequence[PlateSamples], choice: PlateChoice, positions: FloatArray) -> dict[int, str]:
    """Find plates whose load contradicts the configuration.

    Parameters
    ----------
    samples, choice, positions
        As in :func:`choose_plates`, and its result.

    Returns
    -------
    dict of int to str
        Description of the contradiction, by the index of the plate (from 0).
    """
    tall, low = upright(positions)
    if not low.any():
        return {}
    threshold = max([LOADED_N, *(_OFFSET_SHARE * _peak(each) for each in samples)])
    found: dict[int, str] = {}
    for index in (index for index, why in enumerate(choice.why) if why == _CONFIGURED):
        each = samples[index]
        expected, why = _classify(each, tall, low, threshold)
        standing, loaded = _mean(each.force[:, 2], each.ok & tall), _loaded(each, tall)
        if choice.uses[index] == "seat" and expected == "feet" and standing > loaded / 2:
            found[index] = f"carries {standing:.0f} N while the person stands and up to {loaded:.0f} N before"
        elif choice.uses[index] == "feet" and expected == "seat":
            found[index] = f"carries {why}"
    return found


def standing_mass(positions: FloatArray, rate: float, vertical: FloatArray) -> tuple[float | None, str | None]:
    """Estimate the mass of the person from the force under the feet while standing still.

    The load alone does not distinguish standing from sitting, so the posture must show it
    (:func:`mocap_id.recording.marker_posture.shows_standing`).

    Parameters
    ----------
    positions : (F, M, 3) array
        Markers, lab axes, m.
    rate : float
        Frames per second.
    vertical : (F,) array
        Upward force of the plates under the feet, N; NaN where unknown.

    Returns
    -------
    mass : float or None
        Mass, kg.
    why : str or None
        Why there is no estimate.
    """
    tall, _ = upright(positions)
    half = min(max(1, round(_SPEED_OVER_S * rate)), (len(positions) - 1) // 2)
    height = body_height(positions)
    speed, stop = np.full(len(positions), np.nan), len(positions) - half
    speed[half:stop] = (height[2 * half :] - height[: stop - half]) * rate / max(2 * half, 1)
    with np.errstate(invalid="ignore"):
        still = tall & (np.abs(speed) < _STILL_M_S) & np.isfinite(vertical)
    if still.sum() < max(2, _MIN_TOTAL_S * rate):
        return None, "the person never stands still on the plates"
    if not shows_standing(positions, still):
        return None, (
            "the markers do not show that the person stands: where the body is highest and still, they are as broad as "
            "those of a seated person or lie in a line; a chair may carry part of the weight"
        )
    mass = float(np.median(vertical[still])) / GRAVITY
    return (mass, None) if mass > _MIN_MASS_KG else (None, "the plates carry no weight while the person stands")


def _is_constant(samples: PlateSamples) -> bool:
    """Return whether the load is constant, without the noise that every loaded plate has."""
    vertical = samples.force[samples.ok, 2]
    return bool(np.ptp(vertical) <= 1e-6 * np.max(np.abs(vertical)))


def _check_names(plates: Sequence[Plate], feet: Collection[int], seat: Collection[int]) -> None:
    known = [plate.index for plate in plates]
    for name, group in (("feet", feet), ("seat", seat)):
        missing = sorted(set(group) - set(known))
        if missing:
            raise ConfigError(f"plates: {name}: {missing} do not exist; the recording has the plates {known}")
    both = sorted(set(feet) & set(seat))
    if both:
        raise ConfigError(f"plates: {both} are named under both `feet` and `seat`")


def _classify(samples: PlateSamples, tall: BoolArray, low: BoolArray, threshold: float) -> tuple[Use, str]:
    vertical = samples.force[:, 2]
    if _peak(samples) < threshold:
        return "unloaded", f"its load stays at {_peak(samples):.0f} N"
    standing, seated = _mean(vertical, samples.ok & tall), _mean(vertical, samples.ok & low)
    if np.isfinite(standing) and np.isfinite(seated):
        if seated > threshold and standing < seated / 2:
            return "seat", f"{seated:.0f} N while the body is low, {standing:.0f} N while it stands"
        lost = _loaded(samples, tall) - standing
        if lost > threshold and _sway(samples, tall) < _STEADY * lost:
            before = f"up to {standing + lost:.0f} N before the body stands"
            return "seat", f"{before}, a constant {standing:.0f} N while it stands"
    return "feet", "it stays loaded while the body stands" if np.isfinite(seated) else "it is loaded"


def _peak(samples: PlateSamples) -> float:
    """Return the 95th percentile of the size of the vertical force, N."""
    vertical = samples.force[samples.ok, 2]
    return float(np.percentile(np.abs(vertical), 95)) if vertical.size else 0.0


def _loaded(samples: PlateSamples, tall: BoolArray) -> float:
    """Return the 90th percentile of the vertical force while the body does not stand, N."""
    vertical = samples.force[samples.ok & ~tall, 2]
    return float(np.percentile(vertical, 90)) if vertical.size else 0.0


def _sway(samples: PlateSamples, tall: BoolArray) -> float:
    """Return the range of the vertical force from the 10th to the 90th percentile while the body stands, N."""
    low, high = np.percentile(samples.force[samples.ok & tall, 2], [10, 90])
    return float(high - low)


def _mean(values: FloatArray, where: BoolArray) -> float:
    return float(values[where].mean()) if where.any() else float("nan")
