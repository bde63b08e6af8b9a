"""Comparison of two runs: what changed, and by how much."""

from mocap_id.workflows.compare.comparison import Comparison, as_json, check_format, compare, write
from mocap_id.workflows.compare.difference import Difference

__all__ = ["Comparison", "Difference", "as_json", "check_format", "compare", "write"]
