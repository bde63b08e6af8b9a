"""Simulated trials in space with exact truth: an arm, and plain chains."""

from mocap_id.simulation.arm.arm import generate_arm, simulate_arm
from mocap_id.simulation.arm.chain import simulate_chain
from mocap_id.simulation.arm.cohort import ReachCohort, simulate_reach_cohort
from mocap_id.simulation.arm.curl_cohort import CurlStudy, simulate_curl_study
from mocap_id.simulation.arm.files import write_arm, write_chain
from mocap_id.simulation.arm.options import ArmOptions, ChainOptions
from mocap_id.simulation.arm.trial import SpatialTrial

__all__ = [
    "ArmOptions",
    "ChainOptions",
    "CurlStudy",
    "ReachCohort",
    "SpatialTrial",
    "generate_arm",
    "simulate_arm",
    "simulate_chain",
    "simulate_curl_study",
    "simulate_reach_cohort",
    "write_arm",
    "write_chain",
]
