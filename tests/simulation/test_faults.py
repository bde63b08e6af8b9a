"""Faults, rests and marker sets of simulated trials: each does what its name says, and nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_id.errors import ConfigError
from mocap_id.recording import read
from mocap_id_simulation import Options, SimulatedTrial, generate, simulate
from mocap_id_simulation.options import FaultOptions, read_faults

SHORT = Options(seed=3, repetitions=2, analog_rate=100)


def made(faults: str = "", **options: object) -> SimulatedTrial:
    return generate("sit-to-stand", replace(SHORT, faults=read_faults(faults), **options))


def test_without_faults_nothing_changes() -> None:
    plain, other = generate("sit-to-stand", SHORT), made("frozen_s=0")
    np.testing.assert_array_equal(plain.points, other.points)
    np.testing.assert_array_equal(plain.signals.channels, other.signals.channels)


def test_a_frozen_marker_stands_still_and_the_truth_names_it() -> None:
    trial, good = made("frozen_s=3"), made()
    frozen = trial.fault_truth["frozen"]
    marker = trial.labels.index(frozen["label"])
    inside = slice(frozen["first_frame"], frozen["first_frame"] + frozen["n_frames"])
    assert frozen["n_frames"] == 300
    assert np.ptp(trial.points[inside, marker], axis=0).max() == 0
    others = np.delete(np.arange(len(trial.labels)), marker)
    np.testing.assert_array_equal(trial.points[:, others], good.points[:, others])


def test_ghosts_are_additional_trajectories() -> None:
    trial = made("ghost_walks=1,ghost_reflects=1")
    assert trial.labels[-2:] == ("GHOST1", "GHOST2")
    assert trial.points.shape[1] == len(trial.scene.markers.labels) + 2


def test_exchanged_markers_have_each_other_s_positions() -> None:
    trial, good = made("mislabelled_s=1"), made()
    swap = trial.fault_truth["mislabelled"]
    one, other = (trial.labels.index(label) for label in swap["labels"])
    inside = slice(swap["first_frame"], swap["first_frame"] + swap["n_frames"])
    np.testing.assert_array_equal(trial.points[inside, one], good.points[inside, other])


@pytest.mark.parametrize(
    ("faults", "scale"),
    [("gain=0.1", (1.1,) * 6), ("gain_fz=0.1", (1, 1, 1.1, 1, 1, 1)), ("gain_moments=-0.2", (1, 1, 1, 0.8, 0.8, 0.8))],
)
def test_gains_scale_channels(faults: str, scale: tuple[float, ...]) -> None:
    np.testing.assert_allclose(made(faults).signals.channels, made().signals.channels * scale, rtol=1e-12)


def test_a_wrong_rate_is_only_in_the_file(tmp_path: Path) -> None:
    options = replace(SHORT, faults=FaultOptions(rate_error=0.05))
    source = read(simulate("sit-to-stand", tmp_path / "trial", options).with_name("trial.c3d"))
    assert source.rate == pytest.approx(105)
    truth = json.loads((tmp_path / "trial" / "truth.json").read_text())
    assert truth["faults"] == {"rate_error": 0.05}
    assert truth["point_rate_hz"] == 100


@pytest.mark.parametrize("faults", ["foot_moves_mm=50", "turn_deg=10", "foot_slide_mm=20"])
def test_a_person_who_moves_takes_the_wrench_along(faults: str) -> None:
    """Seen from the displaced person, markers and forces are those of the person who stays."""
    trial, good = made(faults + ",wander_mm=0", plate_noise=0.0), made(plate_noise=0.0)
    plane, person = trial.scene.plane, ~trial.scene.markers.on_plate
    last = len(good.points) - 50
    before, after = (plane.to_plane(each.positions[last, person]) for each in (good, trial))
    centre = before.mean(axis=0), after.mean(axis=0)
    u, _, v = np.linalg.svd((before - centre[0]).T @ (after - centre[1]))
    turn = (u @ v).T
    np.testing.assert_allclose(turn @ (before - centre[0]).T, (after - centre[1]).T, atol=1e-9)
    shift = centre[1] - turn @ centre[0]

    def wrench(each: SimulatedTrial) -> tuple[np.ndarray, np.ndarray]:
        load = each.signals.channels[last]
        axes, origin = each.scene.plate.axes, each.signals.origin
        force, moment = axes @ load[:3], axes @ (load[3:] - np.cross(origin, load[:3]))
        return plane.axes @ force, plane.axes @ moment

    force, moment = wrench(good)
    displaced_force, displaced_moment = wrench(trial)
    np.testing.assert_allclose(displaced_force, turn @ force, atol=1e-6)
    np.testing.assert_allclose(displaced_moment, turn @ moment + np.cross(shift, turn @ force), atol=1e-6)


def test_the_weight_of_a_leaning_plane_stays_vertical() -> None:
    trial = made("plane_tilt_deg=8", plate_noise=0.0)
    standing = trial.scene.chair.schedule.repetitions[0]
    frame = round(100 * (standing.rise_end + standing.sit_start) / 2)
    force = trial.scene.plate.axes @ trial.signals.channels[frame, :3]
    assert np.hypot(force[0], force[1]) < 0.03 * force[2]


def test_rests_lengthen_the_trial_without_motion() -> None:
    good, rested = made(), made(rest_before=20.0, rest_standing=10.0, rest_after=5.0)
    assert len(rested.points) - len(good.points) == pytest.approx(3500, abs=1)
    assert np.ptp(rested.state.q[:1900], axis=0).max() < np.radians(3)


def test_conventional_sets_have_the_usual_names() -> None:
    names = made(marker_set="plug-in-gait", without="R*,T10").labels
    assert "LKNE" in names
    assert not {"T10", "RKNE", "PLT1"} & set(names)
    on_shank = made(marker_set="joints", knee_on_shank=True).scene.markers
    assert on_shank.link[on_shank.labels.index("LKNE")] == 1


@pytest.mark.parametrize("text", ["frozen_s=99", "frozen=1", "gain=0.1,gain=0.2", "tilt_deg=x"])
def test_bad_faults_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="simulate: `faults`"):
        read_faults(text)


@pytest.mark.parametrize("options", [{"marker_set": "unknown"}, {"rest_before": -1.0}])
def test_bad_options_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match="simulate"):
        replace(SHORT, **options)
