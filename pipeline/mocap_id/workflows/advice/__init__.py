"""``mocap-id advise``: which movement to record next, so that a trial's parameters become better known."""

from mocap_id.workflows.advice.advise import Advised, advise
from mocap_id.workflows.advice.asked import Asked, angle_range, support_range
from mocap_id.workflows.advice.written import as_json, csv_text, lines, write

__all__ = [
    "Advised",
    "Asked",
    "advise",
    "angle_range",
    "as_json",
    "csv_text",
    "lines",
    "support_range",
    "write",
]
