"""``mocap-id workspace``: what the tip of a recovered chain, or of one written in YAML, can reach (thesis 7.2)."""

from mocap_id.workflows.workspace.performing import Reach, compare, measure
from mocap_id.workflows.workspace.sources import Subject, subject
from mocap_id.workflows.workspace.writing import as_json, write

__all__ = ["Reach", "Subject", "as_json", "compare", "measure", "subject", "write"]
