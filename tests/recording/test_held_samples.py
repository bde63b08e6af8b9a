"""Samples that software repeated or filled with straight lines are found in every sensor, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recording_cases import CORNERS, signals

from mocap_id.estimation.inertial import SensorSignals
from mocap_id.recording import Recording, read, read_board, read_encoder, read_force_log, write_c3d, write_trc
from mocap_id.recording.imu_log import ImuLog, format_imu_csv, read_imu
from mocap_id.recording.sample_checks import describe_held, find_held, list_held
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.workflows.recording_trial import describe_recording

RATE = 100.0
TIME = np.arange(1200) / RATE


def movement(channels: int, *, noise: float, size: float = 0.3, seed: int = 0) -> np.ndarray:
    """Return a smooth movement of several channels at the times, with a rest from 7 to 9 s and white noise."""
    speed = np.clip(np.abs(TIME - 8.0) - 1.0, 0.0, 1.0)
    moved = np.cumsum(speed**2 * (3 - 2 * speed)) / RATE
    phase = np.arange(channels)
    clean = size * (1 - np.cos(1.3 * moved[:, None] + phase) * np.cos(0.4 * phase))
    return clean + np.random.default_rng(seed).normal(0, noise, clean.shape)


def write_rows(path: Path, head: str, rows: np.ndarray) -> Path:
    path.write_text(head + "\n" + "".join(",".join(f"{value:.6f}" for value in row) + "\n" for row in rows))
    return path


def wrench_of_a_person() -> np.ndarray:
    force = movement(3, noise=0.5, size=60.0) + np.array([0, 0, 600])
    return np.hstack([force, movement(3, noise=0.05, size=5.0, seed=2)])


def hold(values: np.ndarray, first: int, stop: int) -> np.ndarray:
    """Return values in which the row before ``first`` is repeated up to the row before ``stop``."""
    changed = values.copy()
    changed[first:stop] = values[first - 1]
    return changed


def fill(values: np.ndarray, first: int, stop: int) -> np.ndarray:
    """Return values in which the rows from ``first`` are on a straight line between their neighbours."""
    changed, share = values.copy(), np.arange(1, stop - first + 1)[:, None] / (stop - first + 1)
    changed[first:stop] = values[first - 1] * (1 - share) + values[stop] * share
    return changed


@pytest.mark.parametrize("decimals", [6, 4])
@pytest.mark.parametrize("rows", [8, 50, 200])
@pytest.mark.parametrize(("change", "kind"), [(hold, 0), (fill, 1)])
@pytest.mark.parametrize("noise", [3e-4, 3e-3])
def test_exactly_the_changed_rows_of_a_sensor_with_noise_are_found(
    change: Callable[..., np.ndarray], kind: int, rows: int, decimals: int, noise: float
) -> None:
    for first in (300, 720):  # while it moves, and at rest
        values = np.round(change(movement(3, noise=noise), first, first + rows), decimals)
        found = find_held(values, RATE)
        expected = np.zeros(len(values), dtype=bool)
        expected[first : first + rows] = True
        if noise > 10 * 10.0**-decimals:  # otherwise a sample of the sensor may be on the line too
            assert np.array_equal(found[kind], expected)
            assert not found[1 - kind].any()
        elif rows > 8:
            assert (found[0] | found[1])[first : first + rows].mean() > 0.95
            assert not (found[0] | found[1])[: first - 5].any()


@pytest.mark.parametrize(
    "values",
    [
        movement(3, noise=1e-3),
        movement(3, noise=0.0),  # simulated: the rest repeats exactly
        np.round(movement(3, noise=0.0), 3),
        np.round(movement(3, noise=5e-4), 3),  # noise below the rounding
        np.round(movement(3, noise=5e-3), 2),
        np.round(
            np.cumsum(np.abs(np.sin(2.6 * TIME))[:, None] ** 8 * [1.0, 0.3, 0.1], axis=0) / 30, 3
        ),  # a foot's steps
        np.repeat(movement(3, noise=1e-3)[::8], 8, axis=0),  # exported at eight times the rate
        np.stack([np.interp(np.arange(1200), np.arange(0, 1200, 8), c) for c in movement(3, noise=1e-3)[::8].T], 1)[
            :1190
        ],
        hold(movement(3, noise=1e-3), 400, 403),  # too short
        np.full((1200, 3), 0.4),
        np.full((1200, 3), np.nan),
        movement(3, noise=1e-3)[:8],
    ],
    ids=[
        "noisy",
        "clean",
        "rounded",
        "dithered",
        "coarse",
        "steps",
        "repeated",
        "interpolated",
        "short",
        "constant",
        "missing",
        "few",
    ],
)
def test_nothing_is_found_in_what_sensors_and_simulators_give(values: np.ndarray) -> None:
    held, straight = find_held(values, RATE)
    assert not held.any()
    assert not straight.any()


def test_repeated_single_rows_do_not_add_up(tmp_path: Path) -> None:
    values, rng = movement(3, noise=1e-3), np.random.default_rng(1)
    source = np.maximum.accumulate(np.where(rng.uniform(size=len(values)) < 0.3, 0, np.arange(len(values))))
    assert not np.any(find_held(values[source], RATE))


def test_a_long_stretch_is_a_caution_and_a_short_one_a_note() -> None:
    for rows, level in ((20, "ok"), (60, "caution")):
        found = list_held("plate 1", TIME, *find_held(hold(movement(3, noise=1e-3), 300, 300 + rows), RATE))
        (reason,) = describe_held(found)
        assert (reason.code, reason.level) == ("samples-held", level)
        assert f"{rows} samples of plate 1 are repeated (3.00 to {2.99 + rows / 100:.2f} s)" in reason.message
        assert not describe_held(found, 8.0, 9.0)


def test_rows_of_an_inertial_sensor_are_left_out_and_its_signals_have_a_gap(tmp_path: Path) -> None:
    good = np.hstack([movement(3, noise=5e-3, size=2.0), movement(3, noise=0.05, size=5.0, seed=1)])
    changed = hold(good, 400, 450)
    (tmp_path / "imu.csv").write_bytes(format_imu_csv(ImuLog(TIME, changed[:, :3], changed[:, 3:])))
    log = read_imu(tmp_path / "imu.csv")
    assert len(log.time) == len(TIME) - 50
    assert "50 samples of the sensor in imu.csv are repeated (4.00 to 4.49 s)" in str(log.held[0])
    gyro, acc = SensorSignals(log.time, log.gyro, log.acc).at(TIME, 0.01)
    assert np.isnan(gyro[401:449]).all()
    assert np.isnan(acc[401:449]).all()
    assert np.isfinite(gyro[2:399]).all()
    assert np.abs(gyro[451:1190] - good[451:1190, :3]).max() < 1e-3


def test_rows_of_a_balance_board_are_a_gap_but_not_a_failure_of_its_radio(tmp_path: Path) -> None:
    cells = np.round(15 + movement(4, noise=0.05, size=3.0), 2)
    path = tmp_path / "board.csv"
    rows = np.column_stack([TIME, hold(cells, 400, 450)])
    path.write_text(
        "time_s,tl_kg,tr_kg,bl_kg,br_kg\n" + "".join(",".join(f"{v:.4f}" for v in row) + "\n" for row in rows)
    )
    log = read_board(path)
    lost = log.start + np.flatnonzero(~log.ok) / log.rate
    assert lost.min() == pytest.approx(4.0, abs=0.05)
    assert lost.max() == pytest.approx(4.49, abs=0.05)
    assert len(log.held) == 1
    assert log.gaps == 0


def test_rows_of_a_force_sensor_are_missing(tmp_path: Path) -> None:
    force = np.round(movement(3, noise=0.2, size=40.0), 4)
    rows = np.column_stack([TIME, fill(force, 400, 450)])
    log, stretches = read_force_log(write_rows(tmp_path / "hand.csv", "time_s,Fx_N,Fy_N,Fz_N", rows))
    assert np.isnan(log.force[400:450]).all()
    assert np.isfinite(np.delete(log.force, np.arange(399, 451), axis=0)).all()
    assert len(stretches) == 1


def test_an_encoder_may_repeat_its_angle_only_at_rest(tmp_path: Path) -> None:
    angle = movement(1, noise=0.0, size=1.0)[:, 0]
    clean = np.column_stack([angle, np.gradient(angle, TIME)])
    for values, count in ((clean, 0), (hold(clean, 400, 420), 20)):
        path = tmp_path / "encoder.csv"
        rows = np.column_stack([TIME, values])
        path.write_text(
            "time_s,position_rad,velocity_rad_s\n" + "".join(f"{t:.4f},{a!r},{b!r}\n" for t, a, b in rows.tolist())
        )
        log = read_encoder(path)
        assert len(log.time) == len(TIME) - count
        assert sum(each.count for each in log.held) == count


@pytest.mark.parametrize("change", [hold, fill])
def test_plate_samples_are_not_ok_and_inspect_says_so(tmp_path: Path, change: Callable[..., np.ndarray]) -> None:
    wrench = change(wrench_of_a_person(), 400, 450)
    markers = 1.0 + np.stack([movement(3, noise=3e-4, seed=k) for k in range(4)], axis=1)
    plate = signals(wrench[:, :3], wrench[:, 3:], CORNERS, RATE)
    write_c3d(tmp_path / "a.c3d", list("ABCD"), markers, RATE, plates=(plate,))
    source = read(tmp_path / "a.c3d")
    assert np.array_equal(np.flatnonzero(~source.plates[0].ok), np.arange(400, 450))
    assert any("50 samples of plate 1 are" in note for note in describe_recording(source)["oddities"])
    assert np.isfinite(source.positions).all()


def test_an_unloaded_plate_may_repeat_its_zero(tmp_path: Path) -> None:
    wrench = wrench_of_a_person()
    wrench[400:700] = 0.0
    markers = 1.0 + np.stack([movement(3, noise=3e-4, seed=k) for k in range(4)], axis=1)
    write_c3d(
        tmp_path / "a.c3d", list("ABCD"), markers, RATE, plates=(signals(wrench[:, :3], wrench[:, 3:], CORNERS, RATE),)
    )
    assert not read(tmp_path / "a.c3d").held


def test_markers_on_straight_lines_are_missing_in_every_format(tmp_path: Path) -> None:
    tracks = [movement(3, noise=3e-4, seed=k) for k in range(4)]
    markers = 1.0 + np.stack([fill(tracks[0], 300, 400), *tracks[1:]], axis=1)
    write_c3d(tmp_path / "a.c3d", list("ABCD"), markers, RATE)
    write_trc(tmp_path / "a.trc", list("ABCD"), markers, RATE)
    for name in ("a.c3d", "a.trc"):
        source: Recording = read(tmp_path / name)
        lost = np.argwhere(~source.visible)
        assert set(lost[:, 1]) == {0}
        assert np.array_equal(lost[:, 0], np.arange(300, 400))
        assert [each.sensor for each in source.held] == ["marker A"]


def test_a_skeleton_that_stands_still_in_the_file_is_missing(tmp_path: Path) -> None:
    time = np.arange(300) / 30
    joints = np.random.default_rng(0).normal(0, 0.01, (300, 2, 3)) + np.sin(time)[:, None, None]
    joints = hold(joints, 100, 130)
    rows = np.column_stack([time, joints.reshape(300, 6)])
    found = read_skeleton(write_rows(tmp_path / "k.csv", "time_s,A_x,A_y,A_z,B_x,B_y,B_z", rows))
    assert np.isnan(found.recording.positions[101:129]).all()
    assert [reason.code for reason in found.reasons] == ["samples-held"]


def test_markers_that_stand_still_together_are_left_out_and_whole_frames_are_not(tmp_path: Path) -> None:
    """A single marker and whole frames are left to later searches, which compare it, or them, with the others."""
    points = np.stack([movement(3, noise=5e-4, seed=k) for k in range(8)], axis=1)
    points[300:350, 2:5] = points[299, 2:5]
    points[500:550, 6] = points[499, 6]
    points[700:750] = points[699]
    write_c3d(tmp_path / "a.c3d", [f"M{k}" for k in range(8)], points, RATE)
    found = read(tmp_path / "a.c3d")
    expected = np.ones(points.shape[:2], dtype=bool)
    expected[300:350, 2:5] = False
    assert np.array_equal(np.isfinite(found.positions).all(axis=2), expected)
    assert [(each.sensor, each.how) for each in found.held] == [(f"marker M{k}", "repeated") for k in (2, 3, 4)]
