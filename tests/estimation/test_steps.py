"""A marker that slid and vanishes steps the angle: by how much is told from its residual, and allowed for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_chains import Moving, measured

from mocap_id.arrays import FloatArray
from mocap_id.estimation import States
from mocap_id.estimation.inverse import Chain
from mocap_id.estimation.steps import stepping_errors

EDGE = 500
SETTINGS = {"marker_sd": 5e-4, "sigma_v": 100.0}


def allowed(moving: Moving, states: States) -> FloatArray:
    """(F, n, 4) standard deviations of the steps alone."""
    chain = Chain(moving.centres, moving.segment, moving.local)
    return np.sqrt(stepping_errors(states, moving.markers, states.mean[..., 0], moving.rate, chain))


def slid(size: float, *, vanish: bool = True) -> Moving:
    """A chain at rest; a marker of the second segment is off by so much, m, throughout, and vanishes halfway."""
    truth = np.zeros((2 * EDGE, 2, 4))
    truth[..., 0] = [0.3, -0.8]
    moving = measured(truth, 100.0, 2e-5, np.random.default_rng(6))
    markers = moving.markers.copy()
    markers[:, 5, 0] += size
    if vanish:
        markers[EDGE:, 5] = np.nan
    return replace(moving, markers=markers)


def test_nothing_is_added_where_no_marker_comes_or_goes() -> None:
    moving = slid(0.0, vanish=False)
    assert not allowed(moving, moving.smoothed()).any()


def test_a_step_is_allowed_for_where_it_is_and_as_far_as_it_goes() -> None:
    moving = slid(0.004)
    states = moving.smoothed(**SETTINGS)
    error, sd = np.abs(states.mean - moving.truth), allowed(moving, states)
    quiet, near = slice(100, 300), slice(EDGE - 100, EDGE + 100)
    # the mean square is spread over the smoother's memory, and kept; its pass band is taken joint by joint, which in a
    # chain, whose angles are correlated, is up to a fifth too low, and counts twice for the acceleration
    for order, exact in ((1, 0.2), (2, 0.4)):
        bump, said = (np.sqrt(np.mean(part[near, :, order] ** 2, axis=0)) for part in (error, sd))
        assert np.all(bump > 3 * np.sqrt(np.mean(error[quiet, :, order] ** 2, axis=0)))
        np.testing.assert_allclose(said, bump, rtol=exact)
        assert np.all(sd[quiet, :, order] < 0.02 * said)
        rising = sd[:, :, order] > error[quiet, :, order].max(axis=0)
        assert np.all(error[..., order][rising] < 5 * sd[..., order][rising])
        assert np.all(np.count_nonzero(rising, axis=0) > 5)
    assert not sd[..., 0].any()


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_it_grows_with_the_slide(share: float) -> None:
    one, other = (slid(size) for size in (0.003, 0.003 * share))
    ratio = [allowed(each, each.smoothed(**SETTINGS))[EDGE, :, 1] for each in (one, other)]
    np.testing.assert_allclose(ratio[1] / ratio[0], share, rtol=0.05)
