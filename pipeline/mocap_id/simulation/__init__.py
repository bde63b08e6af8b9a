"""Simulated trials with exact truth: a person rising from a chair, a robot's joint."""

from mocap_id.simulation.cohort import Cohort, simulate_cohort
from mocap_id.simulation.generate import Simulated, generate
from mocap_id.simulation.motion import Motion, through
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.people import People
from mocap_id.simulation.robot_set import RobotSet, simulate_set
from mocap_id.simulation.schedule import Strategy
from mocap_id.simulation.trial import simulate

__all__ = [
    "Cohort",
    "Kind",
    "Motion",
    "Options",
    "People",
    "RobotSet",
    "Simulated",
    "Strategy",
    "generate",
    "simulate",
    "simulate_cohort",
    "simulate_set",
    "through",
]
