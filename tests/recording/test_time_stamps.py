"""Time stamps: rounding errors are accepted, all other deviations from an even clock are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.errors import RecordingError
from mocap_id.recording.clock import fit_even_clock

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
    clock = fit_even_clock(FILE, printed(true, decimals(places)), rate)
    assert clock.rate == rate
    np.testing.assert_allclose(clock.times(count), true, rtol=0, atol=0.5 * 10.0**-places)


@pytest.mark.parametrize(
    ("rate", "form"),
    [(100.0, decimals(2)), (120.0, decimals(3)), (240.0, decimals(3)), (1000.0, decimals(3)), (2000.0, digits(6))],
)
def test_coarse_stamps_are_even(rate: float, form: Callable[[float], str]) -> None:
    true = np.arange(30_000) / rate
    clock = fit_even_clock(FILE, printed(true, form))
    assert clock.rate == pytest.approx(rate, rel=1e-7)
    np.testing.assert_allclose(clock.times(len(true)), true, rtol=0, atol=0.05 / rate)


def test_coarsely_rounded_stamps_are_reported() -> None:
    assert fit_even_clock(FILE, printed(np.arange(500) / 240, decimals(3))).rounding_note
    assert not fit_even_clock(FILE, printed(np.arange(500) / 100, decimals(2))).rounding_note


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
    assert fit_even_clock(FILE, time, 60.0).rate == pytest.approx(59.94)
    assert fit_even_clock(FILE, time[:20], 60.0).rate == 60.0
    assert fit_even_clock(FILE, time, 59.94).rate == 59.94
