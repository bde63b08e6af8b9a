"""The robot study of the thesis (ch. 5): trials of one joint each, evaluated with every method for the states."""

from mocap_id.workflows.robot_study.study import RobotStudyResult, validate_robot

__all__ = ["RobotStudyResult", "validate_robot"]
