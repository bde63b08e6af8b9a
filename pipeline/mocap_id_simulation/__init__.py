"""Simulated recordings with exact truth.

In a vertical plane: a person rising from a chair, or a swinging robot joint. In space: arms, chains without anatomy,
and robots on a force plate. The core package ``mocap_id`` imports this package only for ``mocap_id.simulate``.
"""

from mocap_id_simulation.arm import generate_arm, simulate_arm
from mocap_id_simulation.arm_files import write_arm, write_chain
from mocap_id_simulation.chains import SimulatedSpaceTrial, simulate_chain
from mocap_id_simulation.motion import JointMotion, motion_through
from mocap_id_simulation.options import ArmOptions, ChainOptions, Kind, Options, PersonOptions, Strategy
from mocap_id_simulation.scene import SimulatedTrial, generate
from mocap_id_simulation.space_robot import (
    SpaceRobotOptions,
    SpaceRobotTrial,
    generate_space_robot,
    simulate_space_robot,
)
from mocap_id_simulation.studies import (
    Cohort,
    CurlStudy,
    ReachCohort,
    RobotSet,
    simulate_cohort,
    simulate_curl_study,
    simulate_reach_cohort,
    simulate_robot_set,
)
from mocap_id_simulation.trial_files import simulate

__all__ = [
    "ArmOptions",
    "ChainOptions",
    "Cohort",
    "CurlStudy",
    "JointMotion",
    "Kind",
    "Options",
    "PersonOptions",
    "ReachCohort",
    "RobotSet",
    "SimulatedSpaceTrial",
    "SimulatedTrial",
    "SpaceRobotOptions",
    "SpaceRobotTrial",
    "Strategy",
    "generate",
    "generate_arm",
    "generate_space_robot",
    "motion_through",
    "simulate",
    "simulate_arm",
    "simulate_chain",
    "simulate_cohort",
    "simulate_curl_study",
    "simulate_reach_cohort",
    "simulate_robot_set",
    "simulate_space_robot",
    "write_arm",
    "write_chain",
]
