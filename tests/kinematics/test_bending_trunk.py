"""Shift of a hip whose trunk bends, from a pelvis marker: exact geometry, noise, and trunks that do not bend."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.arrays import ComplexArray, FloatArray
from mocap_id.kinematics.clusters import estimate_hip_shift

HIP = 0.02 + 0.41j  # m, in the thigh's frame
LUMBAR, FRONT = 0.1j, 0.09 + 0.06j  # m, in the pelvis's frame, whose origin is the hip


def frames(bend: float, noise: float = 0.0, facing: float = 1.0) -> tuple[tuple[ComplexArray, FloatArray], ...]:
    """Origin and angle of thigh and trunk, and the marker: five rises with a bend of up to ``bend``, rad."""
    rng = np.random.default_rng(3)
    phase = np.linspace(0, 10 * np.pi, 2000)
    risen = (1 - np.cos(phase)) / 2
    thigh = facing * np.radians(80) * (1 - risen)
    lean = -facing * np.radians(35) * np.sin(phase) ** 2
    psi = facing * bend * (0.5 * (1 - risen) + 0.5 * np.sin(phase) ** 2)  # pelvis against trunk
    pelvis = np.exp(1j * (lean + psi))
    knee = np.zeros(len(phase), dtype=complex)
    hip = knee + np.exp(1j * thigh) * HIP
    front = complex(facing * FRONT.real, FRONT.imag)
    marker = hip + pelvis * front + noise * (rng.normal(size=len(phase)) + 1j * rng.normal(size=len(phase)))
    trunk = hip + pelvis * LUMBAR - np.exp(1j * lean) * LUMBAR
    return (knee, thigh), (trunk, lean), (marker, psi)


def rigid_hip(thigh: tuple[ComplexArray, FloatArray], trunk: tuple[ComplexArray, FloatArray]) -> complex:
    """The centre of a fit without a bend, in the thigh's frame."""
    columns = np.column_stack([np.exp(1j * thigh[1]), -np.exp(1j * trunk[1])])
    return complex(np.linalg.lstsq(columns, trunk[0] - thigh[0], rcond=None)[0][0])


@pytest.mark.parametrize("facing", [1.0, -1.0])
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_most_of_the_error_of_a_bending_trunk_is_removed(facing: float, noise: float) -> None:
    thigh, trunk, (marker, _) = frames(np.radians(15), noise, facing)
    before = rigid_hip(thigh, trunk)
    assert abs(before - HIP) > 0.008
    after = before + estimate_hip_shift(thigh, trunk, marker).place
    assert abs(after - HIP) < 0.4 * abs(before - HIP)


def test_a_trunk_that_does_not_bend_shifts_nothing() -> None:
    thigh, trunk, (marker, _) = frames(0.0)
    assert abs(estimate_hip_shift(thigh, trunk, marker).place) < 1e-6
    thigh, trunk, (marker, _) = frames(0.0, noise=0.001)
    assert abs(estimate_hip_shift(thigh, trunk, marker).place) < 2e-4


def test_the_frame_of_the_laboratory_does_not_matter() -> None:
    thigh, trunk, (marker, _) = frames(np.radians(15), noise=0.001)
    turn, place = np.exp(0.7j), 3.0 - 1.0j
    moved = [(place + turn * origin, angle + 0.7) for origin, angle in (thigh, trunk)]
    assert estimate_hip_shift(moved[0], moved[1], place + turn * marker).place == pytest.approx(
        estimate_hip_shift(thigh, trunk, marker).place
    )


def test_frames_without_marker_or_pose_are_left_out() -> None:
    thigh, trunk, (marker, _) = frames(np.radians(15))
    gone = np.arange(len(marker)) % 3 == 0
    kept = [(origin[~gone], angle[~gone]) for origin, angle in (thigh, trunk)]
    hidden = np.where(gone, np.nan, marker)
    assert estimate_hip_shift(thigh, trunk, hidden).place == pytest.approx(
        estimate_hip_shift(kept[0], kept[1], marker[~gone]).place
    )
    assert estimate_hip_shift(thigh, trunk, np.full(len(marker), np.nan, dtype=complex)).place == 0


@pytest.mark.parametrize("part", [0.0, 0.2])
def test_a_hip_that_hardly_turns_is_not_shifted(part: float) -> None:
    """Otherwise a marker that slides 10 mm in step moves the hip by 36 mm at a range of 0.2 rad."""
    phase = np.linspace(0, 10 * np.pi, 500)
    flexion = part * (1 - np.cos(phase)) / 2
    trunk = np.exp(1j * flexion) * HIP, flexion
    thigh = np.zeros(500, dtype=complex), np.zeros(500)
    marker = trunk[0] + np.exp(1j * flexion) * (FRONT + 0.01j * np.cos(phase))
    assert estimate_hip_shift(thigh, trunk, marker).place == 0
