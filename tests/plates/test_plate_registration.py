"""Checks of the position of plates: their laws, and moved plates in copies of good recordings."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_id import recording
from mocap_id.kinematics.base_motion import propose_window
from mocap_id.plates.choice import choose_plates, compare_directions
from mocap_id.plates.placement import compare_with_feet, find_standing_feet, measure_lean, measure_outside
from mocap_id.recording import Plate, PlateSamples, Recording
from mocap_id.recording.lab_plates import compute_centre_of_pressure, compute_plate_axes
from mocap_id.stages.base import Context, Findings
from mocap_id.stages.planarise import STAGE, PlanariseSettings
from mocap_id.stages.planarise.wrenches import check_registration
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id_simulation import Options, generate

SEEDS = (21, 22)
GOOD = ("sit-to-stand/STS1.trc", "sit-to-stand/squats1.trc", "sit-to-stand/static1.trc", "c3d/Sample_Static.c3d",
        "c3d/c3dfile1.c3d", "simulated/sts-normal/trial.c3d", "simulated/sts-dynamic/trial.c3d",
        "simulated/sts-stable-rotated-plate/trial.c3d", "simulated/sts-normal-clean/trial.c3d")  # fmt: skip


@cache
def simulated(seed: int) -> tuple[tuple[str, ...], np.ndarray, recording.PlateSignals]:
    """Return labels, positions and plate of a person on a plate with usual errors and biases."""
    made = generate("sit-to-stand", Options(seed=seed, repetitions=2, plate_moved=True, plate_bias=1.0))
    return made.scene.markers.labels, made.points, made.signals


def written(folder: Path, seed: int, move: Callable[[np.ndarray], np.ndarray]) -> Path:
    """Write the trial to a file in which only the corners of the plate are moved."""
    labels, points, plate = simulated(seed)
    path = folder / "trial.c3d"
    recording.write_c3d(path, list(labels), points, 100.0, plates=[replace(plate, corners=move(plate.corners))])
    return path


def codes_of_file(path: Path) -> list[str]:
    trial = TrialKeys(trial="t", recording=Files(markers=path), protocol="sit-to-stand")
    _, wrench = STAGE.function(Context(trial, PlanariseSettings(), {}))
    assert wrench.facts["registration"]["plates"][0]["index"] == 1
    return [reason.code for reason in wrench.reasons if reason.code.startswith("plate-")]


def about_centre(axis: str, degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    rotation = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda corners: (corners - corners.mean(axis=0)) @ rotation.T + corners.mean(axis=0)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_plate_in_the_right_position_has_no_caution(tmp_path: Path, seed: int) -> None:
    assert codes_of_file(written(tmp_path, seed, lambda corners: corners)) == []


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("direction", range(0, 360, 60))
def test_a_far_displacement_is_found_in_every_direction(tmp_path: Path, seed: int, direction: int) -> None:
    """25 cm move the centre of pressure of two feet outside their outline in every direction."""
    way = np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction)), 0.0])
    assert "plate-misplaced" in codes_of_file(written(tmp_path, seed, lambda corners: corners + 0.25 * way))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_limit_is_a_distance_from_the_outline(tmp_path: Path, seed: int) -> None:
    """The caution appears when the distance from the outline exceeds the limit, and gives the distance."""
    path = written(tmp_path, seed, lambda corners: corners)
    source = recording.read(path)
    distances = []
    for shift in np.arange(0.0, 0.4, 0.02):
        found = checked(source, lambda plate, shift=shift: moved(plate, shift=(shift, 0.0, 0.0)))
        (fact,) = found.facts["plates"]
        told = [reason for reason in found.reasons if reason.code == "plate-misplaced"]
        assert bool(told) == (fact["cop_off_feet_m"] > fact["cop_off_feet_limit_m"])
        distances.append(fact["cop_off_feet_m"])
    assert distances[0] < 0.0 < distances[-1]
    np.testing.assert_allclose(np.diff(distances)[-3:], 0.02, atol=0.006)  # outside the feet


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("degrees", [90, 180])
def test_a_plate_turned_about_the_vertical_is_found(tmp_path: Path, seed: int, degrees: int) -> None:
    assert "plate-turned" in codes_of_file(written(tmp_path, seed, about_centre("z", degrees)))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("degrees", [-3.0, 3.0])
def test_corners_that_tilt_a_level_plate_are_found(tmp_path: Path, seed: int, axis: str, degrees: float) -> None:
    assert codes_of_file(written(tmp_path, seed, about_centre(axis, degrees))) == ["plate-tilted"]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_tilted_plate_with_level_corners_is_found_by_the_stance(tmp_path: Path, seed: int) -> None:
    source = recording.read(written(tmp_path, seed, lambda corners: corners))
    found = checked(source, lambda plate: replace(moved(plate, axis="x", degrees=3.0), corners=plate.corners))
    (reason,) = found.reasons
    assert reason.code == "plate-tilted"
    assert reason.value == pytest.approx(3.0, abs=0.8)  # a bias of 3 N in 600 is 0.3°


@pytest.mark.parametrize("seed", SEEDS)
def test_a_plate_with_inclined_corners_and_force_is_a_note(tmp_path: Path, seed: int) -> None:
    source = recording.read(written(tmp_path, seed, lambda corners: corners))
    found = checked(source, lambda plate: replace(plate, corners=about_centre("y", 3.0)(plate.corners)))
    assert [(reason.code, reason.level) for reason in found.reasons] == [("plate-tilted", "ok")]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_plate_above_the_feet_is_found(tmp_path: Path, seed: int) -> None:
    assert "plate-height" in codes_of_file(written(tmp_path, seed, lambda corners: corners + np.array([0, 0, 0.06])))


@pytest.mark.parametrize("name", GOOD)
def test_good_recordings_have_no_caution(recordings: Path, name: str) -> None:
    found = checked(read(recordings, name))
    assert found.reasons == []
    assert all(fact["cop_off_feet_m"] is not None for fact in found.facts["plates"])


@pytest.mark.parametrize(
    ("name", "plate", "shift"),
    [
        ("sit-to-stand/STS1.trc", 0, 0.10),
        ("sit-to-stand/STS1.trc", 1, 0.10),
        ("sit-to-stand/squats1.trc", 0, 0.14),
        ("sit-to-stand/squats1.trc", 1, 0.14),
        ("sit-to-stand/static1.trc", 0, 0.18),
        ("c3d/c3dfile1.c3d", 0, 0.16),
        ("c3d/Sample_Static.c3d", 0, 0.26),
    ],
)
def test_a_moved_plate_of_a_real_recording_is_found(recordings: Path, name: str, plate: int, shift: float) -> None:
    """Smaller displacements are found with one foot per plate than with both feet on one plate."""
    source = read(recordings, name)
    for direction in range(0, 360, 45):
        way = shift * np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction)), 0.0])
        found = checked(source, lambda each, way=way: moved(each, shift=way), only=plate)
        assert "plate-misplaced" in [reason.code for reason in found.reasons], direction


def test_only_the_direction_is_checked_for_a_robot(recordings: Path) -> None:
    source = read(recordings, "simulated/ur5-elbow-fast/trial.c3d")
    assert checked(source, person=False).reasons == []
    turned_ = checked(source, lambda plate: moved(plate, axis="z", degrees=180.0), person=False)
    assert [reason.code for reason in turned_.reasons] == ["plate-turned"]
    assert turned_.facts["plates"] == []


def test_walking_is_not_checked(recordings: Path) -> None:
    """In walking no foot stands still, so nothing is checked, and a note says so."""
    found = checked(read(recordings, "c3d/walking5.c3d"))
    assert [(reason.code, reason.level) for reason in found.reasons] == [("plate-unchecked", "ok")]
    assert all(fact["cop_off_feet_m"] is None for fact in found.facts["plates"])


@cache
def standing(seat: bool = False) -> tuple[list[str], np.ndarray, list[Plate], list[PlateSamples]]:
    """Return labels, positions, plates and wrenches of a simulated sit-to-stand."""
    with TemporaryDirectory() as folder:
        made = generate("sit-to-stand", Options(seed=23, repetitions=2, analog_rate=100, seat_plate=seat))
        signals = [each for each in (made.signals, made.seat_signals) if each is not None]
        recording.write_c3d(Path(folder) / "trial.c3d", made.labels, made.points, 100.0, plates=signals)
        source = recording.read(Path(folder) / "trial.c3d")
    found = [recording.decimate(plate, source.time, source.rate) for plate in source.plates]
    return list(source.labels), source.positions, list(source.plates), found


FEET = ("LHEE", "LTOE", "LANK", "RHEE", "RTOE", "RANK")


@pytest.mark.parametrize(
    "kept", [kept for count in range(len(FEET) + 1) for kept in itertools.combinations(FEET, count)]
)
def test_foot_markers_that_show_no_outline_give_a_note(kept: tuple[str, ...]) -> None:
    """No choice of foot markers gives a false alarm; all of them are a check, and one foot alone is none."""
    labels, positions, plates, samples = standing()
    used = [k for k, label in enumerate(labels) if label in kept or label not in FEET]
    codes = [
        reason.code for reason in check_registration(plates, samples, positions[:, used], 100.0, person=True)[0].reasons
    ]
    assert codes in ([], ["plate-unchecked"])
    if len(kept) == len(FEET):
        assert codes == []
    if {each[0] for each in kept} != {"L", "R"}:
        assert codes == ["plate-unchecked"]


def test_a_chair_on_the_plate_of_the_feet_is_no_misplacement() -> None:
    """The seated person's centre of pressure is far behind the feet; a moved plate is still found."""
    labels, positions, plates, (feet, seat) = standing(seat=True)
    heel, toe = (np.nanmean(positions[:, labels.index(name)], axis=0) for name in ("LHEE", "LTOE"))
    behind = 0.3 * (heel - toe) / np.linalg.norm(heel - toe)
    moment = feet.moment + seat.moment + np.cross(behind, seat.force)
    both = replace(feet, force=feet.force + seat.force, moment=moment)
    pressure = compute_centre_of_pressure(plates[0], both)
    behind_heels = (pressure - heel[:2]) @ behind[:2] / 0.3
    assert np.mean(behind_heels > 0.1) > 0.2
    assert check_registration(plates[:1], [both], positions, 100.0, person=True)[0].reasons == []
    away = np.cross([0.0, 0.3, 0.0], both.force)
    other = replace(both, moment=both.moment + away)
    moved_ = check_registration(plates[:1], [other], positions, 100.0, person=True)[0]
    assert "plate-misplaced" in [reason.code for reason in moved_.reasons]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bolted_robot_is_no_misplaced_plate(tmp_path: Path, seed: int) -> None:
    """Bolts can pull, so the force may act beside the base, also if the protocol does not say that it is a robot."""
    made = generate("robot", Options(seed=seed, repetitions=3, analog_rate=100))
    recording.write_c3d(tmp_path / "trial.c3d", made.labels, made.points, 100.0, plates=[made.signals])
    assert [reason.code for reason in checked(recording.read(tmp_path / "trial.c3d")).reasons] == ["plate-unchecked"]


def test_the_distance_from_a_hull() -> None:
    """Agrees with the distance to a circle that the points approximate."""
    circle = np.stack([np.cos(np.linspace(0, 2 * np.pi, 400)), np.sin(np.linspace(0, 2 * np.pi, 400))], axis=1)
    points = np.random.default_rng(0).normal(size=(50, 2)) * 2
    np.testing.assert_allclose(measure_outside(points, circle), np.linalg.norm(points, axis=1) - 1, atol=2e-3)
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(measure_outside(np.array([[0.5, 0.3], [1.4, 0.3]]), line), [0.3, 0.5], atol=1e-3)


def test_markers_on_plate_and_floor_are_not_feet() -> None:
    foot = np.array([[0.0, 0.0, 0.03], [0.1, 0.0, 0.04], [0.2, 0.02, 0.03]])
    leg = np.array([[0.05, 0.0, 0.3], [0.05, 0.0, 0.45]])
    plate = np.array([[-0.2, -0.2, 0.004], [0.2, 0.3, 0.004]])
    floor = np.array([[2.0, 2.0, 0.03], [2.1, 2.0, 0.03]])
    positions = np.tile(np.concatenate([foot, leg, plate, floor]), (50, 1, 1))
    (found,) = find_standing_feet(positions, np.ones(50, bool), 0.0, 1)
    np.testing.assert_allclose(found[np.argsort(found[:, 0])], foot)
    assert find_standing_feet(positions[:, 3:], np.ones(50, bool), 0.0, 1) == []


def test_the_force_points_along_the_acceleration() -> None:
    """Holds for any rotation of the plate, even with wrong masses of the parts."""
    time = np.arange(0, 10, 0.01)
    low, high = 0.02 * np.sin(3 * time), 0.3 * np.sin(2 * time + 0.4)
    positions = np.zeros((len(time), 4, 3))
    positions[:, :, 2] = [0.1, 0.2, 1.4, 1.5]
    positions[:, :2, 0], positions[:, 2:, 0] = low[:, None], high[:, None]
    along = -20 * 9 * low - 50 * 4 * high
    for degrees in (-170, -35, 0, 60, 180):
        angle = np.radians(degrees)
        force = np.stack([along * np.cos(angle), along * np.sin(angle), np.full_like(along, 700.0)], axis=1)
        found = compare_directions(force, positions, 100.0)
        assert np.degrees(found.angle) == pytest.approx(degrees)
        assert found.coherence > 0.999


def test_without_enough_data_there_is_no_result() -> None:
    positions, force = np.zeros((300, 3, 3)), np.full((300, 3), np.nan)
    assert compare_directions(force, positions, 100.0) is None
    assert measure_lean(force, positions, 100.0) is None
    assert compare_with_feet([], [], positions) == []
    found, *unusable = check_registration([], [], positions, 100.0, person=True)
    assert (found.facts, found.reasons, unusable) == ({}, [], [None, True])


@cache
def read(recordings: Path, name: str) -> Recording:
    path = recordings / name
    return recording.read(path, path.with_name(f"{path.stem}_grf.mot") if path.suffix == ".trc" else None)


def moved(plate: Plate, shift: tuple[float, float, float] = (0, 0, 0), axis: str = "z", degrees: float = 0.0) -> Plate:
    """Return the plate as read from a file with rotated and shifted corners."""
    centre = np.zeros(3) if plate.centre is None else plate.centre
    rotation = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    force = plate.force @ rotation.T
    about = (plate.moment - np.cross(centre, plate.force)) @ rotation.T
    corners = None if plate.corners is None else (plate.corners - centre) @ rotation.T + centre + shift
    return replace(plate, force=force, moment=about + np.cross(centre + shift, force), corners=corners)


def test_moving_a_plate_equals_moving_its_corners(tmp_path: Path) -> None:
    """The helper above agrees with reading a changed file."""
    plain = recording.read(written(tmp_path, 21, lambda corners: corners)).plates[0]
    turn = about_centre("z", 30.0)
    (plate,) = recording.read(written(tmp_path, 21, lambda corners: turn(corners) + np.array([0.1, 0, 0]))).plates
    expected = moved(plain, (0.1, 0.0, 0.0), "z", 30.0)
    np.testing.assert_allclose(plate.force, expected.force, atol=1e-3)
    np.testing.assert_allclose(plate.moment, expected.moment, atol=1e-3)
    assert compute_plate_axes(plate.corners)[2, 2] == pytest.approx(-1.0)


def checked(
    source: Recording, move: Callable[[Plate], Plate] = lambda plate: plate, *, only: int = -1, person: bool = True
) -> Findings:
    """Check a recording with one or all of the plates under the feet moved."""
    first, stop = propose_window(source.positions, source.rate)
    part = slice(first, stop, max(1, round(source.rate / 120)))
    positions, time = source.positions[part], source.time[part]
    rate = 1.0 / float(np.median(np.diff(time)))
    use = choose_plates(source.plates, [recording.decimate(plate, time, rate) for plate in source.plates], positions)
    moved = [move(source.plates[i]) if only in (-1, k) else source.plates[i] for k, i in enumerate(use.indices("feet"))]
    samples = [recording.decimate(plate, time, rate) for plate in moved]
    return check_registration(moved, samples, positions, rate, person=person)[0]
