"""Checks of an installation: what mocap-id needs, what is optional, and how to repair the rest."""

from mocap_id.workflows.doctor.checks import check_installation
from mocap_id.workflows.doctor.finding import Finding
from mocap_id.workflows.doctor.machine import compile_filter, compile_modules

__all__ = ["Finding", "check_installation", "compile_filter", "compile_modules"]
