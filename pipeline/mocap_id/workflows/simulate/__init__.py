"""Simulated trials with exact truth: a person rising from a chair, a robot's joint."""

from mocap_id.workflows.simulate.cohort import Cohort, simulate_cohort
from mocap_id.workflows.simulate.generate import Simulated, generate
from mocap_id.workflows.simulate.motion import Motion, through
from mocap_id.workflows.simulate.options import Kind, Options
from mocap_id.workflows.simulate.people import People
from mocap_id.workflows.simulate.robot_set import RobotSet, simulate_set
from mocap_id.workflows.simulate.schedule import Strategy
from mocap_id.workflows.simulate.trial import simulate

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
