"""The filter in space agrees with a dense fit of all frames at once, and with the smoother of the plane."""

from __future__ import annotations

import numpy as np
from spatial_cases import mixed_chain, positions

from mocap_id.arrays import FloatArray
from mocap_id.estimation import FilterSettings, smooth
from mocap_id.estimation.filter_problem import MarkerChain, noise_shape, start_sd, transition
from mocap_id.estimation.space.frame_poses import (
    ChainModel,
    FramePoses,
    degrees_of_freedom,
    find_frame_poses,
    group_columns,
    make_chain_model,
)
from mocap_id.estimation.space.space_kernels import Pose
from mocap_id.estimation.space.space_smoothing import SpatialNoise, SpatialTrack, filter_and_smooth
from mocap_id.geometry import so3
from mocap_id.geometry.planar import marker_positions
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint

SD = 1e-4
RATE = 100.0


def swinging(chain: SpatialChain, model: ChainModel, frames: int, rng: np.random.Generator) -> FloatArray:
    """Return measured markers of a chain whose joints all swing."""
    d, time = degrees_of_freedom(model), np.arange(frames)[:, None] / RATE
    q = 0.15 * np.sin(2 * np.pi * rng.uniform(0.4, 1.0, d) * time + rng.uniform(0, 6, d))
    turns = [joint.rotation(q[:, own]) for joint, own in zip(chain.joints, group_columns(model)[1:], strict=True)]
    exact = positions(chain, 0.1 * q[:, :3], so3.exp(q[:, 3:6]), np.stack(turns, axis=1))
    return exact + SD * rng.standard_normal(exact.shape)


def smoothed(
    chain: SpatialChain, model: ChainModel, points: FloatArray, snap: FloatArray
) -> tuple[FramePoses, SpatialTrack]:
    size = np.full(points.shape[1], SD)
    frames = find_frame_poses(chain, model, points, size, rate=RATE, gate=20.0)
    noise = SpatialNoise(SD, size, snap, snap, np.full((3, len(snap)), np.nan))
    track = filter_and_smooth(model, points, 1 / RATE, frames, noise, gate=20.0, gate_sd=size)
    return frames, track


def add(chain: SpatialChain, model: ChainModel, pose: Pose, by: FloatArray) -> Pose:
    """Move F poses by (F, 4, d), from the definition of the state."""
    new = Pose(*(each.copy() for each in pose))
    new.origin[:] += by[:, 0, :3]
    new.turn[:, 0] = new.turn[:, 0] @ so3.exp(by[:, 0, 3:6])
    for k, (joint, own) in enumerate(zip(chain.joints, group_columns(model)[1:], strict=True)):
        if joint.kind == "ball":
            new.turn[:, k + 1] = new.turn[:, k + 1] @ so3.exp(by[:, 0, own])
        else:
            new.angle[:, k, : joint.dimension] += by[:, 0, own]
            new.turn[:, k + 1] = joint.rotation(new.angle[:, k, : joint.dimension])
    new.rate[:] += by[:, 1:]
    return new


def subtract(model: ChainModel, end: Pose, start: Pose) -> FloatArray:
    """Return the tangent vectors (F, 4, d) from ``start`` to ``end``."""
    found = np.empty((len(end.origin), 4, end.rate.shape[2]))
    found[:, 0, :3] = end.origin - start.origin
    found[:, 0, 3:6] = so3.log(np.swapaxes(start.turn[:, 0], 1, 2) @ end.turn[:, 0])
    for k, own in enumerate(group_columns(model)[1:]):
        if model.ball[k]:
            found[:, 0, own] = so3.log(np.swapaxes(start.turn[:, k + 1], 1, 2) @ end.turn[:, k + 1])
        else:
            found[:, 0, own] = (end.angle - start.angle)[:, k, : own.stop - own.start]
    found[:, 1:] = end.rate - start.rate
    return found


def advanced(chain: SpatialChain, model: ChainModel, pose: Pose) -> Pose:
    """Return the poses one step later."""
    step = transition(1 / RATE)[0]
    by = np.zeros((len(pose.origin), 4, pose.rate.shape[2]))
    by[:, 0] = np.einsum("e,fed->fd", step[1:], pose.rate)
    groups = [slice(3, 6)] + [own for k, own in enumerate(group_columns(model)[1:]) if model.ball[k]]
    for own in groups:
        by[:, 0, own] += np.cross(pose.rate[:, 0, own], pose.rate[:, 1, own]) / (12 * RATE**3)
    by[:, 1] = step[1] * pose.rate[:, 1] + step[2] * pose.rate[:, 2]
    by[:, 2] = step[1] * pose.rate[:, 2]
    return add(chain, model, pose, by)


def test_agrees_with_a_dense_fit_of_all_frames() -> None:
    rng = np.random.default_rng(3)
    chain = mixed_chain(rng)
    model = make_chain_model(chain)
    count, d = 10, degrees_of_freedom(model)
    points, snap = swinging(chain, model, count, rng), np.full(d, 2e3)
    points[4:7, -3:] = np.nan  # the hinge is shown by one marker
    frames, track = smoothed(chain, model, points, snap)
    whitener = np.linalg.inv(np.linalg.cholesky(np.kron(noise_shape(1 / RATE), np.diag(snap**2 / RATE))))
    first = Pose(*(each[:1] for each in frames.track))

    def residuals(pose: Pose) -> FloatArray:
        seen = np.isfinite(points)
        marker = (positions(chain, pose.origin, pose.turn[:, 0], pose.turn[:, 1:]) - points)[seen] / SD
        start = subtract(model, Pose(*(each[:1] for each in pose)), first)[0] / start_sd(1 / RATE)[:, None]
        before = Pose(*(each[:-1] for each in pose))
        steps = subtract(model, Pose(*(each[1:] for each in pose)), advanced(chain, model, before))
        return np.concatenate([marker, start.ravel(), (steps.reshape(count - 1, -1) @ whitener.T).ravel()])

    scale = np.tile(np.repeat(start_sd(1 / RATE), d), count) * 1e-7
    pose = track.pose
    for _ in range(2):
        here = residuals(pose)
        columns = []
        for c in range(4 * d * count):
            by = np.zeros(4 * d * count)
            by[c] = scale[c]
            columns.append((residuals(add(chain, model, pose, by.reshape(count, 4, d))) - here) / scale[c])
        jacobian = np.stack(columns, axis=1)
        unit = np.linalg.norm(jacobian, axis=0)
        root = np.linalg.qr(jacobian / unit, mode="r")
        inverse = np.linalg.inv(root) / unit[:, None]
        change = -inverse @ (inverse.T @ (jacobian.T @ here))
        pose = add(chain, model, pose, change.reshape(count, 4, d))
    sd = np.sqrt(np.sum(inverse**2, axis=1)).reshape(count, 4 * d)
    own = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    off = subtract(model, pose, track.pose).reshape(count, 4 * d)
    assert np.max(np.abs(off) / sd) < 0.1
    np.testing.assert_allclose(own, sd, rtol=0.02)


def test_a_planar_chain_agrees_with_the_smoother_of_the_plane() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(200)[:, None] / RATE
    angles = np.sin(2 * np.pi * np.array([0.5, 0.8]) * time + [0.0, 1.0])
    centres = np.array([[0.0, 0.0], [0.02, 0.4]])
    segment, local = np.repeat([1, 2], 4), rng.uniform([-0.08, 0.05], [0.08, 0.4], (8, 2))
    flat = marker_positions(angles, centres, segment, local)
    flat += SD * rng.standard_normal(flat.shape)
    planar = smooth(
        flat, RATE, MarkerChain(centres, segment, local), settings=FilterSettings(marker_sd=SD, sigma_v=500.0)
    )
    joints = tuple(
        SpatialJoint("hinge", k, np.append(centre, 0.0), first_axis=np.array([0.0, 0.0, 1.0]))
        for k, centre in enumerate(centres)
    )
    fixed = np.tile(
        [[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 9.0]], (100, 1)
    )  # they hold the base
    chain = SpatialChain(
        joints,
        np.concatenate([np.zeros(400, dtype=np.int64), segment]),
        np.vstack([fixed, np.column_stack([local, np.zeros(8)])]),
        np.zeros(408, dtype=np.bool_),
    )
    model = make_chain_model(chain)
    points = np.concatenate([np.broadcast_to(fixed, (200, 400, 3)), np.dstack([flat, np.zeros((200, 8))])], axis=1)
    snap = np.array([1e-1] * 6 + [500.0, 500.0])
    track = smoothed(chain, model, points, snap)[1]
    found = np.stack([track.pose.angle[:, :, 0], *(track.pose.rate[:, e, 6:] for e in range(3))], axis=2)
    spread = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2)).reshape(200, 4, 8)[:, :, 6:].swapaxes(1, 2)
    clear = slice(40, -40)
    assert np.max(np.abs(found - planar.mean)[clear] / planar.sd[clear]) < 0.05
    np.testing.assert_allclose(spread[clear], planar.sd[clear], rtol=0.02)
