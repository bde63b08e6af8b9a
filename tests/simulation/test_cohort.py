"""A simulated cohort: different but consistent persons, repeatable files, and a study that runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_id import runner
from mocap_id.config.study import load_study
from mocap_id.errors import ConfigError, StoreError
from mocap_id.geometry import planar
from mocap_id.recording import read
from mocap_id.store import Folder
from mocap_id_simulation import Cohort, Options, generate, simulate_cohort
from mocap_id_simulation.bodies import draw_subject_skin_motion
from mocap_id_simulation.options import draw_subject
from mocap_id_simulation.studies import cohort_trials

SHORT = Options(seed=5, repetitions=1, analog_rate=100)
SMALL = Cohort(subjects=2, strategies=("normal", "stable"), options=SHORT)


@pytest.fixture(scope="module")
def cohort(tmp_path_factory) -> Path:
    return simulate_cohort(tmp_path_factory.mktemp("cohort") / "study", SMALL)


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.*")}


def truth(study: Path, trial: str) -> dict:
    return json.loads((study.parent / "truth" / trial / "truth.json").read_text())


def test_the_same_seed_gives_the_same_files(cohort, tmp_path):
    again = files(simulate_cohort(tmp_path / "again", SMALL).parent)
    assert again == files(cohort.parent)
    assert {"study.yaml", "s02/stable-1.c3d", "truth/s01-normal-1/truth.npz"} < set(again)
    assert len(again) == 1 + 3 * 4


def test_what_is_added_leaves_the_rest_alone(cohort, tmp_path):
    more = Cohort(subjects=1, strategies=("dynamic", "stable"), trials=2, options=SHORT)
    made = files(simulate_cohort(tmp_path / "more", more).parent)
    shared = set(made) & set(files(cohort.parent)) - {"study.yaml"}
    assert len(shared) == 3
    assert all(made[name] == (cohort.parent / name).read_bytes() for name in shared)
    assert made["s01/stable-1.c3d"] != made["s01/stable-2.c3d"]


def test_another_seed_gives_other_persons(tmp_path):
    one, other = (next(cohort_trials(Cohort(options=replace(SHORT, seed=seed)))) for seed in (5, 6))
    assert one.person["height"] != other.person["height"]
    assert one.options.seed != other.options.seed


def test_persons_differ_and_keep_themselves(cohort):
    kept = ("total_mass", "segment_lengths_m", "subject_seed")
    bodies = {name: truth(cohort, name) for name in ("s01-normal-1", "s01-stable-1", "s02-normal-1")}
    first, again, other = bodies.values()
    for key in kept:
        assert first[key] == again[key] != other[key]
    for one, two in zip(first["segments"][1:], again["segments"][1:], strict=True):
        assert {key: one[key] for key in ("m", "mx", "my", "Izz")} == {
            key: two[key] for key in ("m", "mx", "my", "Izz")
        }
    assert first["seed"] != again["seed"]
    assert first["plane"]["yaw_deg"] != again["plane"]["yaw_deg"]


def test_the_feet_stand_elsewhere_and_are_the_same(cohort):
    first, again = (truth(cohort, f"s01-{strategy}-1") for strategy in ("normal", "stable"))
    moved = again["segments"][1]["p_in_parent_m"][0] - first["segments"][1]["p_in_parent_m"][0]
    assert 1e-4 < abs(moved) <= 0.06
    foot = [
        np.array([m["local_xyz_m"] for m in one["markers"] if m["label"][1:] in ("HEE", "TOE")])
        for one in (first, again)
    ]
    np.testing.assert_allclose(foot[1][:, 0] - foot[0][:, 0], moved, atol=1e-3)  # skin: 0.3 mm
    assert again["segments"][0]["cx"] - first["segments"][0]["cx"] == pytest.approx(moved)


def test_markers_stay_where_they_were_glued(cohort):
    first, again, other = (truth(cohort, name)["markers"] for name in ("s01-normal-1", "s01-stable-1", "s02-normal-1"))
    apart = [
        [np.subtract(a["local_xyz_m"], b["local_xyz_m"]) for a, b in zip(first, two, strict=True) if a["segment"]]
        for two in (again, other)
    ]
    soft = np.array([marker["sta_amplitude_m"] for marker in first if marker["segment"]])
    assert (np.linalg.norm(apart[0], axis=1) < soft).all()  # their means differ as the skin's do
    assert (np.linalg.norm(apart[1], axis=1) > soft).sum() > 30


def test_skin_slides_alike_in_every_motion(monkeypatch):
    """Without drift, the skin depends only on the angles: a part of a motion has the same displacements."""
    monkeypatch.setattr("mocap_id.anatomy.frames.WANDER", 0.0)
    made = generate("sit-to-stand", SHORT)
    q, time, markers = made.state.q, made.state.time, made.scene.markers

    def places(part: slice) -> np.ndarray:
        rng = (np.random.default_rng(1), np.random.default_rng(2))
        moved, placed = draw_subject_skin_motion(*rng, markers, q[part], time[part])
        return placed.local + moved

    np.testing.assert_allclose(places(slice(100, 250)), places(slice(None))[100:250], atol=1e-15)


def test_truth_is_what_was_recorded(cohort):
    """The markers' mean positions, computed from the truth's arrays, agree with the truth's document."""
    told = truth(cohort, "s02-stable-1")
    with np.load(cohort.parent / "truth" / "s02-stable-1" / "truth.npz") as arrays:
        q, lab = arrays["q"].astype(float), arrays["markers_true_mm"] / 1e3
    recorded = read(cohort.parent / "s02" / "stable-1.c3d").positions
    assert np.nanstd(recorded - lab) == pytest.approx(0.0005, rel=0.05)
    plane = told["plane"]
    flat = (lab - np.array(plane["origin_lab_mm"]) / 1e3) @ np.array([plane["x_axis_lab"], plane["y_axis_lab"]]).T
    centres = np.array([segment["p_in_parent_m"] for segment in told["segments"][1:]])
    angle, origin = planar.segment_poses(q, centres)
    link = np.array([marker["segment"] for marker in told["markers"]])
    local = planar.rotate(-angle[:, link], flat - origin[:, link]).mean(axis=0)
    np.testing.assert_allclose(local, [marker["local_xyz_m"][:2] for marker in told["markers"]], atol=1e-6)


def test_sizes_of_both_sexes():
    drawn = [draw_subject(3, number) for number in range(1, 101)]
    assert len({subject.seed for subject in drawn}) == 100
    assert {subject.sex for subject in drawn[::2]} == {"female"}
    assert {subject.sex for subject in drawn[1::2]} == {"male"}
    assert all(19 <= subject.mass / subject.height**2 <= 29 for subject in drawn)
    women, men = ([s.height for s in drawn if s.sex == sex] for sex in ("female", "male"))
    assert 1.52 <= min(women) < max(women) <= 1.76
    assert 1.64 <= min(men) < max(men) <= 1.92


def test_the_study_is_ready_and_a_trial_of_it_runs(cohort, tmp_path):
    study = load_study(cohort)
    names = ["s01-normal-1", "s01-stable-1", "s02-normal-1", "s02-stable-1"]
    assert [each.trial.name for each in study.trials] == names
    assert [(each.subject, each.strategy) for each in study.trials][2] == ("s02", "normal")
    trial, person = study.trials[2].trial, study.subjects["s02"]
    told = truth(cohort, trial.name)
    assert person.height == pytest.approx(told["subject"]["height_m"], abs=1e-3)
    assert person.mass == pytest.approx(told["total_mass"], abs=1e-2)
    true = {name: told["segment_lengths_m"][name] for name in ("shank", "thigh")}
    assert person.landmarks_m.model_dump() == pytest.approx(true, abs=1e-4)
    outcome = runner.run_to(replace(trial, out=tmp_path), "identify-dim")
    assert outcome.refused is None
    dynamics = Folder(outcome.folder).read("dynamics.h5")
    assert dynamics.facts["why"] is None
    assert dynamics.data["base"]["value"][0] == pytest.approx(told["total_mass"], rel=0.01)
    events = Folder(outcome.folder).read("events.parquet").frame
    assert events["seat_off"].to_numpy() == pytest.approx(told["seat_off_s"], abs=0.06)


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("")
    with pytest.raises(StoreError, match="is not empty: choose a new folder"):
        simulate_cohort(tmp_path, SMALL)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"subjects": 0}, "`subjects` is 0; expected 1 … 999"),
        ({"trials": 0}, "`trials` is 0"),
        ({"strategies": ("normal", "slow")}, "`strategies` is 'normal,slow'; expected some of normal, dynamic, stable"),
        ({"strategies": ()}, "`strategies` is ''"),
        ({"strategies": ("stable", "stable")}, "expected each strategy only once"),
    ],
)
def test_a_value_out_of_range_is_named_for_a_cohort(change, said):
    with pytest.raises(ConfigError, match=said):
        replace(SMALL, **change)
