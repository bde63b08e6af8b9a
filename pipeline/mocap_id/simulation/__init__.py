"""Simulated trials with exact truth: a person rising from a chair, or a swinging robot joint.

Trials in space are simulated in ``arm`` (arms and chains) and ``space_robot``.
"""

from mocap_id.simulation.cohort import Cohort, simulate_cohort
from mocap_id.simulation.joint_motion import JointMotion, motion_through
from mocap_id.simulation.options import Kind, Options, PersonOptions
from mocap_id.simulation.robot_set import RobotSet, simulate_robot_set
from mocap_id.simulation.schedule import Strategy
from mocap_id.simulation.simulated_trial import SimulatedTrial, generate
from mocap_id.simulation.trial_files import simulate

__all__ = [
    "Cohort",
    "JointMotion",
    "Kind",
    "Options",
    "PersonOptions",
    "RobotSet",
    "SimulatedTrial",
    "Strategy",
    "generate",
    "motion_through",
    "simulate",
    "simulate_cohort",
    "simulate_robot_set",
]
