"""Frames from landmarks: definitions, uncertainty, sides."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.anatomy.frames import (
    DEFINITIONS,
    FOREARM,
    PALPATION,
    THORAX,
    UPPER_ARM,
    UPPER_ARM_2,
    build_frame,
    build_straight_hand,
    frame_covariance,
    has_bent_elbow,
    mirror_points,
)
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.geometry import so3


@pytest.fixture
def body() -> dict[str, FloatArray]:
    """Landmarks of a right arm with its elbow at about 90°, m, y up, x forward."""
    at = {
        "IJ": (0.0, 0.0, 0.0),
        "PX": (0.04, -0.17, 0.003),
        "C7": (-0.1, 0.05, 0.0),
        "T8": (-0.14, -0.17, -0.002),
        "GH": (-0.03, -0.02, 0.16),
        "EL": (0.0, -0.3, 0.22),
        "EM": (-0.01, -0.31, 0.15),
        "RS": (0.24, -0.28, 0.22),
        "US": (0.24, -0.33, 0.18),
        "MCP2": (0.33, -0.27, 0.21),
        "MCP5": (0.32, -0.34, 0.18),
    }
    return {name: np.array(place) for name, place in at.items()}


def test_axes_point_where_the_isb_says(body: dict[str, FloatArray]) -> None:
    thorax = build_frame(THORAX, body)
    assert np.allclose(thorax.rotation, np.eye(3), atol=0.15)
    assert np.allclose(thorax.origin, body["IJ"])
    middle = (body["PX"] + body["T8"]) / 2
    normal = np.cross(body["IJ"] - middle, body["C7"] - middle)
    assert np.allclose(np.cross(thorax.rotation[:, 2], normal), 0, atol=1e-12)
    arm, forearm = build_frame(UPPER_ARM, body), build_frame(FOREARM, body)
    assert arm.rotation[1, 1] > 0.9 and arm.rotation[2, 2] > 0.9 and arm.rotation[0, 0] > 0.9
    assert forearm.rotation[0, 1] < -0.9
    bent = build_frame(UPPER_ARM_2, body)
    assert np.allclose(bent.rotation[:, 2] @ np.stack([arm.rotation[:, 1], forearm.rotation[:, 1]]).T, 0, atol=1e-12)
    assert bent.rotation[2, 2] > 0.9
    assert bool(has_bent_elbow(body))
    hand = build_straight_hand(forearm, body)
    assert np.allclose(hand.rotation, forearm.rotation)
    assert np.allclose(hand.origin, (body["RS"] + body["US"]) / 2)


@pytest.mark.parametrize("definition", [*DEFINITIONS.values(), UPPER_ARM_2])
def test_frames_are_rotations_and_turn_with_the_lab(definition, body: dict[str, FloatArray]) -> None:
    frame, turn = build_frame(definition, body), so3.exp(np.array([0.4, -1.1, 0.7]))
    assert np.allclose(frame.rotation.T @ frame.rotation, np.eye(3))
    assert np.isclose(np.linalg.det(frame.rotation), 1)
    turned = build_frame(definition, {name: turn @ place + 0.3 for name, place in body.items()})
    assert np.allclose(turned.rotation, turn @ frame.rotation)
    for name, sensitivity in frame.sensitivity.items():
        assert np.allclose(turned.sensitivity[name] @ turn, sensitivity)


@pytest.mark.parametrize("definition", [*DEFINITIONS.values(), UPPER_ARM_2])
def test_sensitivity_is_the_derivative(definition, body: dict[str, FloatArray]) -> None:
    frame, step = build_frame(definition, body), 1e-6
    for name in definition.landmarks:
        numeric = np.zeros((3, 3))
        for axis in range(3):
            moved = [dict(body), dict(body)]
            for sign, points in zip((1, -1), moved, strict=True):
                points[name] = body[name] + sign * step * np.eye(3)[axis]
            ends = [so3.log(frame.rotation.T @ build_frame(definition, points).rotation) for points in moved]
            numeric[:, axis] = (ends[0] - ends[1]) / (2 * step)
        assert np.allclose(numeric, frame.sensitivity.get(name, np.zeros((3, 3))), atol=1e-5)


def test_covariance_agrees_with_monte_carlo_and_palpation_gives_five_degrees(body: dict[str, FloatArray]) -> None:
    frames = tuple(build_frame(definition, body) for definition in (UPPER_ARM, FOREARM))
    sds = {"GH": np.diag([0.004, 0.002, 0.006]) ** 2, "RS": 0.001}
    predicted = frame_covariance(frames, sds)
    rng, count = np.random.default_rng(3), 20000
    points = {}
    for name, place in body.items():
        spread = np.asarray(sds.get(name, PALPATION))
        root = spread * np.eye(3) if spread.ndim == 0 else np.sqrt(spread)
        points[name] = place + rng.normal(size=(count, 3)) @ root
    errors = np.concatenate(
        [
            so3.log(np.swapaxes(build_frame(definition, points).rotation, 1, 2) @ frame.rotation)
            for definition, frame in zip((UPPER_ARM, FOREARM), frames, strict=True)
        ],
        axis=1,
    )
    scale = np.sqrt(np.diag(predicted))
    assert np.allclose(np.cov(errors.T) / np.outer(scale, scale), predicted / np.outer(scale, scale), atol=0.06)
    assert 4.0 < np.degrees(scale[1]) < 6.0


def test_a_mirrored_left_arm_has_the_same_angles(body: dict[str, FloatArray]) -> None:
    left = {name: mirror_points(place) for name, place in body.items()}
    again = build_frame(UPPER_ARM, {name: mirror_points(place) for name, place in left.items()})
    assert np.allclose(again.rotation, build_frame(UPPER_ARM, body).rotation)
    flip = np.diag([1.0, 1.0, -1.0])
    rotation, velocity = so3.exp(np.array([0.3, -0.2, 0.9])), np.array([0.3, -0.2, 0.9])
    assert np.allclose(flip @ rotation @ flip, so3.exp(velocity * [-1, -1, 1]))


def test_missing_or_collinear_landmarks_are_told(body: dict[str, FloatArray]) -> None:
    with pytest.raises(RecordingError, match="EM"):
        build_frame(UPPER_ARM, {name: place for name, place in body.items() if name != "EM"})
    with pytest.raises(RecordingError, match="one line"):
        build_frame(FOREARM, {**body, "RS": body["US"]})
