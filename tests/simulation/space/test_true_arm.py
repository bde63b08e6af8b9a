"""Truth of a simulated arm: frames, rates and bodies agree with each other and with the definitions of the ISB."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mocap_id.errors import ConfigError
from mocap_id.geometry import so3
from mocap_id_simulation import simulate_arm, simulate_chain
from mocap_id_simulation.arm import FOREARM, HAND, THORAX, UPPER_ARM
from mocap_id_simulation.arm_files import reach_volume
from mocap_id_simulation.sit_to_stand import X, Y, Z

FINE = 480.0  # Hz, for differences


@pytest.fixture(scope="module")
def reach():
    return simulate_arm(7, cycles=1, rate=FINE)


@pytest.fixture(scope="module")
def curl():
    return simulate_arm(8, movement="curl", repetitions=3, failed=1, compensation=1.0)


@pytest.fixture(scope="module")
def chain():
    return simulate_chain(9, "STH", sway_mm=10, rate=FINE)


def unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def frame(y, normal, *, to):
    """Return rotations with the given y, and ``normal`` as x or z."""
    y = unit(y)
    if to == "x":
        x = unit(normal)
        return np.stack([x, y, np.cross(x, y)], axis=-1)
    z = unit(normal)
    return np.stack([np.cross(y, z), y, z], axis=-1)


@pytest.mark.parametrize("name", ["reach", "chain"])
def test_angular_velocity_and_acceleration_are_derivatives(name, request):
    trial = request.getfixturevalue(name)
    step = 2 / trial.rate
    turned = so3.log(np.swapaxes(trial.rotations[:-2], -1, -2) @ trial.rotations[2:])
    omega = np.einsum("fsij,fsj->fsi", trial.rotations[1:-1], turned) / step
    np.testing.assert_allclose(omega, trial.omega[1:-1], atol=3e-4)
    np.testing.assert_allclose((trial.omega[2:] - trial.omega[:-2]) / step, trial.alpha[1:-1], atol=4e-3)


def test_rates_and_accelerations_of_the_angles_are_derivatives(reach):
    for name, angle in reach.angles.items():
        for low, high in ((angle, reach.rates[name]), (reach.rates[name], reach.accelerations[name])):
            np.testing.assert_allclose(CubicSpline(reach.time, low)(reach.time, 1)[5:-5], high[5:-5], atol=2e-4)


def test_landmarks_give_the_frames_of_the_isb(reach):
    origins, rotations, body = reach.origins, reach.rotations, reach.document["body"]

    def at(name):
        segment, local = body.landmarks[name]
        return origins[:, segment] + rotations[:, segment] @ local

    below, above = (at("PX") + at("T8")) / 2, (at("IJ") + at("C7")) / 2
    thorax = frame(above - below, np.cross(at("IJ") - below, at("C7") - below), to="z")
    elbow = (at("EL") + at("EM")) / 2
    long = origins[:, UPPER_ARM] - elbow
    upper_arm = frame(long, np.cross(long, at("EL") - at("EM")), to="x")
    fore = elbow - at("US")
    forearm = frame(fore, np.cross(fore, at("RS") - at("US")), to="x")
    for segment, expected in ((THORAX, thorax), (UPPER_ARM, upper_arm), (FOREARM, forearm)):
        np.testing.assert_allclose(rotations[:, segment], expected, atol=1e-12)
    np.testing.assert_allclose(origins[:, FOREARM], elbow, atol=1e-12)
    np.testing.assert_allclose(origins[:, HAND], (at("RS") + at("US")) / 2, atol=1e-12)


def test_angles_compose_to_the_rotations(reach):
    a = {name: values[:, None] for name, values in reach.angles.items()}
    shoulder = so3.exp(a["shoulder_plane"] * Y) @ so3.exp(-a["shoulder_elevation"] * X)
    shoulder = shoulder @ so3.exp(a["shoulder_axial"] * Y)
    elbow = so3.exp(a["elbow_flexion"] * Z) @ so3.exp(a["elbow_carrying"] * X) @ so3.exp(a["elbow_pronation"] * Y)
    wrist = so3.exp(a["wrist_flexion"] * Z) @ so3.exp(a["wrist_deviation"] * X)
    for segment, joint in ((THORAX, shoulder), (UPPER_ARM, elbow), (FOREARM, wrist)):
        child = reach.rotations[:, segment] @ joint
        np.testing.assert_allclose(reach.rotations[:, segment + 1], child, atol=1e-12)


def test_the_shoulder_glides_with_elevation(reach):
    body, elevation = reach.document["body"], reach.angles["shoulder_elevation"]
    seen = np.einsum("fji,fj->fi", reach.rotations[:, THORAX], reach.origins[:, UPPER_ARM] - reach.origins[:, THORAX])
    np.testing.assert_allclose(seen - body.shoulder, np.outer((1 - np.cos(elevation)) / 2, body.glide), atol=1e-12)
    assert np.linalg.norm(body.glide) == pytest.approx(0.015)


def test_distances_are_constant_without_soft_tissue():
    trial = simulate_arm(3, "clean", cycles=1)
    np.testing.assert_array_equal(trial.positions, trial.true_positions)
    for segment in range(4):
        on = np.array([k for k, name in enumerate(trial.names) if trial.assignment[k] == segment and name != "AC"])
        points = trial.positions[:, on]
        distances = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
        np.testing.assert_allclose(distances, np.broadcast_to(distances[0], distances.shape), atol=1e-12)


def test_soft_tissue_is_zero_in_the_still_start_and_grows_with_the_preset():
    default, hard = simulate_arm(4, cycles=1), simulate_arm(4, "hard", cycles=1)
    still = default.time < default.still
    assert np.abs(default.omega[still]).max() < 1e-6
    assert np.abs(default.skin[0]).max() == 0
    skin = [np.sqrt((each.skin**2).sum(axis=2).mean(axis=0)) for each in (default, hard)]
    upper = np.array([name.startswith("UPA") for name in default.names])
    assert 5e-3 < skin[0][upper].mean() < 12e-3
    assert 1.3 < skin[1][upper].mean() / skin[0][upper].mean() < 2.1


def test_a_person_keeps_bones_and_markers_in_another_trial():
    first, second = simulate_arm(1, subject=5, cycles=1), simulate_arm(2, movement="curl", subject=5, repetitions=1)
    np.testing.assert_array_equal(first.local, second.local)
    assert first.document["body"].upper_arm == second.document["body"].upper_arm
    assert not np.array_equal(first.positions[:50], second.positions[:50])


def test_a_left_arm_is_the_mirror_image():
    right, left = simulate_arm(6, cycles=1), simulate_arm(6, cycles=1, side="left")
    np.testing.assert_allclose(left.true_positions, right.true_positions * (1, -1, 1), atol=1e-15)
    np.testing.assert_array_equal(left.rotations, right.rotations)


def test_curls_are_counted_by_their_tops(curl):
    hinge = curl.arrays["q_hinge"][:, 0]
    protocol = curl.document["protocol"]
    tops = [np.interp((each["top"] + each["top_end"]) / 2, curl.time, hinge) for each in protocol["repetitions"]]
    failed = [np.interp((each["start"] + each["end"]) / 2, curl.time, hinge) for each in protocol["partials"]]
    assert len(tops) == 3
    assert len(failed) == 1
    assert min(tops) > np.radians(110) > np.radians(70) > max(failed)
    assert np.linalg.norm(curl.document["body"].glide) == 0


def test_joints_of_a_chain_are_where_and_what_they_are_said_to_be(chain):
    said = chain.document
    for k, (kind, centre) in enumerate(zip(said["types"], said["joint_in_parent_m"], strict=True)):
        placed = chain.origins[:, k] + chain.rotations[:, k] @ np.array(centre)
        np.testing.assert_allclose(chain.origins[:, k + 1], placed, atol=1e-12)
        turned = so3.log(chain.arrays["joint_R"][:, k])
        axes = np.array(said["joint_axes"][k])
        assert axes.shape[1] == {"S": 3, "T": 2, "H": 1}[kind]
        if kind == "H":
            np.testing.assert_allclose(np.cross(turned, axes[:, 0]), 0, atol=1e-12)
            assert np.abs(turned @ axes[:, 0]).max() == pytest.approx(np.radians(40), rel=0.01)
        if kind == "T":
            between = np.einsum("i,fij,j->f", axes[:, 0], chain.arrays["joint_R"][:, k], axes[:, 1])
            np.testing.assert_allclose(between, axes[:, 0] @ axes[:, 1], atol=1e-12)
    still = chain.origins[chain.time < chain.still]
    np.testing.assert_allclose(still, np.broadcast_to(chain.origins[0], still.shape), atol=1e-9)


def test_the_volume_of_a_simple_arm_is_that_of_a_spherical_shell():
    body = simulate_arm(1, "clean", cycles=1, glide_mm=0).document["body"]
    box = np.array([[-np.pi, np.pi], [1e-3, np.pi - 1e-3], [-np.pi, np.pi], [np.radians(20), np.radians(140)]])
    volume, _ = reach_volume(body, box, 0.0)
    far, near = (np.sqrt(np.array(_cosine_rule(body.upper_arm, body.forearm, np.radians(a)))) for a in (20, 140))
    assert volume == pytest.approx(4 / 3 * np.pi * (far**3 - near**3), rel=0.03)


def _cosine_rule(first, second, flexion):
    return first**2 + second**2 + 2 * first * second * np.cos(flexion)


@pytest.mark.parametrize(
    ("simulate", "options"),
    [
        (simulate_arm, {"severity": 2.0}),
        (simulate_arm, {"preset": "easy"}),
        (simulate_arm, {"subject": -1}),
        (simulate_chain, {"kinds": "SX"}),
        (simulate_chain, {"kinds": ""}),
        (simulate_chain, {"arc_deg": -1}),
    ],
)
def test_impossible_options_are_refused(simulate, options):
    with pytest.raises(ConfigError, match=next(iter(options))):
        simulate(**options)
