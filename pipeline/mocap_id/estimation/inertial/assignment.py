"""Calibration of all sensors of a trial, each on the segment that it is said to be on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.inertial.calibration import Calibrated, calibrate_sensor
from mocap_id.estimation.inertial.clock import Clock, borrowed_clock, find_clock
from mocap_id.estimation.inertial.preparation import disagreement
from mocap_id.estimation.inertial.signals import SegmentMotion, SensorSignals

_CLEAR = 0.5  # least correlation of speeds of rotation for a clock
_MARGIN = 0.2  # s; the motion beside a gap is also bridged


@dataclass(frozen=True)
class SensorResult:
    """What is known of the sensor on one segment.

    Parameters
    ----------
    found : Calibrated or None
        None if sensor and markers have too little time in common.
    saturated : float
        Share of its samples that are saturated.
    why : str or None
        Why the sensor is left out.
    fits : int or None
        Another segment whose motion it fits better.
    """

    found: Calibrated | None
    saturated: float
    why: str | None = None
    fits: int | None = None


def calibrate_all(
    sensors: Mapping[int, SensorSignals], motions: Sequence[SegmentMotion], time: FloatArray
) -> dict[int, SensorResult]:
    """Calibrate all sensors; those whose motion shows no clock take that of the others.

    Parameters
    ----------
    sensors : mapping from int to SensorSignals
        By the number of their segment.
    motions : sequence of SegmentMotion
        Of every segment, from markers alone.
    time : (F,) array
        Uniform times of the cameras, s.
    """
    coarse = {s: find_clock(each, motions[s], time) for s, each in sensors.items()}
    clear = sorted(sensors, key=lambda s: -coarse[s][1])
    clocks: list[Clock] = []
    results = {}
    for s in clear:
        offset, correlation = coarse[s]
        clock = Clock(offset) if correlation > _CLEAR else borrowed_clock(clocks)
        found = calibrate_sensor(sensors[s], motions[s], time, clock, follows=s > 0)
        saturated = float(np.mean(sensors[s].saturated))
        if found is None:
            results[s] = SensorResult(None, saturated, "too few samples in the time of the recording")
            continue
        why = disagreement(found)
        fits = _better_segment(sensors[s], motions, time, s, found) if why else None
        results[s] = SensorResult(found, saturated, why, fits)
        if why is None and found.clock.observable:
            clocks.append(found.clock)
    return {s: results[s] for s in sensors}


def _better_segment(
    signals: SensorSignals, motions: Sequence[SegmentMotion], time: FloatArray, own: int, found: Calibrated
) -> int | None:
    """Return a segment whose motion the sensor agrees with, or None."""
    best, least = None, 0.5 * float(found.left[0])
    for s, motion in enumerate(motions):
        if s == own:
            continue
        offset, correlation = find_clock(signals, motion, time)
        other = calibrate_sensor(signals, motion, time, Clock(offset)) if correlation > _CLEAR else None
        if other is not None and disagreement(other) is None and other.left[0] < least:
            best, least = s, float(other.left[0])
    return best


def find_shown(observed: BoolArray, rate: float) -> BoolArray:
    """Return where (F, n) a segment is observed, and not bridged within some time; ``rate`` in Hz."""
    width = 2 * round(_MARGIN * rate) + 1
    hidden = np.stack([np.convolve(~each, np.ones(width), mode="same") for each in observed.T], axis=1) > 0.5
    return np.asarray(~hidden)
