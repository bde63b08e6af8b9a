"""Inertial sensors beside markers: clock, mounting, biases and noise of each sensor, from the motion of its segment.

The motion comes from the markers alone, in the plane or in space. The equations are in
docs/concepts/inertial-sensors.md.
"""

from mocap_id.estimation.inertial.assignment import SensorResult, calibrate_all, find_shown
from mocap_id.estimation.inertial.calibration import Calibrated, calibrate_sensor
from mocap_id.estimation.inertial.clock import Clock
from mocap_id.estimation.inertial.preparation import Prepared, prepare_sensor
from mocap_id.estimation.inertial.signals import SegmentMotion, SensorSignals

__all__ = [
    "Calibrated",
    "Clock",
    "Prepared",
    "SegmentMotion",
    "SensorResult",
    "SensorSignals",
    "calibrate_all",
    "calibrate_sensor",
    "find_shown",
    "prepare_sensor",
]
