"""Simulated recordings with exact truth.

In a vertical plane: a person rising from a chair, or a swinging robot joint. In space: arms, chains without anatomy,
and robots on a force plate. The core package ``mocap_id`` imports this package only for ``mocap_id.simulate``.
"""

from importlib import import_module

_MODULES = {
    "generate_arm": "arm",
    "simulate_arm": "arm",
    "write_arm": "arm_files",
    "write_chain": "arm_files",
    "SimulatedSpaceTrial": "space_robot",
    "simulate_chain": "space_robot",
    "JointMotion": "sit_to_stand",
    "motion_through": "sit_to_stand",
    "ArmOptions": "options",
    "ChainOptions": "options",
    "Kind": "options",
    "Options": "options",
    "PersonOptions": "options",
    "Strategy": "options",
    "RobotSet": "space_robot",
    "simulate_robot_set": "space_robot",
    "SimulatedTrial": "scene",
    "generate": "scene",
    "SpaceRobotOptions": "space_robot",
    "SpaceRobotTrial": "space_robot",
    "generate_space_robot": "space_robot",
    "simulate_space_robot": "space_robot",
    "Cohort": "studies",
    "CurlStudy": "studies",
    "ReachCohort": "studies",
    "simulate_cohort": "studies",
    "simulate_curl_study": "studies",
    "simulate_reach_cohort": "studies",
    "simulate": "trial_files",
}
"""Module of each name; it is imported when the name is first used."""

__all__ = [*_MODULES]  # noqa: PLE0604  the names are texts


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
