"""Encoder states as least squares, and clock, sign and zero from the common movement with the cameras."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.estimation.encoders import (
    START_SD,
    EncoderNoise,
    EncoderStates,
    estimate_encoder_noise,
    match_encoder,
    smooth_encoder,
)

RATE, OFFSET = 125.0, 0.0137
NOISE = EncoderNoise(1e-4, 1e-3, 20.0)


def swing(time: FloatArray, order: int = 0) -> FloatArray:
    """Return two swings between rests and their derivatives, rad."""
    step = 1e-4
    if order:
        return (swing(time + step, order - 1) - swing(time - step, order - 1)) / (2 * step)
    return 0.7 * np.exp(-(((time - 4.0) / 2.0) ** 4)) * np.sin(np.pi * (time - 4.0))


def record(seed: int, duration: float = 8.0, noise: EncoderNoise = NOISE) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration, 1 / RATE)
    errors = rng.normal(0, 1, (2, len(time))) * [[noise.position_sd], [noise.velocity_sd]]
    return time, swing(time) + errors[0], swing(time, 1) + errors[1]


def dense(
    times: FloatArray, rows: FloatArray, values: FloatArray, noise: EncoderNoise
) -> tuple[FloatArray, FloatArray]:
    """Return means and standard deviations (N, 3) by dense least squares: prior, steps and measurements."""
    size, equations, targets = 3 * len(times), [], []

    def add(at: int, whitened: FloatArray, target: FloatArray) -> None:
        wide = np.zeros((len(whitened), size))
        wide[:, at : at + whitened.shape[1]] = whitened
        equations.append(wide)
        targets.append(target)

    start = 1 / np.array(START_SD)
    add(0, np.diag(start), start * [values[0, 0], 0.0, 0.0])
    for k, dt in enumerate(np.diff(times)):
        step = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
        shape = [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
        root = np.linalg.cholesky(noise.density * np.array(shape))
        add(3 * k, np.linalg.solve(root, np.hstack([-step, np.eye(3)])), np.zeros(3))
    weights = 1 / np.array([noise.position_sd, noise.velocity_sd])
    for row, value in zip(rows, values, strict=True):
        add(3 * int(row), np.diag(weights) @ np.eye(2, 3), weights * value)
    q, r = np.linalg.qr(np.vstack(equations))
    inverse = np.linalg.inv(r)
    mean, variance = inverse @ q.T @ np.concatenate(targets), np.sum(inverse**2, axis=1)
    return mean.reshape(-1, 3), np.sqrt(variance).reshape(-1, 3)


def test_the_smoother_is_least_squares_over_all_samples_at_uneven_times() -> None:
    rng = np.random.default_rng(3)
    samples = np.cumsum(rng.uniform(0.01, 0.06, 30))
    wanted = np.r_[samples[0] - 0.03, samples[3:20] + 0.004, samples[-1] + 0.05]
    values = np.column_stack([swing(samples + 3.0), swing(samples + 3.0, 1)]) + rng.normal(0, 1e-3, (30, 2))
    noise = EncoderNoise(1e-3, 3e-3, 50.0)
    for at, times in ((None, samples), (wanted, wanted)):
        every = samples if at is None else np.sort(np.r_[samples, wanted])
        mean, sd = dense(every, np.searchsorted(every, samples), values, noise)
        found = smooth_encoder(samples, values[:, 0], values[:, 1], noise, at=at)
        rows = np.searchsorted(every, times)
        np.testing.assert_allclose(found.time, times)
        np.testing.assert_allclose(found.mean, mean[rows], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found.sd, sd[rows], rtol=1e-5)


def test_additional_times_change_nothing_at_the_samples() -> None:
    time, position, velocity = record(1, 3.0)
    own = smooth_encoder(time, position, velocity, NOISE)
    both = smooth_encoder(time, position, velocity, NOISE, at=np.linspace(0.1, 2.8, 800))
    again = smooth_encoder(time, position, velocity, NOISE, at=time)
    np.testing.assert_allclose(again.mean, own.mean, atol=1e-9)
    assert both.log_likelihood == pytest.approx(own.log_likelihood)


def test_a_parabola_without_noise_is_recovered_with_its_derivatives() -> None:
    time = np.arange(0.0, 2.0, 1 / RATE)
    angle, velocity = 0.3 - 0.4 * time + 0.9 * time**2, -0.4 + 1.8 * time
    found = smooth_encoder(time, angle, velocity, EncoderNoise(1e-4, 1e-3, 1.0), at=np.array([0.0305, 1.111, 1.97]))
    expected = [[0.3 - 0.4 * t + 0.9 * t**2, -0.4 + 1.8 * t, 1.8] for t in (0.0305, 1.111, 1.97)]
    np.testing.assert_allclose(found.mean, expected, atol=2e-5)


def test_noise_is_recovered_from_a_record_drawn_from_the_process() -> None:
    rng = np.random.default_rng(8)
    step, true = 1 / RATE, EncoderNoise(2e-4, 2e-3, 40.0)
    i, j = np.indices((3, 3))
    factor = np.array([2.0, 1.0, 1.0])  # (2 - i)!
    root = np.linalg.cholesky(true.density * step ** (5 - i - j) / (factor[i] * factor[j] * (5 - i - j)))
    states = np.zeros((3000, 3))
    for k in range(1, 3000):
        a, v, acc = states[k - 1]
        states[k] = [a + v * step + acc * step**2 / 2, v + acc * step, acc] + root @ rng.normal(0, 1, 3)
    time = step * np.arange(3000)
    position = states[:, 0] + rng.normal(0, true.position_sd, 3000)
    velocity = states[:, 1] + rng.normal(0, true.velocity_sd, 3000)
    found = estimate_encoder_noise(time, position, velocity)
    assert found.position_sd == pytest.approx(true.position_sd, rel=0.1)
    assert found.velocity_sd == pytest.approx(true.velocity_sd, rel=0.1)
    assert found.density == pytest.approx(true.density, rel=0.2)
    at_truth = smooth_encoder(time, position, velocity, true).log_likelihood
    assert smooth_encoder(time, position, velocity, found).log_likelihood >= at_truth - 0.05
    given = estimate_encoder_noise(time, position, velocity, position_sd=1e-3)
    assert given.position_sd == 1e-3


def test_states_of_a_swing_are_right_within_their_standard_deviations() -> None:
    time, position, velocity = record(2)
    at = np.arange(0.5, 7.5, 1 / 480.0)
    found = smooth_encoder(time, position, velocity, estimate_encoder_noise(time, position, velocity), at=at)
    truth = np.column_stack([swing(at, order) for order in range(3)])
    share = np.mean(np.abs(found.mean - truth) < 1.96 * found.sd, axis=0)
    assert (share > 0.85).all()
    r2 = 1 - np.var(found.mean - truth, axis=0) / np.var(truth, axis=0)
    assert (r2 > (0.9999999, 0.999999, 0.998)).all()


def fused(seed: int) -> EncoderStates:
    time, position, velocity = record(seed)
    return smooth_encoder(time, position, velocity, NOISE)


def cameras(seed: int, sign: int, zero: float = 0.2, noise: float = 3e-4) -> tuple[FloatArray, FloatArray]:
    """Return the joint angle by cameras at 200 Hz, with correlated noise and missing frames."""
    rng = np.random.default_rng(100 + seed)
    time = np.arange(0.2, 7.8, 1 / 200.0)
    rough = np.convolve(rng.normal(0, noise, len(time) + 9), np.full(10, 10**-0.5), "valid")
    angle = sign * swing(time - OFFSET) + zero + rough
    angle[300:330] = np.nan
    return time, angle


@pytest.mark.parametrize("sign", [1, -1])
def test_clock_sign_and_zero_are_found(sign: int) -> None:
    time, angle = cameras(0, sign)
    found = match_encoder(time, angle, fused(0), 0.5)
    assert found is not None
    assert found.sign == sign
    assert found.offset == pytest.approx(OFFSET, abs=4 * found.offset_sd)
    assert found.zero == pytest.approx(0.2, abs=4 * found.zero_sd)
    assert found.offset_sd < 5e-4
    assert found.r2 > 0.999
    assert found.gain == pytest.approx(1.0, abs=0.01)
    assert not found.at_edge
    states = np.array([[0.1, 2.0, -3.0]])
    np.testing.assert_allclose(found.express_in_plane(states), [[found.zero + sign * 0.1, sign * 2.0, sign * -3.0]])
    np.testing.assert_allclose(states, [[0.1, 2.0, -3.0]])


def test_the_standard_deviation_of_the_clock_covers_the_error() -> None:
    """Differences are correlated over frames; the white-noise formula would be three times too small."""
    encoder, off = fused(0), []
    for seed in range(60):
        found = match_encoder(*cameras(seed, 1), encoder, 0.1)
        assert found is not None
        off.append([(found.offset - OFFSET) / found.offset_sd, (found.zero - 0.2) / found.zero_sd])
    assert 0.7 < np.sqrt(np.mean(np.square(off), axis=0))[0] < 1.4
    assert 0.7 < np.sqrt(np.mean(np.square(off), axis=0))[1] < 1.4


def test_a_clock_beyond_the_search_and_another_record_are_detected() -> None:
    time, angle = cameras(0, 1)
    beyond = match_encoder(time, angle, fused(0), 0.01)
    assert beyond is not None and beyond.at_edge
    assert match_encoder(time + 60.0, angle, fused(0), 0.5) is None


def test_degrees_show_as_a_gain() -> None:
    time, angle = cameras(0, 1)
    _, position, velocity = record(0)
    turned = smooth_encoder(record(0)[0], np.degrees(position), np.degrees(velocity), EncoderNoise(6e-3, 6e-2, 6e4))
    found = match_encoder(time, angle, turned, 0.1)
    assert found is not None
    assert found.gain * 180 / np.pi == pytest.approx(1.0, rel=0.02)
