"""Comparison with OpenSim, an independent program, for the exported geometry and dynamics.

Needs a Python with the `opensim` package in a separate environment (`make opensim`, or MOCAP_ID_OPENSIM_PYTHON).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from resultants import COMPONENTS, JointPlaces, Needs, Poses

from mocap_id import recording
from mocap_id.config import load
from mocap_id.runner import run_to
from mocap_id.store import Folder
from mocap_id.workflows.export import export_run
from mocap_id_simulation import Options, PersonOptions, simulate

FORMATS = ("trc", "mot", "sto", "osim")
pytestmark = pytest.mark.external


def angle_errors(answer: dict[str, Any], states: pd.DataFrame) -> np.ndarray:
    """Return OpenSim's angles minus ours (T, n), degrees."""
    names = [name for name in answer["kinematics"] if name.endswith("_angle")]
    assert len(answer["kinematics"]["time"]) == len(states)
    theirs = np.column_stack([answer["kinematics"][name] for name in names])
    return theirs - np.degrees(states[[f"theta_{j}" for j in range(1, len(names) + 1)]].to_numpy())


def force_errors(answer: dict[str, Any], dynamics: pd.DataFrame, key: str = "dynamics") -> dict[str, np.ndarray]:
    """Return OpenSim's generalised forces minus ours at its times: torques and residual wrench."""
    found, time = answer[key], np.array(answer[key]["time"])
    tool = key == "tool"
    joints = [name for name in answer["kinematics"] if name.endswith("_angle")]
    errors = {}
    for j, name in enumerate(joints, start=1):
        ours = np.interp(time, dynamics["time"], dynamics[f"tau_{j}"])
        errors[name] = np.array(found[f"{name}_moment" if tool else name]) - ours
    for coordinate, ending, component in (("tx", "force", "Fx"), ("ty", "force", "Fy"), ("rz", "moment", "tauz")):
        ours = dynamics[f"{component}_model"] - dynamics[component]
        theirs = np.array(found[f"base_{coordinate}_{ending}" if tool else f"base_{coordinate}"])
        errors[component] = theirs - np.interp(time, dynamics["time"], ours)
    inner = {name: error[5:-5] for name, error in errors.items()}  # at the ends splines and clocks reach outside
    return {name: error[np.isfinite(error)] for name, error in inner.items()}


def test_a_small_chain(exported, opensim) -> None:
    done = exported()
    answer = opensim(done.folder, done.name)
    assert answer["bodies"] == 3
    assert answer["markers"] == 12
    errors = angle_errors(answer, done.table("states"))
    assert np.sqrt(np.mean(errors**2)) < 0.1
    forces = force_errors(answer, done.table("dynamics"))
    assert max(float(np.abs(error).max()) for error in forces.values()) < 1e-4


def test_a_chain_without_forces_loads_too(exported, opensim) -> None:
    done = exported(False)
    answer = opensim(done.folder, done.name, f"{done.name}_model.trc")
    assert np.abs(angle_errors(answer, done.table("states"))).max() < 0.001


@pytest.fixture(scope="module")
def chair(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[Path, Path]]:
    """Run folder and files of a sit-to-stand with a plate under the chair; ``chair("chain")`` on pins."""
    out = tmp_path_factory.mktemp("chair")

    def made(name: str, **options: Any) -> tuple[Path, Path]:
        options = {"repetitions": 1} | options
        asked = Options(seed=11, rate=60.0, analog_rate=240.0, seat_plate=True, **options)
        yaml = Path(simulate("sit-to-stand", out / name, asked))
        if name == "chain":
            yaml.write_text(yaml.read_text() + "identify-dim: {motion: chain}\n")
        folder = run_to(load(yaml), "identify-dim").folder
        export_run(folder, FORMATS, out / f"{name}-files")
        return folder, out / f"{name}-files"

    return made


def test_a_person_on_a_chair_that_is_measured(chair, opensim) -> None:
    """Kinematics use measured markers; dynamics of the chain use ground and chair as external loads."""
    folder, files = chair("chain")
    trial = folder.name
    states, dynamics = (pd.read_parquet(folder / f"{name}.parquet") for name in ("states", "dynamics"))
    assert "Fy_external" in dynamics
    answer = opensim(files, trial)
    errors = angle_errors(answer, states)
    assert np.sqrt(np.mean(errors**2, axis=0)).max() < 0.2
    forces = force_errors(answer, dynamics)
    assert max(float(np.nanmax(np.abs(error))) for error in forces.values()) < 1e-4
    assert set(answer["tool"]) >= {f"{name}_moment" for name in answer["kinematics"] if name.endswith("_angle")}
    tool = force_errors(answer, dynamics, "tool")
    assert max(float(np.nanmax(np.abs(tool[name]))) for name in tool) < 0.1


def test_free_bodies_on_a_chair_that_is_measured(chair, opensim) -> None:
    """The required forces include the chair's force on the thigh, which is not part of the torques."""
    folder, files = chair("loose", people=PersonOptions(hip_gap_mm=30))
    answer = opensim(files, folder.name)["free"]
    found, names = answer["dynamics"], tuple(answer["bodies"])
    time, dynamics = np.array(found["time"]), pd.read_parquet(folder / "dynamics.parquet")
    poses = Poses.of(recording.read_table(files / f"{folder.name}_free_states.sto"), names, time)
    needs = Needs.of(poses, lambda name, coordinate: np.array(found[f"{name}_{coordinate}"]))
    places = JointPlaces.of(folder)
    assert Folder(folder).read("dynamics.h5").facts["external"][0]["segment"] == names.index("thigh")
    fx, fy, moment = (np.interp(time, dynamics["time"], dynamics[f"{name}_external"]) for name in COMPONENTS)
    given = {"Fx_model": fx, "Fy_model": fy, "tauz_model": moment, "tau_3": 0.0 * fx}
    for joint in (0, 1):
        x, y = poses.joint(joint, places).T
        given[f"tau_{joint + 1}"] = moment - x * fy + y * fx
    errors = needs.errors(time, dynamics, places)
    assert set(errors) == set(given)
    for name, error in errors.items():
        known = np.isfinite(np.interp(time, dynamics["time"], dynamics[name]))
        expected = given[name][known] if name.startswith("tau_") else given[name]
        assert np.abs(error - expected)[5:-5].max() < 1e-4, name
    assert np.abs(given["tau_2"]).max() > 50


def test_a_robots_joint_within_a_fifth_of_a_degree_throughout(
    opensim, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Compares angles fitted frame by frame to measured markers with smoothed states."""
    out = tmp_path_factory.mktemp("robot")
    yaml = simulate("robot", out / "recording", Options(seed=5, repetitions=2, rate=100.0, analog_rate=500.0))
    folder = run_to(load(Path(yaml)), "identify-dim").folder
    export_run(folder, FORMATS, out / "files")
    answer = opensim(out / "files", folder.name)
    assert np.abs(angle_errors(answer, pd.read_parquet(folder / "states.parquet"))).max() < 0.2
    forces = force_errors(answer, pd.read_parquet(folder / "dynamics.parquet"))
    assert max(float(np.nanmax(np.abs(error))) for error in forces.values()) < 1e-4
