"""The workspace of the tip of a trial's chain, or of a chain in YAML (thesis 7.2)."""

from mocap_id.workflows.workspace.arm_source import SubjectArm, read_arm
from mocap_id.workflows.workspace.output import Reach, compare, measure, workspace_result

__all__ = ["Reach", "SubjectArm", "compare", "measure", "read_arm", "workspace_result"]
