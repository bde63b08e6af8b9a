"""``mocap-id prescribe``: the springs that give most of a joint's, or a chain's, range back (thesis 7.3, 7.4)."""

from mocap_id.workflows.prescribe.performing import Prescribed, prescribe_from
from mocap_id.workflows.prescribe.writing import as_json, write

__all__ = ["Prescribed", "as_json", "prescribe_from", "write"]
