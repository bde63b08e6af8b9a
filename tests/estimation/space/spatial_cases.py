"""Chains in space and smooth movements of them, for the tests of the filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id_simulation import SimulatedSpaceTrial, simulate_arm

UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From laboratory axes with Z up to those of a trial."""


def unit(vector: FloatArray) -> FloatArray:
    return vector / np.linalg.norm(vector)


def mixed_chain(rng: np.random.Generator, per_segment: int = 4) -> SpatialChain:
    """Return a chain of a gliding ball, a two-axis joint and a hinge, with a marker on the glide."""
    ball = SpatialJoint("ball", 0, rng.normal(0, 0.2, 3), glide=rng.normal(0, 0.03, 3))
    saddle = SpatialJoint(
        "two-axis",
        1,
        rng.normal(0, 0.2, 3),
        first_axis=unit(rng.normal(size=3)),
        second_axis=unit(rng.normal(size=3)),
        offset=so3.exp(rng.normal(0, 0.5, 3)),
    )
    hinge = SpatialJoint("hinge", 2, rng.normal(0, 0.2, 3), first_axis=unit(rng.normal(size=3)))
    segment = np.repeat(np.arange(4), per_segment)
    on_glide = np.zeros(len(segment), dtype=np.bool_)
    on_glide[0] = True
    return SpatialChain((ball, saddle, hinge), segment, rng.normal(0, 0.08, (len(segment), 3)), on_glide)


def positions(chain: SpatialChain, origin: FloatArray, base: FloatArray, joints: FloatArray) -> FloatArray:
    """Return the markers (F, M, 3) from the definition of the chain."""
    origins, turns = chain.place(origin, base, joints)
    found = origins[:, chain.segment] + np.einsum("fmij,mj->fmi", turns[:, chain.segment], chain.local)
    glide = chain.joints[0].origin(joints[:, 0]) - chain.joints[0].centre
    found[:, chain.on_glide] += np.einsum("fij,fj->fi", base, glide)[:, None]
    return found


def true_chain(trial: SimulatedSpaceTrial) -> SpatialChain:
    """Return the chain of a simulated arm."""
    body = trial.document["body"]
    on_glide, local = np.array([name == "AC" for name in trial.names]), trial.local.copy()
    first = trial.arrays["gh_in_thorax"][0] - body.shoulder
    local[on_glide] -= first
    joints = (
        SpatialJoint("ball", 0, body.shoulder, glide=body.glide),
        SpatialJoint(
            "two-axis",
            1,
            body.elbow,
            first_axis=unit(body.elbow_axis),
            second_axis=unit(body.pronation_axis),
            offset=so3.exp(np.array([body.carrying, 0.0, 0.0])),
        ),
        SpatialJoint("two-axis", 2, body.wrist, second_axis=np.array([1.0, 0.0, 0.0])),
    )
    return SpatialChain(joints, np.asarray(trial.assignment), local, on_glide)


def arm(seed: int, frames: int = 1500) -> SimulatedSpaceTrial:
    """Return the first frames of a simulated reach."""
    trial = simulate_arm(seed)
    cut = {
        name: getattr(trial, name)[:frames] for name in ("time", "positions", "rotations", "origins", "omega", "alpha")
    }
    return replace(trial, **cut)
