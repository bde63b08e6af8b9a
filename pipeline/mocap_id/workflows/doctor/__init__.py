"""Checks of an installation: what mocap-id needs, what is optional, and how to repair what is missing."""

from mocap_id.workflows.doctor.checks import check_installation
from mocap_id.workflows.doctor.machine import compile_everything
from mocap_id.workflows.doctor.packages import Finding

__all__ = ["Finding", "check_installation", "compile_everything"]
