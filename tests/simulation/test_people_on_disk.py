"""Files of a simulated person of several bodies: markers, cohorts and commands."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.geometry import planar
from mocap_id_simulation import Cohort, Options, PersonOptions, generate, simulate, simulate_cohort
from mocap_id_simulation.options import read_people

ALL = PersonOptions(hip_gap_mm=14, lumbar_deg=15, arm_swing_deg=40, heel_lift_mm=10, held_mass_kg=2)
QUICK = Options(seed=3, repetitions=1, people=ALL, soft_tissue=0.0, marker_noise=0.0, occlusions=0.0)
BODIES = ["foot", "shank", "thigh", "pelvis", "trunk", "arms", "weight"]
TEXT = "hip_gap_mm=14, lumbar_deg=15, arm_swing_deg=40, heel_lift_mm=10, held_mass_kg=2"


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    return simulate("sit-to-stand", tmp_path_factory.mktemp("people") / "trial", QUICK).parent


def test_the_truth_tells_every_body(trial):
    truth = json.loads((trial / "truth.json").read_text())
    people = truth["people"]
    assert [body["name"] for body in people["bodies"]] == BODIES
    assert people["options"] == vars(ALL)
    assert people["tau_joints"] == ["ankle", "knee", "hip", "lumbar", "shoulder"]
    assert people["bodies"][-1]["m"] == 2
    assert sum(body["m"] for body in people["bodies"]) == pytest.approx(truth["total_mass"])
    assert truth["subject"]["mass_kg"] == pytest.approx(truth["total_mass"] - 2)
    frames = truth["n_frames"]
    shapes = {"body_pose": (7, 3), "body_velocity": (7, 3), "body_acceleration": (7, 3), "hip_gap_m": (2,)}
    with np.load(trial / "truth.npz") as arrays:
        for name, shape in {**shapes, "body_tau": (5,)}.items():
            assert arrays[name].shape == (frames, *shape), name
            assert arrays[name].dtype == np.float64
        np.testing.assert_allclose(arrays["tau"], arrays["body_tau"][:, :3], rtol=1e-6, atol=1e-4)
        np.testing.assert_allclose(arrays["seg_angle"], arrays["body_pose"][:, [1, 2, 4], 2], atol=1e-6)


def test_the_configuration_has_the_mass_of_the_person_alone(trial):
    truth = json.loads((trial / "truth.json").read_text())
    assert load(trial / "trial.yaml").keys.subject.mass == pytest.approx(truth["subject"]["mass_kg"], abs=0.006)


def test_markers_follow_the_bodies_that_the_truth_names(trial):
    truth = json.loads((trial / "truth.json").read_text())
    plane = truth["plane"]
    axes = np.array([plane[f"{name}_axis_lab"] for name in "xyz"])
    with np.load(trial / "truth.npz") as arrays:
        pose, seen = arrays["body_pose"], arrays["markers_true_mm"]
    flat = ((seen - plane["origin_lab_mm"]) @ axes.T / 1e3)[..., :2]
    for i, marker in enumerate(truth["markers"]):
        sits = truth["people"]["markers"][marker["label"]]
        local = np.array(sits["local_in_body_m"][:2])
        expected = np.broadcast_to(local, (len(pose), 2))
        if sits["body"] != "plate":
            body = pose[:, BODIES.index(sits["body"])]
            expected = body[:, :2] + planar.rotate(body[:, 2], local)
        np.testing.assert_allclose(flat[:, i], expected, atol=1e-6, err_msg=marker["label"])
    carried = {label: each["body"] for label, each in truth["people"]["markers"].items()}
    assert (carried["LWRA"], carried["RASI"], carried["C7"], carried["LSHO"]) == ("arms", "pelvis", "trunk", "trunk")
    assert (carried["LHEE"], carried["RTOE"], carried["PLT1"], carried["LANK"]) == ("foot", "foot", "plate", "shank")


def test_heel_markers_rise_and_the_plate_stands_still():
    made = generate("sit-to-stand", QUICK)
    height = 1e3 * np.ptp(made.positions[..., 2], axis=0)
    by_label = dict(zip(made.scene.markers.labels, height, strict=True))
    assert 6 < by_label["LHEE"] < 14
    assert by_label["LTOE"] < by_label["LHEE"] / 3
    assert by_label["PLT1"] == 0


def test_the_person_without_them_keeps_body_markers_and_plate():
    made, plain = (
        generate("sit-to-stand", Options(seed=3, repetitions=1, people=each)) for each in (ALL, PersonOptions())
    )
    assert plain.state.bodies is None
    np.testing.assert_array_equal(made.scene.markers.local, plain.scene.markers.local)
    assert made.scene.body.links[:3] == plain.scene.body.links[:3]
    assert made.scene.plane.yaw == plain.scene.plane.yaw


def test_a_robot_has_none_of_it(tmp_path):
    for name, people in (("a", ALL), ("b", PersonOptions())):
        simulate("robot", tmp_path / name / "trial", Options(seed=3, repetitions=1, people=people))
    for path in (tmp_path / "a" / "trial").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / "trial" / path.name).read_bytes()


def test_a_person_of_a_cohort_keeps_the_bodies(tmp_path):
    options = Options(seed=5, repetitions=1, analog_rate=100, people=ALL)
    study = simulate_cohort(tmp_path / "study", Cohort(1, ("normal", "stable"), 1, options))
    told = [json.loads(path.read_text())["people"] for path in sorted(study.parent.glob("truth/*/truth.json"))]
    assert told[0]["bodies"][3:] == told[1]["bodies"][3:]
    assert told[0]["ranges"] != told[1]["ranges"]


@pytest.mark.parametrize("what", ["sit-to-stand", "cohort"])
def test_the_commands_reach_them(cli, tmp_path, what):
    some = ["--subjects", 1, "--strategies", "normal"] if what == "cohort" else []
    assert cli("simulate", what, tmp_path / "made", "--repetitions", 1, *some, "--people", TEXT).code == 0
    (path,) = (tmp_path / "made").rglob("truth.json")
    assert json.loads(path.read_text())["people"]["options"] == vars(ALL)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hip_gap=3", "'hip_gap=3' is unknown or repeated; expected each of these names at most once: hip_gap_mm"),
        ("lumbar_deg=3,lumbar_deg=4", "'lumbar_deg=4' is unknown or repeated"),
        ("lumbar_deg", "`lumbar_deg` is ''; expected a number"),
        ("lumbar_deg=90", "`lumbar_deg` is 90.0; expected 0 … 40 degrees"),
    ],
)
def test_text_that_names_no_one_is_answered(text, said):
    with pytest.raises(ConfigError, match=said):
        read_people(text)


def test_the_chair_on_its_plate_a_rail_and_a_failed_rise_go_with_them():
    options = Options(seed=4, repetitions=2, people=ALL, seat_plate=True, rail=0.1, attempts=1, hold=0.5)
    made = generate("sit-to-stand", options)
    state = made.state
    (x, y), (fx, fy) = state.chair_point.T, state.chair_force.T
    on_rail = state.wrench_total[:, 1] - state.wrench[:, 1] - fy
    assert on_rail.min() + 1e-9 >= 0
    assert on_rail.max() > 40
    free = on_rail < 1e-9
    left = state.wrench_total[:, 2] - state.wrench[:, 2] - (x * fy - y * fx)
    assert np.abs(left[free]).max() < 1e-6
