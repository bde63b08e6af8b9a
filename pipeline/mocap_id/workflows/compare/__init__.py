"""Two runs held against each other: what changed, and by how much."""

from mocap_id.workflows.compare.comparing import Comparison, compare
from mocap_id.workflows.compare.difference import Difference
from mocap_id.workflows.compare.writing import as_json, check_format, write

__all__ = ["Comparison", "Difference", "as_json", "check_format", "compare", "write"]
