"""A robot's trial to perturb, computed once."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_id.workflows.sensitivity.perturbations import RerunInputs, locate_trial, read_rerun_inputs
from mocap_id.workflows.sensitivity.study import Estimates, read_estimates
from mocap_id_simulation import Options, simulate


@pytest.fixture(scope="session")
def robot_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trial's YAML file."""
    folder = tmp_path_factory.mktemp("robot")
    return simulate("robot", folder, Options(seed=41, repetitions=3, analog_rate=200))


@pytest.fixture(scope="session")
def robot(robot_file: Path) -> RerunInputs:
    """The trial, unperturbed."""
    return read_rerun_inputs(locate_trial(robot_file))


@pytest.fixture(scope="session")
def own(robot: RerunInputs) -> Estimates:
    """Its result."""
    return read_estimates(robot)
