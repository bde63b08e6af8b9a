"""Plates that miss a part of the load: a foot beside them, dead channels, missing moments, other recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import ezc3d
import numpy as np
import pytest

from mocap_id import recording
from mocap_id.errors import Refused
from mocap_id.kinematics.plane import fit_plane
from mocap_id.plates.choice import choose_plates, compare_courses
from mocap_id.plates.placement import find_foot_beside, find_standing_feet, measure_load_share
from mocap_id.recording import Plate, PlateSamples, PlateSignals, ThinnedFrames
from mocap_id.recording.lab_plates import compute_centre_of_pressure
from mocap_id.recording.sample_checks import find_upright
from mocap_id.stages.base import Context
from mocap_id.stages.planarise import STAGE, PlanariseSettings
from mocap_id.stages.planarise.wrenches import judge_course
from mocap_id.stages.trial_keys import Files, PlateUse, TrialKeys
from mocap_id.store import Table
from mocap_id_simulation import Options, generate
from mocap_id_simulation.options import FaultOptions
from mocap_id_simulation.space_robot import SpaceRobotOptions, generate_space_robot

RATE = 50.0
Change = Callable[[np.ndarray], np.ndarray]


@cache
def simulated(seed: int, strategy: str = "normal") -> tuple[tuple[str, ...], np.ndarray, PlateSignals]:
    options = Options(seed=seed, strategy=strategy, repetitions=2, rate=RATE, analog_rate=250.0)  # type: ignore[arg-type]
    made = generate("sit-to-stand", options)
    return made.scene.markers.labels, made.points, made.signals


@cache
def foot_centres(seed: int) -> tuple[np.ndarray, np.ndarray]:
    _, points, plate = simulated(seed)
    one, other = find_standing_feet(points, find_upright(points)[0], float(plate.corners[:, 2].mean()), 2)
    return one.mean(axis=0), other.mean(axis=0)


@cache
def placed_plate(seed: int) -> Plate:
    """Return the plate under both feet in lab axes."""
    with TemporaryDirectory() as folder:
        (plate,) = recording.read(write_trial(Path(folder) / "trial.c3d", seed, [simulated(seed)[2]])).plates
    return plate


def plate_of_foot(seed: int, foot: int, share: float) -> PlateSignals:
    """Return a plate under one foot that carries a share of the load there, with the true moment along the motion."""
    whole, placed = simulated(seed)[2], placed_plate(seed)
    centres = foot_centres(seed)
    across = (centres[1] - centres[0]) * [1, 1, 0]
    width = float(np.linalg.norm(across))
    across /= width
    along = np.array([across[1], -across[0], 0.0])
    middle = centres[foot] * [1, 1, 0] + [0, 0, whole.corners[:, 2].mean()]
    half = width / 2 - 0.005
    corners = middle + np.array([0.3 * along + half * across, -0.3 * along + half * across,
                                 -0.3 * along - half * across, 0.3 * along - half * across])  # fmt: skip
    axes = np.column_stack([along, across, np.cross(along, across)])
    if axes[2, 2] > 0:  # z of a plate points down
        corners = corners[[3, 2, 1, 0]]
        axes = np.column_stack([along, -across, np.cross(along, -across)])
    pressure = compute_centre_of_pressure(placed, placed)
    pressure = np.nan_to_num(pressure - middle[:2])
    pressure -= np.outer(pressure @ across[:2], across[:2])  # under the foot
    arm = np.column_stack([pressure, np.zeros(len(pressure))])
    force = share * placed.force
    channels = np.column_stack([force @ axes, np.cross(arm, force) @ axes])
    return PlateSignals(2, channels, np.zeros(3), corners, whole.rate)


def write_trial(
    path: Path, seed: int, plates: list[PlateSignals], towards: float = 0.0, leave_out: tuple[str, ...] = ()
) -> Path:
    """Write a trial; ``towards`` moves the upper body towards the second foot, by this share of the feet's distance."""
    labels, points, _ = simulated(seed)
    if towards:
        points = points.copy()
        one, other = foot_centres(seed)
        with np.errstate(invalid="ignore"):
            upper = np.nanmax(points[..., 2], axis=0) > 0.6
        points[:, upper] += towards * (other - one) * [1, 1, 0]
    kept = [k for k, label in enumerate(labels) if not label.startswith(leave_out)] if leave_out else range(len(labels))
    recording.write_c3d(path, [labels[k] for k in kept], points[:, kept], RATE, plates=plates)
    return path


def run_planarise(path: Path, plates: PlateUse | None = None, **more: Any) -> Table:
    more = {"protocol": "sit-to-stand"} | more
    keys = TrialKeys(trial="t", recording=Files(markers=path), plates=plates or PlateUse(), **more)
    wrench = STAGE.function(Context(keys, PlanariseSettings(), {}))[1]
    assert isinstance(wrench, Table)
    return wrench


def codes(wrench: Table) -> list[str]:
    return [reason.code for reason in wrench.reasons if reason.level != "ok"]


@pytest.mark.parametrize("seed", [31, 32])
@pytest.mark.parametrize("share", [0.35, 0.5, 0.65])
def test_two_feet_on_two_plates_are_no_fault_even_if_one_carries_more(tmp_path: Path, seed: int, share: float) -> None:
    plates = [plate_of_foot(seed, 0, share), plate_of_foot(seed, 1, 1 - share)]
    wrench = run_planarise(write_trial(tmp_path / "trial.c3d", seed, plates, towards=0.5 - share))
    assert codes(wrench) == []
    assert wrench.facts["registration"].get("foot_beside") is None


def spoil(plate: PlateSignals, gain: float) -> PlateSignals:
    return replace(plate, channels=gain * plate.channels)


@pytest.mark.parametrize(("foot", "gain"), [(0, 0.2248), (1, 0.5), (0, 2.0), (1, 4.448)])
def test_a_wrong_gain_of_one_of_two_plates_is_told_from_a_person_who_unloads_a_leg(
    tmp_path: Path, foot: int, gain: float
) -> None:
    """Pounds-force declared as newtons, and the like: the body stays in the middle between the feet."""
    seed = 31
    plates = [plate_of_foot(seed, k, 0.5) for k in (0, 1)]
    plates[foot] = spoil(plates[foot], gain)
    wrench = run_planarise(write_trial(tmp_path / "trial.c3d", seed, plates))
    assert codes(wrench) == ["load-uneven"]
    (reason,) = (each for each in wrench.reasons if each.code == "load-uneven")
    found = float(reason.message.split(" reads ")[1].split(" times")[0])
    assert found == pytest.approx(min(gain, 1 / gain), rel=0.2)
    assert reason.value == pytest.approx(min(gain, 1 / gain) / (1 + min(gain, 1 / gain)), abs=0.03)


@pytest.mark.parametrize("foot", [0, 1])
def test_a_person_who_unloads_a_leg_is_only_noted(tmp_path: Path, foot: int) -> None:
    seed = 31
    shares = [0.2, 0.8] if foot == 0 else [0.8, 0.2]
    plates = [plate_of_foot(seed, k, shares[k]) for k in (0, 1)]
    wrench = run_planarise(write_trial(tmp_path / "trial.c3d", seed, plates, towards=0.5 - shares[0]))
    assert codes(wrench) == []
    (reason,) = (each for each in wrench.reasons if each.code == "load-uneven")
    assert reason.level == "ok" and reason.value == pytest.approx(0.2, abs=0.03)


def test_without_markers_on_both_sides_both_explanations_are_named(tmp_path: Path) -> None:
    seed = 31
    plates = [plate_of_foot(seed, 0, 0.5), spoil(plate_of_foot(seed, 1, 0.5), 0.2248)]
    one_side = ("LFHD", "LBHD", "LSHO", "LUPA", "LELB", "LFRM", "LWR", "LFIN", "LASI", "LPSI", "LTHI", "LKNE")
    wrench = run_planarise(write_trial(tmp_path / "trial.c3d", seed, plates, leave_out=one_side))
    assert codes(wrench) == ["load-uneven"]
    (reason,) = (each for each in wrench.reasons if each.code == "load-uneven")
    assert "Either the person unloads this leg" in reason.message
    assert wrench.facts["registration"]["load_share"]["expected"] is None


@pytest.mark.parametrize(
    ("second", "code"),
    [(None, "foot-off-plate"), (0.2248, "load-uneven"), (1.0, None), ("moments", "plate-moments-missing")],
)
def test_plates_under_a_person_are_also_checked_in_space(
    tmp_path: Path, second: float | str | None, code: str | None
) -> None:
    plates = [plate_of_foot(31, k, 0.5) for k in (0, 1)]
    if second == "moments":
        plates[1] = replace(plates[1], channels=plates[1].channels * [1, 1, 1, 1e-3, 1e-3, 1e-3])
    elif second is None:
        del plates[1]
    else:
        plates[1] = spoil(plates[1], float(second))
    path = write_trial(tmp_path / "trial.c3d", 31, plates)
    assert codes(run_planarise(path, protocol="free", space="3d")) == ([] if code is None else [code])
    wrench = run_planarise(path, protocol="reach", space="3d", side="right")  # whose results do not need the plates
    assert codes(wrench) == []
    assert code is None or code in [reason.code for reason in wrench.reasons]


@pytest.mark.parametrize(
    ("gains", "code"),
    [
        ((1, 1, 1, 1, 1, 1), None),
        ((0, 1, 1, 1, 1, 1), "plate-channel-dead"),
        ((1, 1, 1, 1e-3, 1e-3, 1e-3), "plate-moments-missing"),
        ((-1, -1, 1, -1, -1, 1), "plate-turned"),
    ],
)
def test_the_plate_under_a_robot_in_space_is_checked(
    tmp_path: Path, gains: tuple[float, ...], code: str | None
) -> None:
    made = generate_space_robot(SpaceRobotOptions(seed=1, joints=2, duration=12, rate=60, analog_rate=600))
    plate = replace(made.signals, channels=made.signals.channels * gains)
    labels = [f"M{k}" for k in range(made.points.shape[1])]
    recording.write_c3d(tmp_path / "trial.c3d", labels, made.points, 60.0, plates=[plate])
    wrench = run_planarise(tmp_path / "trial.c3d", protocol="free", space="3d")
    assert codes(wrench) == ([] if code is None else [code])
    assert (wrench.facts["unusable"] is None) == (code in (None, "plate-turned"))
    assert wrench.columns["plate_ok"].any() == (wrench.facts["unusable"] is None)


def test_nobody_on_two_feet_leaves_the_plates_of_a_reach_unchecked(tmp_path: Path) -> None:
    one_foot = ("LHEE", "LTOE", "LANK")
    path = write_trial(tmp_path / "trial.c3d", 31, [simulated(31)[2]], leave_out=one_foot)
    wrench = run_planarise(path, protocol="reach", space="3d", side="right")
    assert codes(wrench) == []
    assert "plate-unchecked" in [reason.code for reason in wrench.reasons]


@pytest.mark.recordings
@pytest.mark.parametrize("gain", [(1.0, 1.0), (1.0, 0.2248), (0.5, 1.0)])
@pytest.mark.parametrize("name", ["STS1", "squats1", "static1"])
def test_the_two_plates_of_real_trials(recordings: Path, name: str, gain: tuple[float, float]) -> None:
    folder = recordings / "sit-to-stand"
    source = recording.read(folder / f"{name}.trc", folder / f"{name}_grf.mot")
    thinned = ThinnedFrames.of(source.positions, source.time, source.rate, source.plates)
    feet = choose_plates(source.plates, thinned.samples, thinned.positions).indices("feet")
    samples = [
        replace(thinned.samples[k], force=by * thinned.samples[k].force, moment=by * thinned.samples[k].moment)
        for k, by in zip(feet, gain, strict=True)
    ]
    share = measure_load_share([source.plates[k] for k in feet], samples, thinned.positions)
    assert share is not None and share.expected is not None
    away = abs(share.expected - share.measured)
    contradicts = away * share.width > 0.035 and away > 0.12
    assert contradicts == (gain != (1.0, 1.0))


@pytest.mark.parametrize("foot", [0, 1])
@pytest.mark.parametrize("fault", ["absent", "zero", "weak", "not used", "dead vertical", "dead moment"])
def test_a_foot_whose_plate_does_not_count_is_found(tmp_path: Path, foot: int, fault: str) -> None:
    seed, use = 31, PlateUse()
    measured, other = plate_of_foot(seed, foot, 0.5), plate_of_foot(seed, 1 - foot, 0.5)
    spoiled = other.channels.copy()
    if fault == "zero":
        spoiled *= 0
    elif fault == "weak":
        spoiled *= 0.03
    elif fault == "dead vertical":
        spoiled[:, 2] = 0.0
    elif fault == "dead moment":
        spoiled[:, 4] = 3.0
    elif fault == "not used":
        use = PlateUse(feet=(1,))
    plates = [measured] if fault == "absent" else [measured, replace(other, channels=spoiled)]
    wrench = run_planarise(write_trial(tmp_path / "trial.c3d", seed, plates), use)
    assert "foot-off-plate" in codes(wrench)
    (reason,) = (each for each in wrench.reasons if each.code == "foot-off-plate")
    labels = simulated(seed)[0]
    assert any(label in reason.message for label in labels)
    assert ("plate 2" in reason.message) == (fault != "absent")
    fact = wrench.facts["registration"]["foot_beside"]
    assert fact["beside_m"] > 0.05 and abs(fact["share"]) < 0.2


def test_without_corners_the_centre_of_pressure_decides(tmp_path: Path) -> None:
    seed = 31
    both = [plate_of_foot(seed, 0, 0.5), plate_of_foot(seed, 1, 0.5)]
    source = recording.read(write_trial(tmp_path / "trial.c3d", seed, both))
    thinned = ThinnedFrames.of(source.positions, source.time, source.rate, source.plates)
    plates = [replace(plate, corners=None) for plate in source.plates]
    assert find_foot_beside(plates, thinned.samples, thinned.positions) is None
    for k in (0, 1):
        found = find_foot_beside(plates[k : k + 1], thinned.samples[k : k + 1], thinned.positions)
        assert found is not None
        foot, beside, share = found
        assert np.isnan(beside) and abs(share) < 0.1
        away = [np.linalg.norm(foot.mean(axis=0) - centre) for centre in foot_centres(seed)]
        assert np.argmin(away) == 1 - k


def change_channels(tmp_path: Path, change: Change, seed: int = 33) -> Table:
    plate = simulated(seed)[2]
    changed = replace(plate, channels=change(plate.channels.copy()))
    return run_planarise(write_trial(tmp_path / "trial.c3d", seed, [changed]))


def set_to(value: float, *columns: int) -> Change:
    def change(channels: np.ndarray) -> np.ndarray:
        channels[:, list(columns)] = value
        return channels

    return change


@pytest.mark.parametrize("columns", [(3,), (4,), (3, 4), (2,)])
def test_a_dead_channel_that_is_needed_excludes_the_plate_and_is_named(
    tmp_path: Path, columns: tuple[int, ...]
) -> None:
    wrench = change_channels(tmp_path, set_to(0.7, *columns))
    assert codes(wrench) == ["no-plate"]
    assert all(f"(channel {column + 1})" in wrench.reasons[-1].message for column in columns)
    assert not wrench.columns["plate_ok"].any()


def test_moments_a_thousand_times_too_small_are_found_and_nothing_else_is_blamed(tmp_path: Path) -> None:
    wrench = change_channels(tmp_path, lambda channels: channels * [1, 1, 1, 1e-3, 1e-3, 1e-3])
    assert codes(wrench) == ["plate-moments-missing"]
    assert wrench.facts["mass_kg"] is not None
    assert not wrench.columns["plate_ok"].any()


def test_dead_horizontal_channels_leave_the_vertical_force(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(size=(100_000, 2))

    def only_noise(channels: np.ndarray) -> np.ndarray:
        channels[:, :2] = 0.3 * noise[: len(channels)]
        return channels

    for change in (set_to(0.0, 0, 1), only_noise):
        wrench = change_channels(tmp_path, change)
        assert codes(wrench) == ["plate-channel-dead"]
        assert np.isnan(wrench.columns["Fx"]).all() and wrench.columns["plate_ok"].mean() > 0.9
        assert wrench.facts["horizontal_measured"] is False
    wrench = change_channels(tmp_path, set_to(0.0, 5))  # the moment about the vertical
    assert codes(wrench) == [] and wrench.facts["horizontal_measured"] is True


def test_a_dead_channel_across_the_motion_is_a_note(tmp_path: Path) -> None:
    _, points, plate = simulated(33)
    along = np.array([np.cos(yaw := fit_plane(points).yaw), np.sin(yaw), 0.0])
    x = plate.corners[0] - plate.corners[1]
    across = 0 if abs(x @ along) / np.linalg.norm(x) < 0.2 else 1
    wrench = change_channels(tmp_path, set_to(0.0, across))
    if abs(abs(x @ along) / np.linalg.norm(x) - 0.5) > 0.45:  # the axes of the plate are those of the motion
        assert codes(wrench) == []
        assert "plate-channel-dead" in [reason.code for reason in wrench.reasons]


def vertical_force(seed: int, strategy: str = "normal") -> np.ndarray:
    _, points, plate = simulated(seed, strategy)
    force = np.abs(plate.channels[:, 2])
    return force[: len(points) * 5].reshape(-1, 5).mean(axis=1)


@pytest.mark.parametrize("late", [0, 5, 25, 45])
def test_own_forces_follow_the_body_even_if_they_are_late(late: int) -> None:
    _, points, _ = simulated(34)
    force = np.roll(vertical_force(34), late)
    force[:late] = np.nan
    course = compare_courses(force, points, RATE)
    assert course is not None
    assert course[0] > 0.9
    assert judge_course(course, [Path("a.trc")], Path("b.mot")) == ()


def test_forces_of_another_recording_are_refused() -> None:
    _, points, _ = simulated(34)
    force = np.interp(
        np.arange(len(points)), np.arange(len(vertical_force(35, "stable"))) + 60, vertical_force(35, "stable")
    )
    course = compare_courses(force, points, RATE)
    assert course is not None
    with pytest.raises(Refused, match=r"b\.mot and a\.trc do not belong together") as refused:
        judge_course(course, [Path("a.trc")], Path("b.mot"))
    assert refused.value.code == "forces-unrelated"


def test_a_person_who_hardly_moves_is_not_judged() -> None:
    _, points, _ = simulated(34)
    still = np.repeat(points[find_upright(points)[0]][:1], 200, axis=0)
    still = still + np.random.default_rng(2).normal(scale=2e-4, size=still.shape)
    force = 700.0 + np.random.default_rng(3).normal(size=200)
    assert judge_course(compare_courses(force, still, RATE), [Path("a.trc")], None) == ()


@pytest.mark.recordings
@pytest.mark.parametrize(("markers", "forces"), [("STS1", "squats1"), ("squats1", "STS1")])
def test_exchanged_recordings_are_refused(recordings: Path, markers: str, forces: str) -> None:
    folder = recordings / "sit-to-stand"
    files = Files(markers=folder / f"{markers}.trc", forces=folder / f"{forces}_grf.mot")
    trial = TrialKeys(trial="t", recording=files, protocol="sit-to-stand")
    with pytest.raises(Refused) as refused:
        STAGE.function(Context(trial, PlanariseSettings(), {}))
    assert refused.value.code == "forces-unrelated"


@pytest.mark.recordings
@pytest.mark.parametrize("kept", [0, 1])
def test_one_of_the_two_plates_of_a_real_trial(recordings: Path, kept: int, tmp_path: Path) -> None:
    folder = recordings / "sit-to-stand"
    lines = (folder / "STS1_grf.mot").read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("time"))
    columns = [0, *range(1 + 9 * kept, 10 + 9 * kept)]
    rows = ["\t".join(line.split()[column] for column in columns) for line in lines[head:] if line.strip()]
    path = tmp_path / "one.mot"
    path.write_text(f"one\nversion=1\nnRows={len(rows) - 1}\nnColumns=10\ninDegrees=yes\nendheader\n" + "\n".join(rows))
    trial = TrialKeys(trial="t", recording=Files(markers=folder / "STS1.trc", forces=path), protocol="sit-to-stand")
    wrench = STAGE.function(Context(trial, PlanariseSettings(), {}))[1]
    assert isinstance(wrench, Table)
    assert "foot-off-plate" in codes(wrench)


def test_a_channel_of_another_plate_excludes_the_plate(tmp_path: Path) -> None:
    path = write_trial(tmp_path / "trial.c3d", 31, [plate_of_foot(31, k, 0.5) for k in (0, 1)])
    content = ezc3d.c3d(str(path))
    channels = content["parameters"]["FORCE_PLATFORM"]["CHANNEL"]["value"]
    channels[2, 1] = channels[2, 0]  # Fz of the first plate
    content.write(str(path))
    wrench = run_planarise(path)
    assert "foot-off-plate" in codes(wrench)
    assert any("names the channels [3] also for plate 1" in reason.message for reason in wrench.reasons)


def test_plates_without_load_are_not_judged() -> None:
    _, points, _ = simulated(34)
    nothing = np.zeros((len(points), 3))
    source = PlateSamples(nothing, nothing, np.ones(len(points), bool))
    plate = Plate(1, "mot", None, nothing, nothing, source.ok, RATE)
    assert find_foot_beside([plate], [source], points) is None
    assert compare_courses(nothing[:, 2], points, RATE) is None or judge_course(None, [], None) == ()


@pytest.mark.recordings
def test_a_sum_of_two_sensors_in_one_channel_leaves_the_other_unused(recordings: Path) -> None:
    """Plates of type 3 that write Fx of all sensors in the first channel and 0 in the second."""
    plates = recording.read(recordings / "c3d" / "kyowadengyo.c3d").plates
    assert [(plate.usable, plate.dead) for plate in plates] == [(True, ())] * 3


def test_a_person_who_leans_on_one_foot_on_a_plate_under_both_is_no_fault(tmp_path: Path) -> None:
    made = generate(
        "sit-to-stand",
        Options(seed=36, repetitions=2, rate=RATE, analog_rate=250.0, faults=FaultOptions(plane_tilt_deg=8.0)),
    )
    path = tmp_path / "trial.c3d"
    recording.write_c3d(path, list(made.scene.markers.labels), made.points, RATE, plates=[made.signals])
    assert "foot-off-plate" not in codes(run_planarise(path))


def test_repeated_frames_do_not_separate_forces_and_markers() -> None:
    options = Options(seed=37, repetitions=2, rate=RATE, analog_rate=250.0, faults=FaultOptions(repeated_share=0.5))
    made = generate("sit-to-stand", options)
    vertical = np.abs(made.signals.channels[:, 2])[: 5 * len(made.points)].reshape(-1, 5).mean(axis=1)
    course = compare_courses(vertical, made.points, RATE)
    assert judge_course(course, [Path("a.trc")], None) == ()


def test_a_lifted_object_does_not_separate_forces_and_markers() -> None:
    """A box on the floor and on a table has the largest movements of all markers."""
    _, points, _ = simulated(34)
    time = np.arange(len(points)) / RATE
    corners = np.array([[0.4, 0.0, 0.0], [0.8, 0.0, 0.0], [0.4, 0.4, 0.0], [0.8, 0.4, 0.3]])
    box = corners + np.array([0.0, 0.0, 1.0]) * np.clip(3 * np.sin(2 * np.pi * time / 5), -1, 1)[:, None, None]
    course = compare_courses(vertical_force(34), np.concatenate([points, box], axis=1), RATE)
    assert course is not None and course[0] > 0.9


def test_a_chair_behind_one_marked_foot_is_no_second_foot() -> None:
    foot = np.array([[0.0, 0.0, 0.04], [0.18, 0.0, 0.04], [0.05, 0.03, 0.08]])
    legs = np.array([[0.05, 0.0, 0.45], [0.05, 0.0, 0.9], [0.0, 0.0, 1.3]])
    chair = foot[:2] - [0.40, 0.0, 0.0]
    marked = np.repeat(np.concatenate([foot, legs, chair])[None], 300, axis=0)
    force = np.tile([0.0, 0.0, 700.0], (300, 1))
    sample = PlateSamples(force, np.cross(foot.mean(axis=0), force), np.ones(300, bool))
    plate = Plate(1, "mot", None, force, sample.moment, sample.ok, RATE)
    assert find_foot_beside([plate], [sample], marked) is None
    beside = np.repeat(np.concatenate([foot, legs, foot + np.array([0.0, 0.22, 0.0])])[None], 300, axis=0)
    assert find_foot_beside([plate], [sample], beside) is not None
