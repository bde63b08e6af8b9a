"""The thesis's robot study (ch. 5): trials of one joint each, through every method for the states."""

from mocap_id.workflows.robot_study.study import Outcome, validate_robot

__all__ = ["Outcome", "validate_robot"]
