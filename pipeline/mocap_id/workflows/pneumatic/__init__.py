"""A pneumatic device as a spring: its torque, pressures, parameters from a log, and gas (thesis 8.1, 9.5)."""

from mocap_id.workflows.pneumatic.curve import device_curve
from mocap_id.workflows.pneumatic.identify import identify_device
from mocap_id.workflows.pneumatic.pressures import gas_budget, spring_pressures

__all__ = ["device_curve", "gas_budget", "identify_device", "spring_pressures"]
