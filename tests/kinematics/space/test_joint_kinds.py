"""The kind of a joint from the rotation between two noisy clusters."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.geometry import so3
from mocap_id.kinematics.space.skeleton import fit_pin_axes, fit_two_axes, rotation_arc, weigh_kinds

_NOISE = np.radians(0.5)


def _turns(kind: str, size: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rotations (F, 3, 3) of a joint of known axes, with noise."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0, 12, 150)
    first, second = np.array([0.2, 0.1, 1.0]), np.array([0.1, 1.0, 0.0])
    first, second = first / np.linalg.norm(first), second / np.linalg.norm(second)
    angles = size * np.stack([np.sin(phase), np.sin(1.7 * phase + 1), np.sin(2.3 * phase + 2)], axis=1)
    used = {"hinge": 1, "two-axis": 2, "ball": 3}[kind]
    turn = so3.exp(angles[:, :1] * first)
    turn = turn @ so3.exp(angles[:, 1:2] * second) if used > 1 else turn
    turn = turn @ so3.exp(angles[:, 2:] * np.array([1.0, 0, 0])) if used > 2 else turn
    return turn @ so3.exp(_NOISE * rng.normal(size=(150, 3))), first, second


@pytest.mark.parametrize("kind", ["hinge", "two-axis", "ball"])
@pytest.mark.parametrize("size", [0.3, 1.0])
def test_simplest_kind_that_explains_the_rotation(kind: str, size: float) -> None:
    turn, _, _ = _turns(kind, size)
    evidence = weigh_kinds(turn, _NOISE**2 * np.eye(3), rotation_arc(turn))
    assert evidence.likely == evidence.kind == kind


def test_a_given_kind_overrides_the_evidence() -> None:
    turn, _, _ = _turns("hinge", 1.0)
    evidence = weigh_kinds(turn, _NOISE**2 * np.eye(3), rotation_arc(turn), "ball")
    assert (evidence.kind, evidence.likely) == ("ball", "hinge")


def test_a_small_arc_shows_no_kind() -> None:
    turn, _, _ = _turns("hinge", 0.05)
    assert weigh_kinds(turn, _NOISE**2 * np.eye(3), rotation_arc(turn)).likely == "ball"


def test_two_axes_are_found() -> None:
    turn, first, second = _turns("two-axis", 0.8)
    one, other, _ = fit_two_axes(turn)
    assert abs(one @ first) > np.cos(np.radians(1))
    assert abs(other @ second) > np.cos(np.radians(1))


def test_a_wrong_second_axis_is_refused() -> None:
    turn, _, second = _turns("two-axis", 0.8)
    assert fit_pin_axes(turn, _NOISE**2 * np.eye(3), second) is not None
    assert fit_pin_axes(turn, _NOISE**2 * np.eye(3), np.array([1.0, 0, 0])) is None
