"""Time stamps: rounding errors are accepted, all other deviations from an even clock are refused.

Every reader refuses times that are not seconds, and rates at which no movement can be measured.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_cases import body, build_c3d

from mocap_id.errors import RecordingError
from mocap_id.recording import (
    Recording,
    read,
    read_angles,
    read_board,
    read_encoder,
    read_force_log,
    read_table,
)
from mocap_id.recording.imu_log import read_imu
from mocap_id.recording.sample_checks import fit_even_clock
from mocap_id.recording.skeleton_log import read_skeleton

FILE = Path("trial.trc")


def printed(time: np.ndarray, form: Callable[[float], str]) -> np.ndarray:
    return np.array([float(form(value)) for value in time])


def decimals(count: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{count}f}"


def digits(count: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{count}g}"


@given(
    rate=st.sampled_from([30.0, 50.0, 59.94, 60.0, 100.0, 119.88, 120.0, 200.0, 240.0, 1000.0]),
    places=st.integers(4, 9),
    start=st.sampled_from([0.0, 0.91, 12.3, 95.0]),
    count=st.integers(10, 2000),
)
def test_rounded_stamps_are_even(rate: float, places: int, start: float, count: int) -> None:
    true = start + np.arange(count) / rate
    start, found, _ = fit_even_clock(FILE, printed(true, decimals(places)), rate)
    assert found == rate
    np.testing.assert_allclose(start + np.arange(count) / found, true, rtol=0, atol=0.5 * 10.0**-places)


@pytest.mark.parametrize(
    ("rate", "form"),
    [(100.0, decimals(2)), (120.0, decimals(3)), (240.0, decimals(3)), (1000.0, decimals(3)), (2000.0, digits(6))],
)
def test_coarse_stamps_are_even(rate: float, form: Callable[[float], str]) -> None:
    true = np.arange(30_000) / rate
    start, found, _ = fit_even_clock(FILE, printed(true, form))
    assert found == pytest.approx(rate, rel=1e-7)
    np.testing.assert_allclose(start + np.arange(len(true)) / found, true, rtol=0, atol=0.05 / rate)


def test_coarsely_rounded_stamps_are_reported() -> None:
    assert fit_even_clock(FILE, printed(np.arange(500) / 240, decimals(3)))[2]
    assert not fit_even_clock(FILE, printed(np.arange(500) / 100, decimals(2)))[2]


@pytest.mark.parametrize("places", [3, 5, 8])
@pytest.mark.parametrize("shift", [0.4, -0.4, 0.2])
@pytest.mark.parametrize("frame", [1, 200, 399])
def test_one_wrong_stamp_is_refused(places: int, shift: float, frame: int) -> None:
    time = np.arange(400) / 100
    time[frame] += shift / 100
    with pytest.raises(RecordingError, match=r"trial.trc: the time column is uneven: at .* of a frame"):
        fit_even_clock(FILE, printed(time, decimals(places)))


@pytest.mark.parametrize("shift", [0.4, -0.4, 0.2])
def test_a_pause_is_refused(shift: float) -> None:
    time = np.arange(400) / 100
    time[150:] += shift / 100
    with pytest.raises(RecordingError, match="uneven"):
        fit_even_clock(FILE, time)


def test_a_drifting_clock_is_refused() -> None:
    """All steps agree within a thousandth."""
    frame = np.arange(2000)
    with pytest.raises(RecordingError, match="uneven"):
        fit_even_clock(FILE, frame / 100 + 1e-9 * frame**2)


@pytest.mark.parametrize("form", [decimals(2), decimals(6)])
@pytest.mark.parametrize("left_out", [1, 2])
def test_missing_frames_are_refused(form: Callable[[float], str], left_out: int) -> None:
    time = np.delete(np.arange(400) / 100, slice(100, 100 + left_out))
    with pytest.raises(RecordingError, match="frames are missing"):
        fit_even_clock(FILE, printed(time, form))


def test_a_declared_rate_is_used_only_if_the_last_stamp_agrees() -> None:
    """An error of a thousandth is two frames in two thousand."""
    time = np.arange(2000) / 59.94
    assert fit_even_clock(FILE, time, 60.0)[1] == pytest.approx(59.94)
    assert fit_even_clock(FILE, time[:20], 60.0)[1] == 60.0
    assert fit_even_clock(FILE, time, 59.94)[1] == 59.94


COUNT, HZ = 120, 50.0
SECONDS = np.arange(COUNT) / HZ
NOT_SECONDS = {
    "milliseconds": 1e3 * SECONDS,
    "microseconds": 1e6 * SECONDS,
    "frame numbers": np.arange(1.0, COUNT + 1),
    "whole seconds": np.round(SECONDS),
    "minutes": SECONDS / 3000.0,
    "one row in two seconds": 2.0 * np.arange(COUNT),
}


def make_table(head: str, time: np.ndarray, columns: list[np.ndarray], separator: str = ",") -> str:
    rows = np.column_stack([time, *columns])
    return head + "\n" + "".join(separator.join(f"{value:.9f}" for value in row) + "\n" for row in rows)


def write_with_times(kind: str, folder: Path, time: np.ndarray) -> Callable[[], object]:
    """Write a valid file of a kind with these times, and return its reader."""
    path, ones = folder / "log.csv", np.ones(COUNT)
    wave = np.sin(SECONDS)
    if kind in ("TRC", "skeleton TRC"):
        xyz = np.random.default_rng(0).uniform(100, 900, (COUNT, 9)) + 100 * wave[:, None]
        head = "PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
        head += f"\t\t{COUNT}\t3\tmm\nFrame#\tTime\tA\t\t\tB\t\t\tC\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3\n"
        path = path.with_suffix(".trc")
        path.write_text(head + make_table("", np.arange(1.0, COUNT + 1), [time, *xyz.T], "\t"))
        return lambda: (read if kind == "TRC" else read_skeleton)(path)
    if kind in ("MOT", "angles of a MOT"):
        path = path.with_suffix(".mot")
        path.write_text(f"x\nnRows={COUNT}\nendheader\n" + make_table("time\tknee\thip", time, [wave, ones], "\t"))
        return lambda: read_table(path) if kind == "MOT" else read_angles(path, ["knee"])
    heads = {
        "skeleton": ("time_s,A_x,A_y,A_z", [wave, ones, 2 * ones], read_skeleton),
        "force log": ("time_s,Fx_N,Fy_N,Fz_N", [wave, ones, 2 * ones], read_force_log),
        "encoder": ("time_s,position_rad,velocity_rad_s", [wave, np.cos(SECONDS)], read_encoder),
        "board": ("time_s,tl_kg,tr_kg,bl_kg,br_kg", [ones, ones + 0.1 * wave, ones, ones], read_board),
        "sensor": (
            "time_s,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z",
            [wave, wave, ones, ones, ones, 9.8 * ones],
            read_imu,
        ),
        "angles": ("time_s,knee_deg", [wave], lambda file: read_angles(file, ["knee_deg"])),
    }
    head, columns, reader = heads[kind]
    path.write_text(make_table(head, time, columns))
    return lambda: reader(path)


KINDS = (
    *("TRC", "skeleton TRC", "MOT", "angles of a MOT"),
    *("skeleton", "force log", "encoder", "board", "sensor", "angles"),
)


@pytest.mark.parametrize("kind", KINDS)
def test_every_reader_takes_seconds(tmp_path: Path, kind: str) -> None:
    write_with_times(kind, tmp_path, SECONDS + 3.0)()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("unit", NOT_SECONDS)
def test_every_reader_refuses_times_that_are_not_seconds(tmp_path: Path, kind: str, unit: str) -> None:
    time = NOT_SECONDS[unit]
    if unit == "minutes" and "skeleton" not in kind and kind != "TRC":
        time = time / 60.0  # a force sensor may have several kilohertz
    reader = write_with_times(kind, tmp_path, time)
    with pytest.raises(RecordingError, match=r"log\.(csv|trc|mot): .*second") as caught:
        reader()
    if unit in ("milliseconds", "frame numbers") and kind not in ("TRC",):
        assert f"may be {unit}" in str(caught.value)


@pytest.mark.parametrize("kind", ["skeleton", "encoder", "board", "sensor"])
def test_a_clock_that_jumps_by_an_hour_is_refused(tmp_path: Path, kind: str) -> None:
    time = SECONDS.copy()
    time[COUNT // 2 :] += 3600.0
    with pytest.raises(RecordingError, match=r"jumps by 3600\.02 s, from 1\.18 to"):
        write_with_times(kind, tmp_path, time)()


@pytest.mark.parametrize("rate", [0.03, 1.0, 4.0])
def test_a_rate_at_which_no_movement_can_be_measured_is_refused(tmp_path: Path, rate: float) -> None:
    positions = body(60)
    (tmp_path / "slow.c3d").write_bytes(build_c3d(1e3 * positions, rate=rate))
    qtm = "NO_OF_FRAMES\t2\nNO_OF_MARKERS\t1\nFREQUENCY\t{}\nDATA_INCLUDED\t3D\nMARKER_NAMES\tA\n1\t2\t3\n4\t5\t600\n"
    (tmp_path / "slow.tsv").write_text(qtm.format(rate))
    for path in (tmp_path / "slow.c3d", tmp_path / "slow.tsv"):
        with pytest.raises(RecordingError, match="expected 5 to 2,000 Hz"):
            read(path)
    with pytest.raises(RecordingError, match="expected 5 to 2,000 Hz"):
        Recording.from_arrays(list("ABCDE"), positions, rate)


def test_a_skeleton_with_times_in_tenths_of_a_second_is_refused(tmp_path: Path) -> None:
    """Two of three rows would have the time of another one."""
    with pytest.raises(RecordingError, match="rounded too coarsely"):
        write_with_times("skeleton", tmp_path, np.round(SECONDS, 1))()
