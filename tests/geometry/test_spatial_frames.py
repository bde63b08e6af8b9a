"""A chain described in other segment frames puts its markers at the same places."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint, change_frames


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def _chain(rng: np.random.Generator) -> SpatialChain:
    joints = []
    for k, kind in enumerate(("ball", "two-axis", "hinge")):
        root = rng.normal(size=(3, 3))
        joints.append(
            SpatialJoint(
                kind,
                k,
                rng.normal(size=3),
                root @ root.T,
                first_axis=_unit(rng.normal(size=3)),
                second_axis=_unit(rng.normal(size=3)),
                offset=so3.exp(rng.normal(size=3)),
                glide=rng.normal(size=3) * (k == 0),
                rest=_unit(rng.normal(size=3)),
                long_axis=_unit(rng.normal(size=3)),
            )
        )
    segment = np.array([0, 0, 1, 2, 2, 3, 3])
    return SpatialChain(tuple(joints), segment, rng.normal(size=(7, 3)), segment < 0)


def _markers(chain: SpatialChain, origin: FloatArray, rotation: FloatArray, turns: FloatArray) -> FloatArray:
    origins, rotations = chain.place(origin, rotation, turns)
    own = chain.segment
    return np.asarray(origins[:, own] + np.einsum("fmij,mj->fmi", rotations[:, own], chain.local))


def test_markers_stay_where_they_are() -> None:
    rng = np.random.default_rng(0)
    chain, axes, origin = _chain(rng), so3.exp(rng.normal(size=(4, 3))), rng.normal(size=3)
    other = change_frames(chain, axes, origin)
    at, base = rng.normal(size=(5, 3)), so3.exp(rng.normal(size=(5, 3)))
    angles = [rng.normal(size=(5, joint.dimension)) for joint in chain.joints]
    turns = np.stack([joint.rotation(q) for joint, q in zip(chain.joints, angles, strict=True)], axis=1)
    turned = [axes[joint.parent].T @ turns[:, k] @ axes[k + 1] for k, joint in enumerate(chain.joints)]
    before = _markers(chain, at, base, turns)
    after = _markers(other, at + base @ origin, base @ axes[0], np.stack(turned, axis=1))
    assert np.allclose(before, after, atol=1e-12)
    for k in (1, 2):
        assert np.allclose(other.joints[k].rotation(angles[k]), turned[k], atol=1e-12)


def test_covariances_turn_with_the_frames() -> None:
    rng = np.random.default_rng(1)
    chain, axes = _chain(rng), so3.exp(rng.normal(size=(4, 3)))
    other = change_frames(chain, axes, np.zeros(3))
    for joint, new in zip(chain.joints, other.joints, strict=True):
        back = axes[joint.parent]
        assert np.allclose(back @ new.covariance @ back.T, joint.covariance)
