"""Calibration of all inertial sensors of a trial, each on the segment that the configuration names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.inertial.calibration import SensorCalibration, calibrate_sensor
from mocap_id.estimation.inertial.clock import Clock, borrow_clock, find_clock
from mocap_id.estimation.inertial.preparation import explain_disagreement
from mocap_id.estimation.inertial.signals import SegmentMotion, SensorSignals

_CLEAR = 0.5  # least correlation of the rotation speeds that determines a clock
_MARGIN = 0.2  # s before and after a gap in which the motion is also partly bridged


@dataclass(frozen=True)
class SensorResult:
    """Calibration of the sensor on one segment, and whether it can be used."""

    calibration: SensorCalibration | None  # None if sensor and markers have too little time in common
    saturated: float  # fraction of its samples that are saturated
    why: str | None = None  # reason for which the sensor is left out; None if it is used
    better_segment: int | None = None  # another segment, whose motion the sensor fits better; None if there is none

    @property
    def used(self) -> SensorCalibration | None:
        """Calibration of a sensor that can be used; None if the sensor is left out."""
        return self.calibration if self.why is None else None


def calibrate_all(
    sensors: Mapping[int, SensorSignals], motions: Sequence[SegmentMotion], time: FloatArray
) -> dict[int, SensorResult]:
    """Calibrate all sensors; return the results by segment, like ``sensors``.

    A sensor whose motion does not determine its clock takes the clock of the others. ``motions`` are the motions of all
    segments from markers alone, and ``time`` (F,) are uniform times of the cameras, s.
    """
    coarse = {s: find_clock(each, motions[s], time) for s, each in sensors.items()}
    clocks: list[Clock] = []
    results = {}
    for s in sorted(sensors, key=lambda s: -coarse[s][1]):
        offset, correlation = coarse[s]
        clock = Clock(offset) if correlation > _CLEAR else borrow_clock(clocks)
        found = calibrate_sensor(sensors[s], motions[s], time, clock, follows=s > 0)
        saturated = float(np.mean(sensors[s].saturated))
        if found is None:
            results[s] = SensorResult(None, saturated, "too few samples in the time of the recording")
            continue
        why = explain_disagreement(found)
        better = _find_better_segment(sensors[s], motions, time, s, found) if why else None
        results[s] = SensorResult(found, saturated, why, better)
        if why is None and found.clock.observable:
            clocks.append(found.clock)
    return {s: results[s] for s in sensors}


def _find_better_segment(
    signals: SensorSignals, motions: Sequence[SegmentMotion], time: FloatArray, own: int, found: SensorCalibration
) -> int | None:
    """Return the segment whose motion the sensor fits much better than that of its segment; None if there is none."""
    best, least = None, 0.5 * float(found.residual[0])
    for s, motion in enumerate(motions):
        if s == own:
            continue
        offset, correlation = find_clock(signals, motion, time)
        other = calibrate_sensor(signals, motion, time, Clock(offset)) if correlation > _CLEAR else None
        if other is not None and explain_disagreement(other) is None and other.residual[0] < least:
            best, least = s, float(other.residual[0])
    return best


def find_observed_segments(observed: BoolArray, rate: float) -> BoolArray:
    """Return where (F, n) a segment is observed in a frame and in all frames near it.

    ``observed`` (F, n) is false in bridged frames; ``rate`` is in frames per second.
    """
    width = 2 * round(_MARGIN * rate) + 1
    hidden = np.stack([np.convolve(~each, np.ones(width), mode="same") for each in observed.T], axis=1) > 0.5
    return np.asarray(~hidden)
