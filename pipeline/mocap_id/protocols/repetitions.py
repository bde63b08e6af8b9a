"""Posture of a person whose feet stay on the ground, and a repetition with its events and the details of its rise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs
from mocap_id.geometry import planar

_LOW, _HIGH = 0.3, 0.7  # hysteresis of the upright state, shares of the rise

STANDING = 0.9
"""Height above which the person stands, as a share of the rise."""

QUIET = 0.1
"""Share of the largest speed below which a person who is upright stands quietly."""

# The hip is the first joint from the ground that rises by this share of the largest rise of any joint. The knee rises
# less. The shoulder, or a joint within the trunk, also moves up and down when the trunk leans.
_HIP = 0.5
_LEAST_RISE = 0.15  # share of the length of the leg; a smaller rise is not a sit-to-stand


@dataclass(frozen=True)
class Posture:
    """Height of the hip over time."""

    # (T,) relative height of the hip: 0 at its 2 % quantile, 1 at its 98 % quantile; NaN where unknown
    height: FloatArray
    rise: float  # distance between these two heights, m
    upright: BoolArray  # (T,) upright state with hysteresis: it begins above 0.7 of the rise and ends below 0.3
    moves: bool  # whether the person gets up: the rise is at least 15 % of the length of the chain up to the hip
    # (T,) norm of the velocities of the joints up to the hip, rad/s; NaN where unknown. The joints above it are left
    # out, because the arms may move during a pause.
    speed: FloatArray


def compute_posture(q: FloatArray, dq: FloatArray, centres: FloatArray) -> Posture:
    """Compute the height of the hip for a chain whose base is on the ground.

    ``q`` and ``dq`` (T, n) are the joint angles, rad, and their velocities, rad/s; NaN where unknown. ``centres`` (n,
    2) are the joint centres in the axes of the previous segment, m.
    """
    _, origin = planar.segment_poses(q, centres)
    heights = origin[:, 1:, 1]
    if not np.isfinite(heights).any():
        return Posture(heights[:, 0], 0.0, np.zeros(len(q), dtype=bool), False, np.linalg.norm(dq, axis=1))
    low, high = np.nanquantile(heights, [0.02, 0.98], axis=0)
    joint = int(np.argmax(high - low >= _HIP * np.nanmax(high - low)))
    rise = float(high[joint] - low[joint])
    length = float(np.linalg.norm(centres[1 : joint + 1], axis=1).sum())
    height = (heights[:, joint] - low[joint]) / rise if rise > 0.0 else np.zeros(len(q))
    speed = np.linalg.norm(dq[:, : joint + 1], axis=1)
    # upright from above 0.7 until below 0.3 of the rise; unknown heights are skipped
    change = np.where(height > _HIGH, 1, np.where(height < _LOW, -1, 0))
    decided, upright = np.flatnonzero(change), np.zeros(len(height), dtype=bool)
    if len(decided):
        last = np.searchsorted(decided, np.arange(len(height)), side="right") - 1
        upright = change[decided[np.maximum(last, 0)]] > 0
    return Posture(height, rise, upright, rise > max(_LEAST_RISE * length, 1e-6), speed)


def measure_standing_angles(q: FloatArray, posture: Posture) -> FloatArray | None:
    """Return the median angle of each segment in the plane while the person stands, (n,) rad; None if unknown.

    ``q`` (T, n) are the joint angles, rad. If nobody rises, every sample counts as standing.
    """
    high = posture.height > STANDING if posture.moves else np.ones(len(q), dtype=bool)
    known = high & np.isfinite(q).all(axis=1)
    return np.median(np.cumsum(q[known], axis=1), axis=0) if known.any() else None


def find_standing_phases(posture: Posture) -> list[slice]:
    """Return the part of each upright phase in which the person stands quietly; empty if nobody gets up.

    In a movement without a pause, it is the short time in which the hip is high and slow.
    """
    if not posture.moves:
        return []
    with np.errstate(invalid="ignore"):
        quiet = posture.upright & (posture.height > STANDING) & (posture.speed < QUIET * np.nanmax(posture.speed))
    phases = []
    for upright in find_runs(posture.upright):
        parts = [run for run in find_runs(quiet) if upright.start <= run.start < upright.stop]
        if parts:
            phases.append(max(parts, key=lambda part: part.stop - part.start))
    return phases


NAN = float("nan")
_STILL = 0.08  # share of the peak speed in the rise; the speed is lower in a pause, and above 0.15 without a pause
_PAUSE = 0.3  # s, shortest pause
_OFF_SEAT, _BELOW_TOP = 0.08, 0.1  # share of the rise: a pause closer to the seat or to the top is a rest

SUPPORT_LIMIT = 0.05
"""Smallest unexplained force that counts as support, as a share of the standing weight; model errors are smaller."""

_NO_SEAT = 0.25  # share of the rise above which chairs carry nothing: release below 0.04 in simulations, once at 0.16
_LEAST = 5  # smallest number of samples of a rise


@dataclass(frozen=True)
class Repetition:
    """Events of one repetition, s on the clock of the recording; NaN if an event was not found."""

    start: float  # start of the rise; for a squat, start of the descent; for a robot, start of the cycle
    seat_off: float  # time at which the person leaves the chair
    stand: float  # time at which the person stands
    seat_on: float  # time at which the person touches the chair again
    end: float  # time at which the person sits at rest; for a squat, stands again; for a robot, end of the cycle
    complete: bool  # whether every event of the protocol was found
    why: str = ""  # missing events and their causes; empty if the repetition is complete
    # events that happened while markers of the legs were rejected, and are therefore NaN
    unmeasured: tuple[str, ...] = ()

    def leave_out(self, time: FloatArray, measured: BoolArray, events: Sequence[str]) -> Repetition:
        """Return the repetition with NaN for those of the ``events`` that are not ``measured`` (T,), or beside it."""
        hidden = []
        for name in events:
            at = int(np.searchsorted(time, getattr(self, name)))  # the end if NaN
            if at < len(time) and not measured[max(at - 1, 0) : at + 2].all():
                hidden.append(name)
        if not hidden:
            return self
        text = f"markers of the legs are not used at its {', '.join(hidden)}".replace("_", "-")
        why = "; ".join(part for part in (self.why, text) if part)
        unknown = dict.fromkeys(hidden, NAN)
        return replace(self, **unknown, complete=False, why=why, unmeasured=(*self.unmeasured, *hidden))


@dataclass(frozen=True)
class RiseDetails:
    """Details of a sit-to-stand or squat; NaN where not applicable or unknown.

    In the thesis (6.4.2), the chair is released when the measured wrench agrees with a model without a chair; the feet
    then carry 72 % of the standing weight. The force of the chair reaches zero later.
    """

    # seat_off_72, seat_off_model: seat-off by the share of the weight and by the agreement with the model, s
    seat_off_72: float = NAN
    seat_off_model: float = NAN
    reached: float = NAN  # greatest height of the hip as a share of the trial's rise from seat to standing
    held: float = NAN  # time in pauses between seat and standing, s
    attempts: int = 0  # number of failed attempts before this rise
    support: float = NAN  # vertical force that neither plates nor chair explain, as a share of the standing weight
    # left_seated, left_rising, left_standing: share of the left foot in the load of both feet: seated before the
    # rise, rising, and standing after it
    left_seated: float = NAN
    left_rising: float = NAN
    left_standing: float = NAN


def find_greatest_height(
    time: FloatArray, posture: Posture, repetition: Repetition, measured: BoolArray | None = None
) -> float:
    """Return the greatest height of the hip in a repetition as a share of the trial's rise; NaN if unknown.

    It is also NaN if the person is not seen standing, but may stand where the height is not ``measured`` (T,).
    """
    inside = _find_samples_between(time, repetition.start, repetition.end)
    known = inside[np.isfinite(posture.height[inside])]
    seen = known if measured is None else known[measured[known]]
    highest = float(posture.height[seen].max()) if len(seen) else NAN
    hidden = len(seen) < len(known) and float(posture.height[known].max()) > highest
    return NAN if hidden and not highest >= STANDING else highest


def measure_paused_time(time: FloatArray, posture: Posture, repetition: Repetition) -> float:
    """Return the time in pauses between seat and standing, s; NaN if unknown.

    In a pause, the speed is below 8 % of its peak in the rise for at least 0.3 s.
    """
    rise = _find_samples_between(time, repetition.start, repetition.stand)
    known = rise[np.isfinite(posture.height[rise]) & np.isfinite(posture.speed[rise])]
    if np.isnan(repetition.start) or np.isnan(repetition.stand) or not len(known):
        return NAN
    height, speed = posture.height[known], posture.speed[known]
    low, high = height.min() + _OFF_SEAT, height.max() - _BELOW_TOP
    still = np.zeros(len(time), dtype=bool)
    still[known] = (height > low) & (height < high) & (speed < _STILL * speed.max())
    pauses = [float(time[run.stop - 1] - time[run.start]) for run in find_runs(still)]
    return float(sum(seconds for seconds in pauses if seconds >= _PAUSE))


def _find_samples_between(time: FloatArray, start: float, end: float) -> IntArray:
    """Return the indices of the samples from start to end; NaN means the start or end of the recording."""
    start = time[0] if np.isnan(start) else start
    end = time[-1] if np.isnan(end) else end
    return np.flatnonzero((time >= start) & (time <= end)).astype(np.int64)


def find_share_crossing(time: FloatArray, vertical: FloatArray, share: float, repetition: Repetition) -> float:
    """Return the time at which the force under the feet last rises above a share of the weight before its peak, s.

    The time is interpolated between samples; it is NaN if no crossing is known. Crossings after the peak are ignored,
    because at the end of a fast rise the force is below the share for a short time. ``time`` (T,) are the sample times,
    s; ``vertical`` (T,) is the vertical force under the feet divided by the standing weight, NaN where unknown;
    ``share`` is 0.72 in the thesis.
    """
    rise = np.flatnonzero((time >= repetition.start) & (time <= repetition.stand))
    if not len(rise) or not np.isfinite(vertical[rise]).any():
        return float("nan")
    top = int(np.nanargmax(vertical[rise]))
    known = rise[: top + 1][np.isfinite(vertical[rise[: top + 1]])]
    below = np.flatnonzero(vertical[known] < share)
    if not len(below) or below[-1] + 1 >= len(known):
        return float("nan")
    i, j = known[below[-1]], known[below[-1] + 1]
    return float(np.interp(share, vertical[[i, j]], time[[i, j]]))


def find_model_agreement(time: FloatArray, above_noise: BoolArray | None, repetition: Repetition) -> float:
    """Return the time from which the measured force agrees with a model without a chair, s; NaN if unknown.

    ``above_noise`` (T,) marks the samples with a chair force above the noise; it is None if unknown. The result is the
    time after the last of these samples.
    """
    if above_noise is None or np.isnan(repetition.start):
        return NAN
    samples = np.flatnonzero(above_noise & (time >= repetition.start) & (time <= repetition.seat_off))
    return float(time[min(samples[-1] + 1, len(time) - 1)]) if len(samples) else NAN


def measure_support(
    time: FloatArray,
    posture: Posture,
    missing: FloatArray,
    weight: float,
    repetition: Repetition,
    *,
    seat_measured: bool,
) -> float:
    """Return the mean force of an armrest, a rail or a helping hand in a rise, as a share of the standing weight.

    The acceleration of the body requires a force; the part that the plates do not measure acts elsewhere. Below a
    quarter of the rise, it may act on the chair, so these samples are used only if the chair has its own plate. Hands
    that push on the person's own thighs are not found, because this is an internal force. The result is NaN if unknown.

    ``missing`` (T,) is the vertical ground force predicted by a body model minus the measured force, N; its median in
    quiet standing is the error of the model and is subtracted. ``weight`` is the standing weight, N. ``seat_measured``
    says whether the chair force is measured and excluded from ``missing``.
    """
    with np.errstate(invalid="ignore"):
        quiet = (posture.height > STANDING) & (posture.speed < QUIET * np.nanmax(posture.speed))
        rise = (time >= repetition.start) & (time <= repetition.stand)
        if not seat_measured:
            rise &= (posture.height > _NO_SEAT) & (posture.height < STANDING)
    rise &= np.isfinite(missing)
    quiet &= np.isfinite(missing)
    if np.count_nonzero(rise) < _LEAST or not quiet.any():
        return float("nan")
    return float((missing[rise].mean() - np.median(missing[quiet])) / weight)
