"""Prediction of skin slides and joint errors in another movement."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.geometry import planar
from mocap_id.kinematics.chain_fit import ChainState
from mocap_id.kinematics.skin_slides import SkinModel, fit_skin, predict_skin

CENTRES = np.array([0.0 + 0.1j, 0.0 + 0.4j])
SEGMENT = np.repeat([1, 2], 4)
LOCAL = np.array([0.05 + 0.1j, -0.05 + 0.2j, 0.04 + 0.3j, -0.03 + 0.35j, 0.06 + 0.1j, -0.05 + 0.3j, 0.05 + 0.5j, 0.4j])
CAMERA = 3e-4


def swing(size: float, frames: int = 1200) -> np.ndarray:
    time = np.arange(frames) / 50
    return size * np.column_stack([np.sin(2.1 * time), np.sin(1.3 * time + 0.5)])


def found(size: float, slope: float = 0.02) -> SkinModel:
    """Return the model for markers that slide by ``slope`` m per radian of the joint below, in different directions."""
    q = swing(size)
    angle, origin = planar.segment_poses(q, np.column_stack([CENTRES.real, CENTRES.imag]))
    way = np.exp(1j * np.random.default_rng(1).uniform(0, 2 * np.pi, len(LOCAL)))
    slid = LOCAL + slope * way * q[:, SEGMENT - 1]
    turn = np.exp(1j * angle[:, SEGMENT])
    noise = np.random.default_rng(2).normal(size=(2, *slid.shape)) * CAMERA
    points = (origin @ [1, 1j])[:, SEGMENT] + turn * slid + noise[0] + 1j * noise[1]
    state = ChainState(CENTRES, LOCAL, np.cumsum(q, axis=1))
    return fit_skin(points, SEGMENT, state, np.arange(len(q)), CAMERA)


def centre_sd(skin: SkinModel) -> np.ndarray:
    """Return the errors of the centres (n, 2), m; the x of the second joint is a convention of the frame."""
    return np.asarray(np.sqrt(np.sum(skin.stored_chain_errors()[0] ** 2, axis=2)))


def test_in_its_own_movement_the_prediction_equals_the_fit() -> None:
    skin = found(0.5)
    again = predict_skin(skin, swing(0.5), CAMERA, 1200)
    np.testing.assert_allclose(again.size, skin.size, rtol=1e-9)
    np.testing.assert_allclose(again.spread, skin.spread)
    np.testing.assert_allclose(centre_sd(again)[:, 1], centre_sd(skin)[:, 1], rtol=0.1)


@pytest.mark.parametrize("size", [0.15, 0.8])
def test_in_another_movement_the_prediction_equals_a_fit_there(size: float) -> None:
    """Slides and joint errors, predicted from a movement of 0.4 rad, are compared with a recording of the other."""
    foreseen, there = predict_skin(found(0.4), swing(size), CAMERA, 1200), found(size)
    np.testing.assert_allclose(np.sqrt(foreseen.size), np.sqrt(there.size), rtol=0.2)
    np.testing.assert_allclose(foreseen.spread, there.spread, rtol=1e-6)
    np.testing.assert_allclose(centre_sd(foreseen)[0], centre_sd(there)[0], rtol=0.3)


def test_the_share_of_camera_noise_does_not_grow() -> None:
    skin = found(0.05, slope=0.0)
    larger = predict_skin(skin, swing(0.8), CAMERA, 1200)
    assert np.median(np.sqrt(larger.size / np.maximum(skin.size, 1e-18))) < 2.0
    assert np.max(np.sqrt(larger.size)) < CAMERA


def test_larger_arcs_reduce_the_effect_of_camera_noise() -> None:
    skin = found(0.3, slope=0.0)
    sds = [centre_sd(predict_skin(skin, swing(size), CAMERA, 1200))[:, 1] for size in (0.1, 0.3, 0.9)]
    assert np.all(sds[0] > 1.5 * sds[1])
    assert np.all(sds[1] > 1.5 * sds[2])
