"""Exported markers, angles, forces, states and tables read back as in the run."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from mocap_id import recording
from mocap_id.recording.sensor_logs import read_angles
from mocap_id.workflows.export.opensim_tables import convert_planar_wrench, find_known_rows
from mocap_id.workflows.export.tables import make_legal


def grid(frame: pd.DataFrame, *names: str) -> np.ndarray:
    """Return columns of a long table as (F, M, len(names))."""
    count = frame["marker"].nunique()
    return frame[list(names)].to_numpy().reshape(-1, count, len(names))


def plane(positions: np.ndarray) -> np.ndarray:
    """Convert from our reader's axes, Z up, to the plane frame of the file, Y up."""
    return np.stack([positions[..., 0], positions[..., 2], -positions[..., 1]], axis=-1)


def test_measured_markers_read_back_with_their_gaps(exported) -> None:
    done = exported()
    back = recording.read(done.file(".trc"))
    planar = done.table("planar")
    expected = grid(planar, "x", "y", "z")
    assert np.isnan(expected).any()
    np.testing.assert_allclose(plane(back.positions), expected, atol=1e-8)
    np.testing.assert_allclose(back.time, planar["time"].unique(), atol=1e-9)
    assert back.labels[0] == "B_1"


def test_modelled_markers_read_back(exported) -> None:
    done = exported()
    back, markers = recording.read(done.file("_model.trc")), done.table("markers")
    assert np.isfinite(back.positions).all()
    np.testing.assert_allclose(plane(back.positions)[..., :2], grid(markers, "x", "y"), atol=1e-8)


def test_angles_read_back(exported) -> None:
    done = exported()
    time, angles = read_angles(done.file("_angles.mot"), ["joint_1_angle", "joint_2_angle"])
    states = done.table("states")
    for j in (1, 2):
        np.testing.assert_allclose(angles[f"joint_{j}_angle"], states[f"theta_{j}"], atol=1e-9)
    np.testing.assert_allclose(time, states["time"], atol=1e-9)


def test_states_and_torques_read_back(exported) -> None:
    done = exported()
    states, dynamics = done.table("states"), done.table("dynamics")
    table = recording.read_table(done.file("_states.sto"))
    assert not table.in_degrees
    np.testing.assert_allclose(table["/jointset/joint_2/joint_2_angle/speed"], states["dtheta_2"], rtol=1e-8)
    table = recording.read_table(done.file("_accelerations.sto"))
    np.testing.assert_allclose(table["joint_1_angle"], states["ddtheta_1"], rtol=1e-8)
    table = recording.read_table(done.file("_torques.sto"))
    np.testing.assert_allclose(table["joint_2_angle_moment"], dynamics["tau_2"], rtol=1e-8)


def test_forces_read_back_as_the_same_wrench(exported) -> None:
    """The independent reader of MOT files returns the same wrench."""
    done = exported()
    plate = recording.read(done.file(".trc"), done.file("_grf.mot")).plates[0]
    dynamics = done.table("dynamics").dropna(subset=["Fy"])
    assert len(plate.force) == len(dynamics)
    np.testing.assert_allclose(plate.force[:, 0], dynamics["Fx"], atol=1e-6)
    np.testing.assert_allclose(plate.force[:, 2], dynamics["Fy"], atol=1e-6)
    np.testing.assert_allclose(-plate.moment[:, 1], dynamics["tauz"], atol=1e-6)  # the plane's z is the reader's -y


def test_a_row_that_is_not_known_is_left_out_and_said() -> None:
    values = np.ones((6, 2))
    values[[0, 3], [1, 0]] = np.nan
    known, notes = find_known_rows("a.mot", values)
    assert known.tolist() == [False, True, True, False, True, True]
    assert "2 rows are left out" in notes[0]
    assert "1 of these" in notes[1]
    assert find_known_rows("a.mot", np.ones((3, 1)))[1] == ()
    assert not find_known_rows("a.mot", np.full((3, 1), np.nan))[0].any()


def test_no_exported_table_holds_a_nan(exported) -> None:
    """OpenSim's tools stop reading at the first one."""
    for done in (exported(), exported(False)):
        tables = [path for path in done.exported.files if path.suffix in (".mot", ".sto")]
        assert len(tables) >= 3
        assert not [path.name for path in tables if "nan" in path.read_text("utf-8").partition("endheader")[2]]


def test_force_point_and_moment_make_up_the_wrench_whatever_the_load() -> None:
    """The wrench about the origin is p × F + free moment; with a small force, the point keeps its last value."""
    wrench = np.array([[1.0, 100.0, 20.0], [2.0, 5.0, 3.0], [0.0, 0.0, 0.5], [-3.0, 200.0, -10.0]])
    acting = convert_planar_wrench(wrench, threshold=20.0)
    force, point, moment = acting[:, :3], acting[:, 3:6], acting[:, 6:]
    about = np.cross(point, force) + moment
    np.testing.assert_allclose(np.column_stack([force[:, :2], about[:, 2]]), wrench, atol=1e-12)
    np.testing.assert_allclose(about[:, :2], 0.0)
    np.testing.assert_allclose(point[:, 0], [0.2, 0.2, 0.2, -0.05])


def test_csv_has_a_unit_in_every_header_of_a_quantity(exported) -> None:
    done = exported()
    states = pd.read_csv(done.file("_states.csv"))
    np.testing.assert_array_equal(states["joint 2 velocity (rad/s)"], done.table("states")["dtheta_2"])
    dynamics = pd.read_csv(done.file("_dynamics.csv"))
    np.testing.assert_array_equal(dynamics["joint 1 torque (N*m)"], done.table("dynamics")["tau_1"])
    markers = pd.read_csv(done.file("_markers.csv"))
    assert "B 1 x (m)" in markers
    assert markers["L3 y (m)"].isna().sum() == done.table("planar").query("marker == 'L3'")["y"].isna().sum() == 30
    for table in (states, dynamics, markers):
        bare = {name for name in table if "(" not in str(name)}
        assert bare <= {"frame", "in_fit", "contact", "joint 1 observed", "joint 2 observed"}


def test_without_a_plate_what_exists_is_written_and_the_rest_said(exported) -> None:
    done = exported(False)
    written = {path.name.removeprefix(done.name) for path in done.exported.files}
    assert {".trc", "_angles.mot", "_states.sto", "_states.csv", ".osim", "_ik.xml"} <= written
    assert not written & {"_grf.mot", "_external_loads.xml", "_torques.sto", "_id.xml", "_wrench.sto"}
    said = " ".join(done.exported.notes)
    assert "mot: no forces: the recording has no force plates" in said
    assert "placeholders" in said
    assert "sto: no torques" in said


@pytest.mark.parametrize("names", [["joint 1", "joint/1", "joint\t1"], ["", "/"], ["a_2", "a", "a b", "a_b"]])
def test_names_become_legal_and_stay_apart(names: list[str]) -> None:
    given = make_legal(names)
    assert list(given) == names
    assert len(set(given.values())) == len(names)
    assert all(value and not set(value) & set("/ \t\\*+") for value in given.values())


def test_a_name_that_is_taken_is_not_given_away() -> None:
    assert make_legal(["ground", "base"], taken=("ground",)) == {"ground": "ground_2", "base": "base"}
