"""Errors of poses that repeat with the movement: what they do to the fit, against fits to poses that are off so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pose_cases import BODIES, moving, poses_of, recorded_of

from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.instrument_errors import propagate_pose_errors, propagate_slides
from mocap_id.dynamics.measured_motion import BodyPoses, filter_motion
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, prepare
from mocap_id.dynamics.priors import build_table_prior
from mocap_id.dynamics.regressor import torque_regressor, wrench_regressor
from mocap_id.geometry import planar
from mocap_id.kinematics.joint import planar_poses

TIME = np.arange(2000) / 100
INNER = slice(300, -300)
EVERYTHING = np.ones(len(TIME), dtype=bool)
BANDS = (5.0, 5.0, 5.0)
PRIOR = build_table_prior((BODIES * [1.1, 0.9, 1.1, 1.2]).ravel(), "", others=True)
STILL: tuple[np.ndarray, tuple[int, ...]] = (np.zeros((3, 3)), ())
LOCAL = np.array([[0.05, 0.02], [0.31, -0.04], [0.12, 0.2], [-0.04, 0.11]])


def made(poses: BodyPoses) -> PreparedTrial:
    recorded = recorded_of(TIME, moving(TIME), noise=(1.0, 1.0, 0.3))
    return prepare(replace(recorded, measured=filter_motion(poses, BANDS)), FitSettings(), PRIOR)


def off(poses: BodyPoses, body: int, shape: np.ndarray, error: np.ndarray) -> BodyPoses:
    """One body's pose off by (x, y in its frame, angle) times a shape."""
    position, angle = poses.position.copy(), poses.angle.copy()
    position[:, body] += planar.rotate(angle[:, body], error[:2]) * shape[:, None]
    angle[:, body] += error[2] * shape
    return replace(poses, position=position, angle=angle)


def refitted(prepared: PreparedTrial, found: Fit) -> np.ndarray:
    """Parameters, bias and clock with another regressor, of a wrench and a prior that the true bodies fit exactly."""
    truth = np.append(BODIES.ravel(), [0.0, 0.0])
    rows = prepared.filtered[found.samples] * found.weights[:, None]
    columns = np.concatenate([rows, found.design[..., 20:]], axis=-1).reshape(found.target.size, -1)
    assert found.prior is not None
    prior = np.pad(found.prior[0], ((0, 0), (0, 1)))
    wrench = found.design.reshape(columns.shape) @ truth
    both = np.concatenate([columns, prior]), np.concatenate([wrench, prior @ truth])
    return np.asarray(np.linalg.lstsq(*both, rcond=None)[0])


def torques(prepared: PreparedTrial, full: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Torques of moving bodies about given places."""
    return np.asarray(torque_regressor(replace(prepared.motion, joint=joint), wrench_regressor(prepared.motion)) @ full)


@pytest.mark.parametrize(("body", "joint"), [(1, 0), (2, 1), (3, 2), (4, 2)])
@pytest.mark.parametrize("axis", range(3))
def test_an_error_does_what_a_fit_to_poses_with_it_shows(body: int, joint: int, axis: int) -> None:
    poses = poses_of(TIME, moving(TIME))
    prepared = made(poses)
    found = fit(prepared, EVERYTHING)
    size = np.array([0.001, 0.001, 0.004])[axis]
    variance = np.diag(np.eye(3)[axis] * size**2)
    sliding = tuple((variance, (joint,)) if k == body else STILL for k in range(5))
    modes, torque = propagate_pose_errors(prepared, found, BODIES.ravel(), poses, sliding=sliding, bands=BANDS)
    angle = prepared.recorded.q[:, joint]
    own = angle[found.in_fit]
    shape, small = (angle - own.mean()) / own.std(), 0.05
    both = [made(off(poses, body, shape, sign * small * size * np.eye(3)[axis])) for sign in (1, -1)]
    after = [refitted(each, found) for each in both]
    moved = (after[0] - after[1]) / (2 * small)
    sd = np.sqrt(np.diag(found.covariance))
    said = modes[:, np.argmax(np.abs(modes).max(axis=0))]  # the one mode that is not zero
    said = said * np.sign(said @ (moved / sd**2))
    np.testing.assert_allclose(said / sd, moved / sd, atol=0.05 * np.abs(moved / sd).max())
    joint_centres = prepared.motion.joint  # their errors are counted elsewhere
    felt = torques(both[0], after[0][:20], joint_centres) - torques(both[1], after[1][:20], joint_centres)
    felt = felt / (2 * small)
    size_of = np.sqrt(torque)
    np.testing.assert_allclose(size_of[INNER], np.abs(felt)[INNER], atol=0.06 * np.abs(felt[INNER]).max())


def test_modes_of_all_bodies_and_joints_add_up() -> None:
    """An error that follows two joints is shared between them; parts of a covariance add up to the whole."""
    poses = poses_of(TIME, moving(TIME))
    prepared = made(poses)
    found = fit(prepared, EVERYTHING)
    full = found.problem.free_solution()[:20]
    root = np.array([[1e-3, 0.0, 0.0], [2e-4, 8e-4, 0.0], [1e-3, -1e-3, 3e-3]])
    covariance = root @ root.T

    def effect(body: int, matrix: np.ndarray, joints: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        sliding = tuple((matrix, joints) if k == body else STILL for k in range(5))
        modes, torque = propagate_pose_errors(prepared, found, full, poses, sliding=sliding, bands=BANDS)
        return modes @ modes.T, torque

    whole, torque = effect(2, covariance, (1, 2))
    parts = [effect(2, covariance / 2, (joint,)) for joint in (1, 2)]
    np.testing.assert_allclose(whole, parts[0][0] + parts[1][0], atol=1e-6 * np.abs(whole).max())
    np.testing.assert_allclose(torque[INNER], (parts[0][1] + parts[1][1])[INNER], rtol=1e-6)
    columns = [effect(3, np.outer(column, column), (2,)) for column in root.T]
    both = effect(3, covariance, (2,))
    np.testing.assert_allclose(both[0], sum(each[0] for each in columns), atol=1e-4 * np.abs(both[0]).max())
    np.testing.assert_allclose(both[1][INNER], sum(each[1] for each in columns)[INNER], rtol=1e-3)


def test_poses_without_errors_leave_everything_as_it_is() -> None:
    poses = poses_of(TIME, moving(TIME))
    prepared = made(poses)
    found = fit(prepared, EVERYTHING)
    modes, torque = propagate_pose_errors(prepared, found, BODIES.ravel(), poses, sliding=(STILL,) * 5, bands=BANDS)
    assert modes.shape == (22, 0)
    assert (torque == 0.0).all()


def test_sliding_markers_move_the_pose_as_rigid_fits_say() -> None:
    rng = np.random.default_rng(0)
    sd = np.array([1e-3, 2e-3, 0.5e-3, 1.5e-3])
    template = LOCAL @ np.array([1.0, 1.0j])
    slides = sd * (rng.normal(size=(40_000, 4)) + 1j * rng.normal(size=(40_000, 4)))
    z = template + slides
    middle = template.mean()
    rotation, position = planar_poses(z, np.ones(z.shape, dtype=bool), template - middle)
    errors = np.stack([position.real - middle.real, position.imag - middle.imag, np.angle(rotation)])
    found = propagate_slides(LOCAL, sd**2)
    size = np.sqrt(np.diag(found))
    np.testing.assert_allclose(np.cov(errors) / np.outer(size, size), found / np.outer(size, size), atol=0.03)


def test_equal_slides_move_the_middle_by_their_mean_and_turn_by_their_spread() -> None:
    found = propagate_slides(LOCAL, np.full(4, 1e-6))
    spread = np.sum((LOCAL - LOCAL.mean(axis=0)) ** 2)
    np.testing.assert_allclose(found, np.diag([1e-6 / 4, 1e-6 / 4, 1e-6 / spread]), atol=1e-18)
