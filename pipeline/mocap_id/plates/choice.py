"""Use of each force plate (feet, chair, none), and comparison of its forces with standing and with the movement."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.optimize import nnls

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray, find_runs
from mocap_id.errors import ConfigError
from mocap_id.recording.lab_plates import LOADED_N, PlateSamples
from mocap_id.recording.model import Plate
from mocap_id.recording.sample_checks import find_upright, measure_body_height, shows_standing

Use: TypeAlias = Literal["feet", "seat", "unloaded", "ignored"]

# a plate is unloaded if its force is less than this fraction of the force of the most loaded plate
_OFFSET_SHARE = 0.05
# Fraction of the decrease of the load when the person stands up. While the person stands, the force under an empty
# chair varies by less than this, and the force under the feet by more.
_STEADY = 0.05
_CONFIGURED = "set in the configuration"


@dataclass(frozen=True)
class PlateChoice:
    """Use of every plate, and the reason for this use."""

    uses: tuple[Use, ...]  # use of each plate; `ignored` if unusable, or if the configuration names only other plates
    loads: tuple[float, ...]  # mean upward force of each plate, N; NaN for a plate without valid samples
    why: tuple[str, ...]  # reason for each use

    def indices(self, use: Use) -> tuple[int, ...]:
        """Return the indices (from 0) of the plates with this use."""
        return tuple(i for i, each in enumerate(self.uses) if each == use)

    def list_unused(self, plates: Sequence[Plate]) -> list[str]:
        """Return each plate that is neither under the feet nor under a chair, and why, for messages."""
        return [
            f"plate {plate.index} ({why})"
            for plate, use, why in zip(plates, self.uses, self.why, strict=True)
            if use not in ("feet", "seat")
        ]


def choose_plates(
    plates: Sequence[Plate],
    samples: Sequence[PlateSamples],
    positions: FloatArray,
    *,
    feet: Collection[int] = (),
    seat: Collection[int] = (),
) -> PlateChoice:
    """Determine for each plate whether it is under the feet, under a chair or unloaded.

    A plate is unloaded if its force stays below 20 N, or below 5 % of the force of the most loaded plate. A plate is
    under a chair if its load decreases when the person stands up: to less than half of the load while the body is low,
    or to a constant value, the weight of the chair. All other loaded plates are under the feet. If all loaded plates
    seem to be under a chair, they count as under the feet. The configuration has priority over these rules.

    ``feet`` and ``seat`` are the plate numbers (from 1) in the configuration; if any is given, all other plates are
    ignored. Raises ConfigError if the configuration names a plate that does not exist.
    """
    known = [plate.index for plate in plates]
    for name, group in (("feet", feet), ("seat", seat)):
        missing = sorted(set(group) - set(known))
        if missing:
            raise ConfigError(f"plates: {name}: {missing} do not exist; the recording has the plates {known}")
    tall, low = find_upright(positions)
    loads = tuple(_average_force(each.force[:, 2], each.ok) for each in samples)
    threshold = _compute_threshold(samples)
    chosen: list[tuple[Use, str]] = []
    for plate, each in zip(plates, samples, strict=True):
        if not plate.usable or not each.ok.any():
            chosen.append(("ignored", plate.problem or "it has no valid sample in these frames"))
            continue
        vertical = each.force[each.ok, 2]
        # a constant load shows a fault: every loaded plate that works has noise
        if _measure_peak(each) >= threshold and np.ptp(vertical) <= 1e-6 * np.max(np.abs(vertical)):
            why = f"it reads {vertical[0]:.0f} N in every sample: it is not connected or saturated"
            chosen.append(("ignored", why))
        elif plate.index in feet and _measure_peak(each) < LOADED_N:
            chosen.append(("unloaded", f"it is named under `feet`, but its load is below {LOADED_N:.0f} N"))
        elif feet or seat:
            use: Use = "feet" if plate.index in feet else "seat" if plate.index in seat else "ignored"
            chosen.append((use, _CONFIGURED))
        else:
            chosen.append(_classify(each, tall, low, threshold))
    if not any(use == "feet" for use, _ in chosen) and not (feet or seat):
        # without a plate under the feet there is no chair: the movement is a jump or a walk
        chosen = [("feet", "it is loaded") if use == "seat" else (use, why) for use, why in chosen]
    return PlateChoice(tuple(use for use, _ in chosen), loads, tuple(why for _, why in chosen))


def find_contradictions(samples: Sequence[PlateSamples], choice: PlateChoice, positions: FloatArray) -> dict[int, str]:
    """Return a description of each contradiction between a plate's load and its use in the configuration.

    The keys are the indices of the plates (from 0). ``choice`` is the result of :func:`choose_plates`.
    """
    tall, low = find_upright(positions)
    if not low.any():
        return {}
    threshold = _compute_threshold(samples)
    contradictions: dict[int, str] = {}
    for index in (index for index, why in enumerate(choice.why) if why == _CONFIGURED):
        each = samples[index]
        expected, why = _classify(each, tall, low, threshold)
        standing, loaded = _average_force(each.force[:, 2], each.ok & tall), _measure_load(each, tall)
        if choice.uses[index] == "seat" and expected == "feet" and standing > loaded / 2:
            contradictions[index] = f"carries {standing:.0f} N while the person stands and up to {loaded:.0f} N before"
        elif choice.uses[index] == "feet" and expected == "seat":
            contradictions[index] = f"carries {why}"
    return contradictions


def _classify(samples: PlateSamples, tall: BoolArray, low: BoolArray, threshold: float) -> tuple[Use, str]:
    """Return the use of a plate and the reason, from its load while the body stands (``tall``) and while it is low."""
    vertical = samples.force[:, 2]
    if _measure_peak(samples) < threshold:
        return "unloaded", f"its load is only {_measure_peak(samples):.0f} N"
    standing, seated = _average_force(vertical, samples.ok & tall), _average_force(vertical, samples.ok & low)
    if np.isfinite(standing) and np.isfinite(seated):
        if seated > threshold and standing < seated / 2:
            return "seat", f"{seated:.0f} N while the body is low, but {standing:.0f} N while the person stands"
        decrease = _measure_load(samples, tall) - standing
        lowest, highest = np.percentile(samples.force[samples.ok & tall, 2], [10, 90])
        if decrease > threshold and float(highest - lowest) < _STEADY * decrease:
            before = f"up to {standing + decrease:.0f} N before the person stands"
            return "seat", f"{before}, but a constant {standing:.0f} N afterwards"
    return "feet", "it stays loaded while the person stands" if np.isfinite(seated) else "it is loaded"


def _compute_threshold(samples: Sequence[PlateSamples]) -> float:
    """Return the force below which a plate counts as unloaded, N."""
    return max([LOADED_N, *(_OFFSET_SHARE * _measure_peak(each) for each in samples)])


def _measure_peak(samples: PlateSamples) -> float:
    """Return the 95th percentile of the magnitude of the vertical force, N."""
    vertical = samples.force[samples.ok, 2]
    return float(np.percentile(np.abs(vertical), 95)) if vertical.size else 0.0


def _measure_load(samples: PlateSamples, tall: BoolArray) -> float:
    """Return the 90th percentile of the vertical force while the body does not stand, N; 0 without samples."""
    vertical = samples.force[samples.ok & ~tall, 2]
    return float(np.percentile(vertical, 90)) if vertical.size else 0.0


def _average_force(values: FloatArray, where: BoolArray) -> float:
    return float(values[where].mean()) if where.any() else float("nan")


ZeroRule: TypeAlias = Literal["standing", "none"]


_STILL_M_S = 0.02  # largest vertical speed of a person who stands nearly still
# A speed is the difference between heights this time before and after a sample. A shorter time gives more noise.
_SPEED_OVER_S = 0.1
_MIN_TOTAL_S = 0.2
_MIN_MASS_KG = 2.0
_UNLOADED = 0.2  # fraction of the standing weight. An upright person always loads the plates more, except in a jump.
_MIN_DROPOUT_S = 0.6  # minimum duration of a drop-out. The flight of a jump is always shorter.


def weigh_person(positions: FloatArray, rate: float, vertical: FloatArray) -> tuple[float | None, str | None]:
    """Return the mass of the person, kg, and None; or None and the reason why the mass cannot be estimated.

    ``vertical`` (F,) is the upward force under the feet, N. While the person stands still, this force is the weight. It
    does not distinguish standing from sitting, so the positions of the markers are also checked.
    """
    tall, _ = find_upright(positions)
    half = min(max(1, round(_SPEED_OVER_S * rate)), (len(positions) - 1) // 2)
    height = measure_body_height(positions)
    speed, stop = np.full(len(positions), np.nan), len(positions) - half
    speed[half:stop] = (height[2 * half :] - height[: stop - half]) * rate / max(2 * half, 1)
    with np.errstate(invalid="ignore"):
        still = tall & (np.abs(speed) < _STILL_M_S) & np.isfinite(vertical)
    if still.sum() < max(2, _MIN_TOTAL_S * rate):
        return None, "the person never stands still on the plates"
    if not shows_standing(positions, still):
        return None, (
            "it is not certain that the person stands: while the body is highest and still, the markers are spread as "
            "widely as on a seated person, or lie in a line; a chair may carry part of the weight"
        )
    mass = float(np.median(vertical[still])) / GRAVITY
    return (mass, None) if mass > _MIN_MASS_KG else (None, "the plates carry no weight while the person stands")


def find_dropouts(vertical: FloatArray, tall: BoolArray, rate: float, weight: float) -> BoolArray:
    """Return a mask (F,) of drop-outs: intervals in which the plates are unloaded although the person stands.

    ``vertical`` (F,) is the total upward force of the plates under the feet, and ``weight`` this force while the person
    stands, N. ``tall`` (F,) marks the samples in which the person is upright. A loose cable, for example, causes
    drop-outs.
    """
    with np.errstate(invalid="ignore"):
        unloaded = vertical < _UNLOADED * weight
    dropout = np.zeros(len(vertical), bool)
    for run in find_runs(unloaded):
        dropout[run] = tall[run].sum() >= _MIN_DROPOUT_S * rate
    return dropout


def measure_empty_chair(
    wrench: FloatArray, ok: BoolArray, positions: FloatArray, rate: float, rule: ZeroRule
) -> tuple[FloatArray | None, FloatArray | None]:
    """Measure the reading of the plates under the empty chair, to be subtracted from the wrench of the chair.

    The reading is not zero if the plate was zeroed without the chair. It is the median over the samples in which the
    person stands, because the chair is then empty.

    ``wrench`` (F, 3) is the total (Fx, Fy, tauz) of the plates under the chair, N and N·m, and ``ok`` (F,) says whether
    each sample has a value. The rule ``none`` takes the reading as zero, because the plate was zeroed with the chair on
    it. Return the median (3,) with the weight of the chair, None if too few samples have an empty chair; and the
    standard deviation (3,) of its samples, None if nothing is measured.
    """
    if rule == "none":
        return np.zeros(3), None
    tall, low = find_upright(positions)
    empty = tall & ok & low.any()
    if empty.sum() < max(2, _MIN_TOTAL_S * rate):
        return None, None
    return np.median(wrench[empty], axis=0), wrench[empty].std(axis=0)


_STEP_S = 0.1  # time step of the second differences that give the accelerations
# Fraction of the usual load. If the load is smaller, a chair, for example, may also exert a horizontal force.
_MIN_SHARE = 0.6
_ANGLES = tuple(np.radians(np.arange(-175, 181, 5)).tolist())
_MIN_JUDGED_S = 1.0
_RISEN = 0.7  # fraction of the rise of the body above which no chair touches it
# a mean over this time is subtracted from forces and accelerations: objects that the person takes or puts down, and
# hands on a support, change the force more slowly
_SLOW_S = 2.0
# time step of the accelerations of the whole course: a longer one, because repeated frames disturb them
_COURSE_STEP_S = 0.15
# least correlation of the height of a marker on the body with that of the highest markers; a lifted box has 0.5
_WITH_BODY = 0.8
_FRAMES = 3000  # largest number of frames for this correlation
_LATE_S = 1.0  # largest clock offset between the files of one recording that is exported as one
_LAG_STEP_S = 0.04
_MIN_COMPARED_S = 2.0
_OVERLAP = 0.6  # fraction of the samples that must be common at larger clock offsets


def compare_courses(vertical: FloatArray, positions: FloatArray, rate: float) -> tuple[float, float, float] | None:
    """Compare the course of a vertical force (F,), N, with the vertical acceleration of a standing or rising body.

    The results are the largest correlation of force and acceleration for clock offsets up to ± 1 s, 0 to 1; that for
    all clock offsets for which enough samples are common; and the root mean square of the weight times the
    acceleration, divided by gravity, N: the variation of the force that the movement needs.

    Only samples are compared in which the body has risen, so that no chair carries a part of it. The result is None if
    there are too few of them, or if the body does not move.
    """
    # The markers that rise and lower with the highest quarter of them; all if none does. Markers on objects, such as a
    # box that the person lifts or a table, do not belong to the body.
    thinned = positions[:: max(1, len(positions) // _FRAMES), :, 2]
    usual = np.array([np.median(z[np.isfinite(z)]) if np.isfinite(z).any() else -np.inf for z in thinned.T])
    top = np.argsort(-usual)[: max(2, len(usual) // 4)]
    away = thinned[:, top] - usual[top]
    known = np.isfinite(away)
    common = np.where(known, away, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    rising = []
    for marker, height in enumerate(thinned.T):
        both = np.isfinite(height) & known.any(axis=1)
        moves = both.sum() > 2 and np.ptp(height[both]) > 0.0 and np.ptp(common[both]) > 0.0
        if moves and np.corrcoef(height[both], common[both])[0, 1] > _WITH_BODY:
            rising.append(marker)
    positions = positions[:, np.array(rising or range(positions.shape[1]), dtype=np.int64)]
    half, groups = max(1, round(_COURSE_STEP_S * rate)), group_by_height(positions)
    if len(positions) < 4 * half or not groups or np.isfinite(vertical).sum() < _MIN_COMPARED_S * rate:
        return None
    heights = positions[:, :, 2:]
    each = (heights[2 * half :] - 2 * heights[half:-half] + heights[: -2 * half]) * (rate / half) ** 2
    parts = np.full((len(groups), len(positions)), np.nan)
    parts[:, half:-half] = [average_markers(each[:, group])[:, 0] for group in groups]
    force = np.full(len(positions), np.nan)
    force[half:-half] = _average_triangular(vertical[:, None], half)[:, 0]
    risen = np.isfinite(parts).all(axis=0)
    if find_upright(positions)[1].any():
        height = measure_body_height(positions)
        low, high = np.nanpercentile(height, [2, 98])
        with np.errstate(invalid="ignore"):
            risen &= height >= low + _RISEN * (high - low)
    if risen.sum() < _MIN_COMPARED_S * rate:
        return None
    width = 2 * round(_SLOW_S * rate / 2) + 1
    parts, force = _subtract_mean(parts, width), _subtract_mean(force[None], width)[0]
    mass = float(np.nanpercentile(vertical, 90)) / GRAVITY
    expected = mass * float(np.sqrt(np.mean(parts.mean(axis=0)[risen] ** 2)))
    least, most = _MIN_COMPARED_S * rate, _OVERLAP * risen.sum()
    step, reach = max(1, round(_LAG_STEP_S * rate)), len(positions) - round(least)
    best, far = -1.0, 0.0
    for lag in range(-reach // step * step, reach + 1, step):
        chosen = np.flatnonzero(risen)
        chosen = chosen[(chosen + lag >= 0) & (chosen + lag < len(force))]
        chosen = chosen[np.isfinite(force[chosen + lag])]
        near = abs(lag) <= _LATE_S * rate
        if len(chosen) < (least if near else max(least, most)):
            continue
        kept = chosen[:: max(1, half // 2)]  # the averaged signals contain no higher frequencies
        rows, target = parts[:, kept].T, force[kept + lag]
        rows, target = rows - rows.mean(axis=0), target - target.mean()
        size = float(np.linalg.norm(target))
        residual = float(nnls(rows, target)[1])
        correlation = float(np.sqrt(max(0.0, 1.0 - (residual / max(size, 1e-300)) ** 2)))
        far = max(far, correlation)
        if near:
            best = max(best, correlation)
    return None if best < 0.0 else (best, far, expected)


def _subtract_mean(values: FloatArray, width: int) -> FloatArray:
    """Return series (k, F) minus their mean over ``width`` samples; missing samples stay NaN and do not count."""
    known, ones = np.isfinite(values), np.ones(width)
    total = np.stack([np.convolve(each, ones, "same") for each in np.where(known, values, 0.0)])
    count = np.stack([np.convolve(each, ones, "same") for each in known.astype(np.float64)])
    return np.asarray(values - total / np.maximum(count, 1.0))


@dataclass(frozen=True)
class ForceDirection:
    """Direction of the horizontal force relative to the measured acceleration."""

    angle: float  # angle about the vertical from the acceleration to the force, in (-π, π] in steps of 5°, rad
    coherence: float  # correlation of the force with the acceleration after rotation by the angle, 0 to 1
    size: float  # root mean square of the force minus its mean, N
    expected: float  # the same of the load times the mean acceleration of the markers, divided by gravity, N


def compare_directions(force: FloatArray, positions: FloatArray, rate: float) -> ForceDirection | None:
    """Compare the direction of a horizontal force with the direction of the body's acceleration.

    ``force`` (F, 3) is the force on the body, lab axes, N. It is averaged over ± h with triangular weights, because the
    second difference of a position over a step h is the acceleration averaged with these weights. The result is None if
    there are too few samples.
    """
    half, groups = max(1, round(_STEP_S * rate)), group_by_height(positions)
    if len(positions) < 4 * half or not groups or not np.isfinite(force).any():
        return None
    each = (positions[2 * half :] - 2 * positions[half:-half] + positions[: -2 * half]) * (rate / half) ** 2
    acceleration = np.stack([average_markers(each[:, group])[:, :2] for group in groups])  # (k, T, 2)
    averaged = _average_triangular(force, half)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(acceleration).all(axis=(0, 2))
        known &= averaged[:, 2] > _MIN_SHARE * np.nanpercentile(force[:, 2], 95)
    if known.sum() < _MIN_JUDGED_S * rate:
        return None
    kept = np.flatnonzero(known)[:: max(1, half // 4)]  # the averaged signals contain no higher frequencies
    measured, parts = averaged[kept, :2], acceleration[:, kept]
    measured, centred = measured - measured.mean(axis=0), parts - parts.mean(axis=1, keepdims=True)

    def compute_residual(angle: float) -> float:
        """Return the norm of the force minus fitted masses times accelerations that are rotated by an angle."""
        c, s = np.cos(angle), np.sin(angle)
        rows = (centred @ np.array([[c, s], [-s, c]])).reshape(len(centred), -1).T
        return float(nnls(rows, measured.reshape(-1))[1])

    residual, angle = min((compute_residual(angle), angle) for angle in _ANGLES)
    size = float(np.linalg.norm(measured))
    mean = parts.mean(axis=0)
    mass = float(np.nanpercentile(force[:, 2], 90)) / GRAVITY
    return ForceDirection(
        angle=angle,
        coherence=float(np.sqrt(max(0.0, 1.0 - (residual / max(size, 1e-300)) ** 2))),
        size=size / float(np.sqrt(len(measured))),
        expected=mass * float(np.linalg.norm(mean - mean.mean(axis=0))) / float(np.sqrt(len(kept))),
    )


def average_markers(values: FloatArray) -> FloatArray:
    """Return the mean (F, 3) of values (F, M, 3) over the visible markers; NaN in frames without a visible marker."""
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=2))
    count = known.sum(axis=1)
    total = np.where(known[..., None], values, 0.0).sum(axis=1)
    return np.asarray(np.where(count[:, None] > 0, total, np.nan) / np.maximum(count, 1)[:, None])


def _average_triangular(values: FloatArray, half: int) -> FloatArray:
    """Average a series (F, 3) with triangular weights over ± ``half`` samples; return (F - 2 half, 3)."""
    weights = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]) / half**2
    return np.stack([np.convolve(each, weights, "valid")[1:-1] for each in values.T], axis=1)


def group_by_height(positions: FloatArray) -> Sequence[IntArray]:
    """Return the indices of the markers in each third of the body's height; thirds without markers are left out."""
    height = np.array([np.median(z[np.isfinite(z)]) if np.isfinite(z).any() else np.nan for z in positions[:, :, 2].T])
    if not np.isfinite(height).any():
        return []
    low, high = np.nanmin(height), np.nanmax(height)
    third = np.clip(3 * (height - low) / max(high - low, 1e-9), 0, 2.999)
    groups = [np.flatnonzero((third >= k) & (third < k + 1)) for k in range(3)]
    return [group for group in groups if group.size]
