"""Standard deviations with lasting errors: their parts, and their coverage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_chains import Moving, measured, swinging
from test_ukf_smooth_stage import NO_SEGMENTS, chain, planar

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation import States
from mocap_id.estimation.filter_problem import noise_shape, transition
from mocap_id.estimation.lasting_errors import add_lasting_errors, compute_residual_spectrum, estimate_camera_sd
from mocap_id.stages.base import Context
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.stages.ukf_smooth import STAGE, plane

FLOOR = 5e-5


def sliding(moving: Moving, size: float) -> Moving:
    """Return markers that slide by up to ``size`` (m) per radian of their joint, in different directions."""
    rng = np.random.default_rng(5)
    along = rng.standard_normal((len(moving.segment), 2))
    angle = moving.truth[:, :, 0] - moving.truth[:, :, 0].mean(axis=0)
    turn = np.exp(1j * np.cumsum(moving.truth[:, :, 0], axis=1))[:, moving.segment - 1]
    slid = size * angle[:, moving.segment - 1] * (along[:, 0] + 1j * along[:, 1]) * turn
    return replace(moving, markers=moving.markers + np.stack([slid.real, slid.imag], axis=2))


def alone(states: States, moving: Moving) -> np.ndarray:
    """Return standard deviations (F, n, 4) without lasting errors."""
    nothing = np.zeros((2, *states.sd.shape[1:]))
    frames = np.array([0, len(states.sd) - 1])
    return add_lasting_errors(states, moving.rate, camera(states, moving), frames, nothing)


def camera(states: States, moving: Moving) -> float:
    return estimate_camera_sd(np.where(states.used[..., None], moving.markers, np.nan), states, FLOOR)


@pytest.mark.parametrize("size", [0.0, 5e-3])
def test_camera_noise_is_separated_from_skin(size: float) -> None:
    moving = sliding(swinging(seconds=10, noise=5e-4), size)
    states = moving.smoothed()
    assert camera(states, moving) == pytest.approx(5e-4, rel=0.05)
    if size:
        assert states.marker_sd > 1e-3


def test_intervals_of_a_swing_cover_the_truth() -> None:
    """The filter's own intervals of acceleration are too wide, because it expects a more restless movement."""
    shares, theirs = [], []
    for seed in range(8):
        moving = swinging(seconds=8, seed=seed)
        states = moving.smoothed()
        off = np.abs(states.mean - moving.truth)
        shares.append(np.mean(off <= 1.96 * alone(states, moving), axis=(0, 1)))
        theirs.append(np.mean(off <= 1.96 * states.sd, axis=(0, 1)))
    held, said = np.mean(shares, axis=0), np.mean(theirs, axis=0)
    assert np.all((held[:3] > 0.92) & (held[:3] < 0.985))
    assert said[2] > held[2]


def test_a_movement_as_restless_as_the_model_is_covered() -> None:
    """With white snap, most of the movement removed by the smoother is detected."""
    rate, snap = 100.0, 300.0
    draw, step = np.linalg.cholesky(noise_shape(1 / rate)) * snap / np.sqrt(rate), transition(1 / rate)
    inside = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth = np.zeros((400, 1, 4))
        for k in range(1, len(truth)):
            truth[k, 0] = step @ truth[k - 1, 0] + draw @ rng.standard_normal(4)
        moving = measured(truth, rate, 1e-3, rng)
        states = moving.smoothed()
        off = states.mean - truth
        off[..., 0] -= 2 * np.pi * np.round(np.median(off[..., 0]) / (2 * np.pi))
        inside.append(np.mean(np.abs(off) <= 1.96 * alone(states, moving), axis=(0, 1)))
    held = np.mean(inside, axis=0)
    assert np.all(held[:2] > 0.9)
    assert held[2] > 0.8


def test_a_gap_stays_as_uncertain_as_the_filter_says() -> None:
    moving = swinging(seconds=6)
    markers = moving.markers.copy()
    markers[250:290, moving.segment == 3] = np.nan
    moving = replace(moving, markers=markers)
    states = moving.smoothed()
    sd = alone(states, moving)
    assert np.all(sd[265:275, 2, 0] > 0.9 * states.sd[265:275, 2, 0])
    assert sd[270, 2, 0] > 5 * sd[200, 2, 0]
    assert np.isfinite(sd).all()


def told(states: States, moving: Moving) -> tuple[float, IntArray, FloatArray] | None:
    rested = np.where(states.used[..., None], moving.markers, np.nan)
    skin = plane.estimate_skin(states, rested, camera(states, moving))
    if skin is None:
        return None
    spectrum = compute_residual_spectrum(states, rested, moving.rate)
    own = camera(states, moving)
    return own, *plane.estimate_lasting_errors(states, rested, skin, own, spectrum)


def test_skin_widens_the_angles() -> None:
    still, soft = swinging(seconds=6), sliding(swinging(seconds=6), 3e-3)
    firm, wide = (
        add_lasting_errors(states, moving.rate, *told(states, moving))
        for states, moving in ((moving.smoothed(), moving) for moving in (still, soft))
    )
    assert np.median(wide[..., 0]) > 3 * np.median(firm[..., 0])


def test_a_segment_never_seen_has_no_lasting_errors() -> None:
    moving = swinging(seconds=3)
    moving.markers[:, moving.segment == 3] = np.nan
    assert told(moving.smoothed(), moving) is None


@pytest.mark.parametrize(
    ("estimator", "holds"),
    [("bundle", plane.SKIN), ("circle", plane.NOISE), ("rigid-body", plane.NOISE)],
)
def test_the_table_states_the_parts_of_its_standard_deviations(estimator: str, holds: str) -> None:
    moving = swinging(joints=2, seconds=3)
    inputs: dict[str, Any] = {
        "planar.parquet": planar(moving, moving.markers),
        "segments.parquet": NO_SEGMENTS,
        "chain.h5": replace(chain(moving), facts={"estimator": estimator}),
    }
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("swing.c3d")))
    assert STAGE.function(Context(trial, STAGE.settings(), inputs))[0].facts["sd_holds"] == holds
