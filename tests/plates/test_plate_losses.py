"""Missing plate data: saturation, short files, drop-outs; and feet on two plates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from recording_cases import ORIGIN, signals

from mocap_id import recording
from mocap_id.plates.choice import find_dropouts
from mocap_id.recording import PlateSignals
from mocap_id.recording.c3d_reader import find_clipped
from mocap_id.recording.lab_plates import compute_plate_axes, compute_surface_wrench
from mocap_id.recording.sample_checks import find_upright
from mocap_id.stages.base import Context
from mocap_id.stages.planarise import STAGE, PlanariseSettings
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import Table
from mocap_id.verdict import Reason
from mocap_id_simulation import Options, SimulatedTrial, generate

RATE = 100.0


@cache
def simulated() -> SimulatedTrial:
    return generate("sit-to-stand", Options(seed=31, repetitions=2))


def weight() -> float:
    return float(simulated().scene.body.mass) * 9.81


def planarised(markers: Path, forces: Path | None = None) -> Table:
    trial = TrialKeys(trial="t", recording=Files(markers=markers, forces=forces), protocol="sit-to-stand")
    _, wrench = STAGE.function(Context(trial, PlanariseSettings(), {}))
    assert isinstance(wrench, Table)
    return wrench


def with_channels(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> Table:
    """Return the trial with changed plate channels."""
    made = simulated()
    plate = replace(made.signals, channels=change(made.signals.channels.copy()))
    recording.write_c3d(folder / "t.c3d", list(made.scene.markers.labels), made.points, RATE, plates=[plate])
    return planarised(folder / "t.c3d")


def doubts(wrench: Table) -> dict[str, Reason]:
    return {reason.code: reason for reason in wrench.reasons if reason.level != "ok"}


def test_a_good_plate_loses_nothing(tmp_path: Path) -> None:
    wrench = with_channels(tmp_path, lambda channels: channels)
    assert doubts(wrench) == {}
    assert wrench.frame["plate_ok"].all()


@pytest.mark.parametrize("share", [1.0, 0.9, 0.7])
def test_a_clipped_load_is_not_used_and_reported(tmp_path: Path, share: float) -> None:
    """All frames at the limit are found and hardly any other, however long the clipping lasts."""
    limit = share * weight()
    wrench = with_channels(tmp_path, lambda channels: np.maximum(channels, -limit))
    reason = doubts(wrench)["plate-saturated"]
    true = -simulated().signals.channels[:, 2] > limit
    assert reason.value == pytest.approx(true.mean(), abs=0.01)
    frames = true.reshape(len(wrench.frame), -1).mean(axis=1)
    assert not wrench.frame["plate_ok"][frames > 0.5].any()
    assert wrench.frame["plate_ok"][frames == 0].mean() > 0.95


def test_a_load_that_is_always_clipped_is_ignored(tmp_path: Path) -> None:
    wrench = with_channels(tmp_path, lambda channels: np.maximum(channels, [-9e9, -9e9, -100.0, -9e9, -9e9, -9e9]))
    assert "(channel 3) reads -100 in every sample" in doubts(wrench)["no-plate"].message


def test_clipping_is_distinguished_from_rest() -> None:
    rng = np.random.default_rng(0)
    load = 700 * np.sin(np.linspace(0, 9, 3000)) ** 2 + rng.normal(size=3000)
    assert find_clipped(np.minimum(load, 500.0)).tolist() == (load >= 500.0).tolist()
    assert not find_clipped(load).any()
    assert not find_clipped(np.maximum(load - 300, 0.0)).any()  # an unloaded plate reads exactly zero
    assert not find_clipped(np.round(np.minimum(load, 500.0) / 50) * 50).any()  # coarse channels repeat everywhere
    assert not find_clipped(np.full(100, 3.0)).any()


@pytest.mark.parametrize(
    "unplugged",
    [
        lambda channels: 0 * channels,
        lambda channels: 0 * channels + 3.0,
        lambda channels: 0 * channels + 50.0,
        lambda channels: np.nan * channels,
        lambda channels: np.random.default_rng(0).normal(size=channels.shape),
    ],
    ids=["zeros", "an offset", "a large offset", "not a number", "noise"],
)
def test_an_unplugged_plate_is_ignored(tmp_path: Path, unplugged: Callable[[np.ndarray], np.ndarray]) -> None:
    wrench = with_channels(tmp_path, unplugged)
    assert list(doubts(wrench)) == ["no-plate"]
    assert not wrench.frame["plate_ok"].any()
    assert wrench.facts["mass_kg"] is None


def test_after_a_loose_cable_only_the_rest_is_missing(tmp_path: Path) -> None:
    samples = len(simulated().signals.channels)
    off = np.arange(samples) > 0.5 * samples
    wrench = with_channels(tmp_path, lambda channels: np.where(off[:, None], 0.0, channels))
    assert doubts(wrench)["plate-dropout"].value == pytest.approx(0.5, abs=0.01)
    frames = off.reshape(len(wrench.frame), -1)
    assert not wrench.frame["plate_ok"][frames.all(axis=1)].any()
    assert wrench.frame["plate_ok"][~frames.any(axis=1)].mean() > 0.99


def test_a_chair_that_carries_all_the_weight_is_not_a_dropout() -> None:
    """A seated person with lifted feet, and a jump."""
    time = np.arange(0, 10, 1 / RATE)
    rise = np.clip(2 * np.sin(2 * np.pi * time / 5), -1, 1) / 2 + 0.5
    positions = np.zeros((len(time), 4, 3))
    positions[:, :, 2] = np.array([0.05, 0.5, 1.0, 1.4]) + np.array([0, 0.1, 0.4, 0.4]) * rise[:, None]
    tall, seated = find_upright(positions)[0], 700 * (rise > 0.1)
    assert not find_dropouts(seated, tall, RATE, 700.0).any()
    flight = np.where((time > 1.0) & (time < 1.5), 0.0, 700.0)
    assert not find_dropouts(flight, tall, RATE, 700.0).any()
    lost = np.where(time > 5.6, 0.0, 700.0)
    np.testing.assert_array_equal(find_dropouts(lost, tall, RATE, 700.0), time > 5.6)


@pytest.mark.parametrize(("share", "level"), [(1.0, None), (0.97, "ok"), (0.6, "caution")])
def test_forces_that_end_before_the_markers_are_reported(tmp_path: Path, share: float, level: str | None) -> None:
    made = simulated()
    recording.write_trc(tmp_path / "t.trc", list(made.scene.markers.labels), made.points, RATE)
    write_mot(tmp_path / "t.mot", made.signals, round(share * len(made.points)))
    wrench = planarised(tmp_path / "t.trc", tmp_path / "t.mot")
    found = [reason for reason in wrench.reasons if reason.code == "plate-short"]
    assert [reason.level for reason in found] == ([] if level is None else [level])
    assert wrench.frame["plate_ok"].mean() == pytest.approx(share, abs=0.01)


def test_one_foot_on_each_plate_equals_both_feet_on_one(tmp_path: Path) -> None:
    """The sum of the plates agrees, about another origin, although each foot pushes inwards with another share."""
    made = simulated()
    labels = list(made.scene.markers.labels)
    feet = [
        np.nanmean(made.points[:, [labels.index(f"{side}TOE"), labels.index(f"{side}HEE")]], (0, 1)) for side in "LR"
    ]
    force, moment = in_lab(made.signals)
    apart = (feet[0] - feet[1]) * [1, 1, 0]
    inwards = 15.0 * apart / np.linalg.norm(apart)
    pressure = np.column_stack([-moment[:, 1], moment[:, 0], 0 * force[:, 0]]) / np.maximum(force[:, 2:], 20.0)
    left = 0.6 * force - inwards
    moment_left = np.cross(pressure + 0.4 * apart, left)
    wrenches = [(left, moment_left), (force - left, moment - moment_left)]
    small = (made.signals.corners - made.signals.corners.mean(axis=0)) / 2
    plates = [
        signals(*wrench, small + np.array([foot[0], foot[1], 0.0]), made.signals.rate, ORIGIN)
        for wrench, foot in zip(wrenches, feet, strict=True)
    ]
    recording.write_c3d(tmp_path / "two.c3d", labels, made.points, RATE, plates=plates)
    two, one = planarised(tmp_path / "two.c3d"), with_channels(tmp_path, lambda channels: channels)
    assert [plate["use"] for plate in two.facts["plates"]] == ["feet", "feet"]
    assert doubts(two) == {}
    assert two.facts["mass_kg"] == pytest.approx(one.facts["mass_kg"], rel=1e-6)
    both, single = two.frame, one.frame
    for component in ("Fx", "Fy"):
        np.testing.assert_allclose(both[component], single[component], atol=1e-2)
    shift = (both["tauz"] - single["tauz"]) / single["Fy"]  # from the first plate's centre instead of the one plate's
    np.testing.assert_allclose(shift, shift.median(), atol=1e-3)


def in_lab(plate: PlateSignals) -> tuple[np.ndarray, np.ndarray]:
    """Return force and moment about the lab's origin."""
    force, moment = compute_surface_wrench(plate)
    axes = compute_plate_axes(plate.corners)
    force, moment = force @ axes.T, moment @ axes.T
    return force, moment + np.cross(plate.corners.mean(axis=0), force)


def write_mot(path: Path, plate: PlateSignals, frames: int) -> None:
    """Return the plate at the marker times in OpenSim's axes, Y up."""
    force, moment = in_lab(plate)
    point = np.column_stack([-moment[:, 1], moment[:, 0], 0 * moment[:, 0]]) / np.maximum(force[:, 2:], 20.0)
    free = moment - np.cross(point, force)
    every = slice(None, None, round(plate.rate / RATE))
    columns = [np.column_stack([each[:, 0], each[:, 2], -each[:, 1]])[every][:frames] for each in (force, point, free)]
    table = np.column_stack([np.arange(frames) / RATE, *columns])
    names = ["time", *(f"ground_force_1_{what}{axis}" for what in "vpm" for axis in "xyz")]
    head = f"t\nversion=1\nnRows={frames}\nnColumns={len(names)}\ninDegrees=yes\nendheader\n" + "\t".join(names) + "\n"
    path.write_text(head + "\n".join("\t".join(f"{value:.6f}" for value in row) for row in table) + "\n")
