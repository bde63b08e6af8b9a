"""Inertial sensors beside markers: clock, mounting, biases and noise of each sensor, from the motion of its segment.

The motion is estimated from the markers alone, in the plane or in space. The equations are in
docs/concepts/inertial-sensors.md.
"""

from mocap_id.estimation.inertial.calibration import (
    Clock,
    PreparedSensor,
    SensorCalibration,
    SensorResult,
    calibrate_all,
    calibrate_sensor,
    find_observed_segments,
    prepare_sensor,
)
from mocap_id.estimation.inertial.signals import MotionFromMarkers, SensorSignals

__all__ = [
    "Clock",
    "MotionFromMarkers",
    "PreparedSensor",
    "SensorCalibration",
    "SensorResult",
    "SensorSignals",
    "calibrate_all",
    "calibrate_sensor",
    "find_observed_segments",
    "prepare_sensor",
]
