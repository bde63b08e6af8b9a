"""Whether an installation works: what mocap-id needs, what it can do without, and what to do about the rest."""

from mocap_id.workflows.doctor.check import Check
from mocap_id.workflows.doctor.examining import examine
from mocap_id.workflows.doctor.warming import warm

__all__ = ["Check", "examine", "warm"]
