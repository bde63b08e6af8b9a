"""A robot whose joints move together in space, on a force plate, with exact truth."""

from mocap_id.simulation.space_robot.robot import SpaceRobotOptions
from mocap_id.simulation.space_robot.trial import SpaceRobotTrial, generate_space_robot, simulate_space_robot

__all__ = ["SpaceRobotOptions", "SpaceRobotTrial", "generate_space_robot", "simulate_space_robot"]
