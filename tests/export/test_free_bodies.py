"""Export of a trial identified on measured poses: the model of free bodies, and the notes."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import pandas as pd
import pytest
from resultants import JointPlaces, Needs, Poses

from mocap_id import recording
from mocap_id.config import load
from mocap_id.runner import run_to
from mocap_id.workflows.export import FORMATS, Export, export_run
from mocap_id.workflows.export.opensim_tables import add_motion
from mocap_id.workflows.export.tables import ExportFiles
from mocap_id_simulation import Options, PersonOptions, simulate

NAMES = ("foot", "shank", "thigh", "torso")
G = 9.81
KEYS = ("mass", "mass_center", "inertia")
Loose = tuple[Path, Export]


@pytest.fixture(scope="module")
def loose(tmp_path_factory: pytest.TempPathFactory) -> Loose:
    """Run folder and export of a simulated person with a hip gap."""
    out = tmp_path_factory.mktemp("loose")
    options = Options(seed=4, repetitions=2, rate=100.0, analog_rate=500.0, people=PersonOptions(hip_gap_mm=10))
    trial = Path(simulate("sit-to-stand", out / "recording", options))
    folder = run_to(load(trial), "identify-dim").folder
    return folder, export_run(folder, tuple(FORMATS), out / "files")


def file(loose: Loose, ending: str) -> Path:
    return next(path for path in loose[1].files if path.name == f"{loose[0].name}{ending}")


def bodies(path: Path) -> dict[str, tuple[float, np.ndarray, float]]:
    """Return mass, centre of mass and moment of inertia about it for a model's bodies."""
    found = {}
    for body in ElementTree.parse(path).getroot().iter("Body"):
        mass, centre, inertia = ([float(word) for word in str(body.findtext(key)).split()] for key in KEYS)
        found[str(body.get("name"))] = mass[0], np.array(centre[:2]), inertia[2]
    return found


def test_masses_are_positive_and_add_up_in_both_models(loose: Loose) -> None:
    """The chain's masses are composed of the bodies'; the first base parameter is the total mass."""
    chain, free = bodies(file(loose, ".osim")), bodies(file(loose, "_free.osim"))
    with h5py.File(loose[0] / "dynamics.h5") as tree:
        total, full = float(tree["base/value"][0]), np.asarray(tree["full/value"]).reshape(-1, 4)
        own = np.asarray(tree["bodies/value"]).reshape(-1, 4)
    assert set(NAMES) <= set(free)
    for model, values in ((chain, full), (free, own)):
        assert min(mass for mass, _, _ in model.values()) > 0
        assert min(inertia for _, _, inertia in model.values()) >= 0
        assert sum(mass for mass, _, _ in model.values()) == pytest.approx(total, rel=1e-6)
        for (mass, centre, inertia), (m, mx, my, izz) in zip(model.values(), values, strict=True):
            np.testing.assert_allclose([mass, *(mass * centre)], [m, mx, my], atol=1e-9)
            assert inertia + mass * centre @ centre == pytest.approx(izz, abs=1e-9)


def test_the_files_make_up_torques_and_wrench(loose: Loose) -> None:
    """Newton's and Euler's equations with the masses, poses and accelerations in the files."""
    model = bodies(file(loose, "_free.osim"))
    states, accelerations = (
        recording.read_table(file(loose, f"_free_{key}.sto")) for key in ("states", "accelerations")
    )
    poses = Poses.of(states, tuple(model), states.time)

    def needed(name: str, coordinate: str) -> np.ndarray:
        mass, centre, inertia = model[name]
        angle, speed = (states[f"/jointset/{name}_pose/{name}_rz/{key}"] for key in ("value", "speed"))
        alpha = accelerations[f"{name}_rz"]
        c, s = np.cos(angle), np.sin(angle)
        arm = np.stack([c * centre[0] - s * centre[1], s * centre[0] + c * centre[1]])
        linear = np.stack([accelerations[f"{name}_tx"], accelerations[f"{name}_ty"] + G])
        force = mass * (linear + alpha * np.stack([-arm[1], arm[0]]) - speed**2 * arm)
        moment = inertia * alpha + arm[0] * force[1] - arm[1] * force[0]
        return np.asarray({"tx": force[0], "ty": force[1], "rz": moment}[coordinate])

    dynamics = pd.read_parquet(loose[0] / "dynamics.parquet")
    errors = Needs.of(poses, needed).errors(states.time, dynamics, JointPlaces.of(loose[0]))
    assert set(errors) == {"tau_1", "tau_2", "tau_3", "Fx_model", "Fy_model", "tauz_model"}
    for name, error in errors.items():
        assert len(error) > 400
        assert np.abs(error).max() < 1e-5, name


def test_the_joints_file_holds_the_shifted_mean_of_a_joints_two_sides(loose: Loose) -> None:
    states, joints = (recording.read_table(file(loose, f"_free_{key}.sto")) for key in ("states", "joints"))
    poses = Poses.of(states, tuple(bodies(file(loose, "_free.osim"))), joints.time)
    places = JointPlaces.of(loose[0])
    inside = slice(2, -2)  # at its ends a body's speed is unknown, and with it its state
    for j, name in enumerate(("ankle", "knee", "hip")):
        told = np.stack([joints[f"{name}_x"], joints[f"{name}_y"]], axis=-1)
        np.testing.assert_allclose(told[inside], poses.joint(j, places)[inside], atol=1e-8)


def test_speeds_are_those_of_the_poses(loose: Loose) -> None:
    states = recording.read_table(file(loose, "_free_states.sto"))
    for coordinate in ("thigh_rz", "thigh_tx", "thigh_ty"):
        value, speed = (states[f"/jointset/thigh_pose/{coordinate}/{key}"] for key in ("value", "speed"))
        assert np.abs(np.gradient(value, states.time) - speed)[1:-1].max() < 0.01
        assert np.abs(speed).max() > 0.1


def test_what_the_chain_does_not_show_is_said_where_one_looks(loose: Loose) -> None:
    said = " ".join(loose[1].notes)
    name = loose[0].name
    assert f"its inverse dynamics does not give {name}_torques.sto" in said
    assert f"sto: torques and modelled wrench belong to bodies on their measured poses ({name}_free" in said
    assert "csv: torques and modelled wrench belong to bodies" in said
    assert "Torques and ground wrench do not depend on the division" not in said
    text = file(loose, ".osim").read_text("utf-8")
    assert "belong to these bodies, not to this chain" in text
    free = file(loose, "_free.osim").read_text("utf-8")
    for joint in ("ankle", "knee", "hip"):
        assert f"Torque of {joint}: the moment, about its centre" in free


def test_a_trial_on_the_chain_has_no_free_bodies(exported) -> None:
    assert not [path.name for path in exported().exported.files if "_free" in path.name]
    assert "Torques and ground wrench do not depend on the division" in " ".join(exported().exported.notes)


def test_a_column_of_which_nothing_is_known_does_not_empty_the_table() -> None:
    """The unknown column is the torque between two segments that form one body."""
    values = np.array([[1.0, np.nan, 2.0], [3.0, np.nan, np.nan], [4.0, np.nan, 5.0]])
    parts = ExportFiles()
    add_motion(parts, "a.sto", "t", ["hip", "lumbar", "knee"], values, time=np.arange(3.0))
    text = parts.files["a.sto"].decode()
    assert "time\thip\tknee" in text
    assert len(text.partition("endheader\n")[2].splitlines()) == 3
    assert "columns left out, because all their values are unknown: lumbar" in parts.notes[0]
