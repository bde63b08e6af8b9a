"""Poses, Jacobians, inverse dynamics and base wrench of random chains, compared with Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from geometry_cases import laws, random_chain, random_masses, seeds
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.geometry import body_jacobian, inverse_dynamics, spatial_inertia, spatial_jacobian


def pinocchio_model(chain, mass, centre, about, up):
    """Return the same chain on a free-flying base, whose effort is the base wrench."""
    model = pin.Model()
    model.gravity = pin.Motion(-up, np.zeros(3))
    parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(parent, pin.Inertia(mass[0], centre[0], about[0]), pin.SE3.Identity())
    for i, (joint, placement) in enumerate(zip(chain.joints, chain.placements, strict=True), start=1):
        kind = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, kind, pin.SE3(placement), f"joint {i}")
        model.appendBodyToJoint(parent, pin.Inertia(mass[i], centre[i], about[i]), pin.SE3.Identity())
    return model


def base_at_rest(q):
    return np.concatenate([[0, 0, 0, 0, 0, 0, 1], q])


@laws
@given(seeds, st.integers(1, 6))
def test_inverse_dynamics_agrees(seed, joints):
    rng = np.random.default_rng(seed)
    chain, masses, up = random_chain(rng, joints), random_masses(rng, joints + 1), rng.normal(size=3)
    q, dq, ddq = rng.normal(size=(3, joints))
    applied = rng.normal(size=(joints + 1, 6))
    model = pinocchio_model(chain, *masses, up)
    data = model.createData()
    external = pin.StdVec_Force()
    for wrench in np.vstack([np.zeros(6), applied]):
        external.append(pin.Force(wrench))
    still = np.zeros(6)
    expected = pin.rnea(
        model, data, base_at_rest(q), np.concatenate([still, dq]), np.concatenate([still, ddq]), external
    )
    gravity = np.concatenate([up, np.zeros(3)])
    found = inverse_dynamics(chain, spatial_inertia(*masses), q, dq, ddq, base_acceleration=gravity, applied=applied)
    wrenches = np.stack([data.f[i + 2].vector for i in range(joints)])
    scale = 1 + np.abs(wrenches).max()
    np.testing.assert_allclose(found.effort, expected[6:], atol=1e-11 * scale)
    np.testing.assert_allclose(found.base_wrench, expected[:6], atol=1e-11 * scale)
    np.testing.assert_allclose(found.joint_wrench, wrenches, atol=1e-11 * scale)


@laws
@given(seeds, st.integers(1, 6))
def test_poses_and_jacobians_agree(seed, joints):
    rng = np.random.default_rng(seed)
    chain, q = random_chain(rng, joints), rng.normal(size=joints)
    model = pinocchio_model(chain, *random_masses(rng, joints + 1), np.zeros(3))
    data = model.createData()
    pin.computeJointJacobians(model, data, base_at_rest(q))
    last = joints + 1
    np.testing.assert_allclose(chain.poses(q)[1:], [data.oMi[i + 2].homogeneous for i in range(joints)], atol=1e-12)
    world = pin.getJointJacobian(model, data, last, pin.ReferenceFrame.WORLD)[:, 6:]
    local = pin.getJointJacobian(model, data, last, pin.ReferenceFrame.LOCAL)[:, 6:]
    np.testing.assert_allclose(spatial_jacobian(chain, q), world, atol=1e-11)
    np.testing.assert_allclose(body_jacobian(chain, q, np.eye(4)), local, atol=1e-11)
