"""OpenSim's inverse dynamics on measured poses of real trials gives our torques and our modelled wrench.

OpenSim gets the exported free bodies (masses, centres, moments of inertia, poses) and tells the force and the moment
that each of them needs. Their sum about a joint's centre has to be our torque, and their sum about the plane frame's
origin our modelled wrench. That proves that our dynamics of many bodies is Newton's and Euler's, that the exported
model is the identified one, and, by OpenSim's own tool, that our accelerations are the second derivatives of the
exported poses. It proves neither the masses nor the joints' centres: the plate and the simulator judge those.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from resultants import COMPONENTS, JointPlaces, Needs, Poses

from mocap_id import recording
from mocap_id.config import load
from mocap_id.runner import run_to
from mocap_id.workflows.export import export_run

pytestmark = [pytest.mark.external, pytest.mark.recordings]
BODIES = ("foot", "shank", "thigh", "torso", "others")
TRIALS = ("STS1", "squats1")
ENDS = slice(5, -5)  # splines reach outside there


@dataclass(frozen=True)
class Asked:
    """A run, its exported files, and OpenSim's results for them."""

    run: Path
    files: Path
    answer: dict[str, Any]

    @property
    def dynamics(self) -> pd.DataFrame:
        return pd.read_parquet(self.run / "dynamics.parquet")

    def errors(self, tool: bool) -> dict[str, np.ndarray]:
        """Return OpenSim's torques and wrench of the free bodies minus ours, by our columns."""
        found = self.answer["free"]["tool" if tool else "dynamics"]
        time = np.array(found["time"])
        states = recording.read_table(next(self.files.glob("*_free_states.sto")))

        def needed(name: str, coordinate: str) -> np.ndarray:
            ending = ("_moment" if coordinate == "rz" else "_force") if tool else ""
            return np.array(found[f"{name}_{coordinate}{ending}"])

        needs = Needs.of(Poses.of(states, BODIES, time), needed)
        return {
            name: error[ENDS] for name, error in needs.errors(time, self.dynamics, JointPlaces.of(self.run)).items()
        }


@pytest.fixture(scope="module", params=TRIALS)
def asked(
    request: pytest.FixtureRequest,
    recordings: Path,
    opensim: Callable[..., dict[str, Any]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Asked:
    name, out = request.param, tmp_path_factory.mktemp(request.param)
    folder = recordings / "sit-to-stand"
    trial = out / "trial.yaml"
    trial.write_text(
        f"trial: {name}\nprotocol: sit-to-stand\n"
        f"recording: {{markers: {folder / name}.trc, forces: {folder / name}_grf.mot}}\n"
    )
    run = run_to(load(trial), "identify-dim").folder
    export_run(run, ("mot", "sto", "osim"), out / "files")
    return Asked(run, out / "files", opensim(out / "files", name))


def test_opensim_needs_our_torques_and_wrench(asked: Asked) -> None:
    """At our accelerations: 6·10⁻⁸ N·m and N at most were measured."""
    assert tuple(asked.answer["free"]["bodies"]) == BODIES
    errors = asked.errors(tool=False)
    assert {"tau_1", "tau_2", "tau_3", "Fx_model", "Fy_model", "tauz_model"} == set(errors)
    for name, error in errors.items():
        assert len(error) > 100  # torques are unknown while the chair carries the body
        assert np.abs(error).max() < 1e-5, name


def test_opensims_own_derivatives_need_them_too(asked: Asked) -> None:
    """It differentiates the poses by splines: 0.04 N·m and 0.16 N at most were measured, 0.006 and 0.013 rms."""
    for name, error in asked.errors(tool=True).items():
        force = name.startswith("F")
        assert len(error) > (500 if name.startswith("tau_") else 1000)
        assert np.abs(error).max() < (0.4 if force else 0.1), name
        assert np.sqrt(np.mean(error**2)) < (0.03 if force else 0.015), name


def test_the_mass_is_one_in_both_models(asked: Asked) -> None:
    assert asked.answer["mass"] == pytest.approx(asked.answer["free"]["mass"], rel=1e-9)


def test_the_chain_of_pins_with_the_same_masses_is_further_from_the_plate(asked: Asked) -> None:
    """OpenSim's residual at the base of the chain against our model less the plate, on the samples of the fit.

    N and N·m rms were measured: 23, 56 and 26 against 7, 14 and 6 in STS1; 10, 16 and 16 against 4, 5 and 3 in squats1.
    """
    found, dynamics = asked.answer["dynamics"], asked.dynamics
    time = np.array(found["time"])
    inside = np.interp(time, dynamics["time"], dynamics["in_fit"].astype(float)) > 0.99
    assert inside.sum() > 50
    for coordinate, name in zip(("tx", "ty", "rz"), COMPONENTS, strict=True):
        chain = np.array(found[f"base_{coordinate}"])
        ours = np.interp(time, dynamics["time"], dynamics[f"{name}_model"] - dynamics[name])
        assert np.std(chain[inside]) > 1.5 * np.std(ours[inside]), name
