"""A ball joint defined outside the package works with every function of a chain."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from geometry_cases import laws, random_masses, random_pose, seeds
from hypothesis import given
from scipy.spatial.transform import Rotation

from mocap_id.geometry import (
    Chain,
    Revolute,
    body_product,
    inverse_dynamics,
    link_motion,
    se3,
    so3,
    spatial_inertia,
    spatial_jacobian,
    spatial_product,
)


class Ball:
    """Ball joint with a rotation vector as coordinates."""

    dimension = 3
    twists = np.eye(6)[:, 3:]

    def subspace(self, q):
        angle = np.linalg.norm(q, axis=-1)[..., None, None]
        _, second = so3.exp_coefficients(angle)
        cross = so3.hat(q)
        right = np.eye(3) - second * cross + (1 - np.sinc(angle / np.pi)) / angle**2 * (cross @ cross)
        return np.concatenate([np.zeros_like(right), right], axis=-2)

    def subspace_rate(self, q, dq):
        step = 1e-6
        return (self.subspace(q + step * dq) - self.subspace(q - step * dq)) / (2 * step)


def random_case(seed: int):
    rng = np.random.default_rng(seed)
    joints = (Revolute((1.0, 2.0, 3.0)), Ball(), Revolute((0.0, 1.0, 0.0)))
    chain = Chain(joints, np.stack([random_pose(rng) for _ in joints]))
    return rng, chain, *rng.uniform(-1, 1, size=(3, chain.dimension))


@laws
@given(seeds)
def test_products_and_jacobian(seed):
    rng, chain, q, dq, ddq = random_case(seed)
    tool = random_pose(rng)
    np.testing.assert_allclose(spatial_product(chain, q, tool), chain.tool_pose(q, tool), atol=1e-12)
    np.testing.assert_allclose(body_product(chain, q, tool), chain.tool_pose(q, tool), atol=1e-12)
    step = 1e-6
    g = chain.poses(q)[-1]
    change = (chain.poses(q + step * dq)[-1] - chain.poses(q - step * dq)[-1]) / (2 * step)
    np.testing.assert_allclose(spatial_jacobian(chain, q) @ dq, se3.vee_twist(change @ se3.inverse(g)), atol=1e-7)
    velocity = link_motion(chain, q, dq, ddq, np.zeros(6))[1][-1]
    np.testing.assert_allclose(velocity, se3.vee_twist(se3.inverse(g) @ change), atol=1e-7)


@laws
@given(seeds)
def test_wrenches_agree_with_pinocchio(seed):
    rng, chain, q, dq, ddq = random_case(seed)
    mass, centre, about = random_masses(rng, 4)
    up = rng.normal(size=3)
    model = pin.Model()
    model.gravity = pin.Motion(-up, np.zeros(3))
    kinds = [pin.JointModelRevoluteUnaligned, pin.JointModelSpherical, pin.JointModelRevoluteUnaligned]
    parent = 0
    for i, (joint, kind) in enumerate(zip(chain.joints, kinds, strict=True)):
        made = kind(np.array(joint.axis)) if isinstance(joint, Revolute) else kind()
        parent = model.addJoint(parent, made, pin.SE3(chain.placements[i]), f"joint {i}")
        body = pin.Inertia(mass[i + 1], centre[i + 1], about[i + 1])
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    data = model.createData()
    ball = chain.joints[1]
    part = chain.slices[1]
    subspace, rate = ball.subspace(q[part])[3:], ball.subspace_rate(q[part], dq[part])[3:]
    configuration = np.concatenate([q[:1], Rotation.from_rotvec(q[part]).as_quat(), q[4:]])
    speed = np.concatenate([dq[:1], subspace @ dq[part], dq[4:]])
    change = np.concatenate([ddq[:1], subspace @ ddq[part] + rate @ dq[part], ddq[4:]])
    pin.rnea(model, data, configuration, speed, change)
    gravity = np.concatenate([up, np.zeros(3)])
    found = inverse_dynamics(chain, spatial_inertia(mass, centre, about), q, dq, ddq, base_acceleration=gravity)
    expected = np.stack([data.f[i + 1].vector for i in range(3)])
    np.testing.assert_allclose(found.joint_wrench, expected, atol=1e-6)
    assert found.effort.shape == (5,)
