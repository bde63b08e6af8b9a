"""Problem, unknowns and geometry of the bundle adjustment in space; see :mod:`.bundle_equations` for the equations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import JointKind

_LEAST_ALONG = 0.5  # least 1 + cos of the angle from the rest direction to the long axis


@dataclass(frozen=True)
class BundleProblem:
    """Input of the bundle adjustment.

    The axial rotation of a ball joint on the base is measured from the shortest swing from ``rest``. For other joints
    it is measured from the shortest swing from the reference pose.
    """

    points: FloatArray  # (F, M, 3) marker positions, m; 0 where missing
    weights: FloatArray  # (F, M) inverse standard deviation of one coordinate, 1/m; 0 where missing
    segment: IntArray  # (M,) segment of each marker
    parents: tuple[int, ...]  # parent of segments 1 … n
    kinds: tuple[JointKind, ...]  # kind of each joint
    rest: FloatArray  # (3,) direction of segment 1 at zero elevation, in the frame of the base
    on_glide: BoolArray  # (M,) base markers on the shoulder girdle
    glides: bool  # whether the glide is estimated
    long_axes: FloatArray  # (n, 3) long axis of each segment in its own frame, towards its joint
    slide_sd: FloatArray  # (n,) standard deviation of each joint's slide along each axis, m; 0 without a slide

    @property
    def untwisted(self) -> FloatArray:
        """Rotation (n, 3, 3) of every joint at which the axial rotation of its segment is zero."""
        rotations = np.tile(np.eye(3), (len(self.parents), 1, 1))
        along = 1.0 + float(self.long_axes[0] @ self.rest)
        if self.kinds[0] == "ball" and self.parents[0] == 0 and along > _LEAST_ALONG:
            turn = so3.hat(np.cross(self.long_axes[0], self.rest))
            rotations[0] += turn + turn @ turn / along
        return rotations

    @property
    def frame_size(self) -> int:
        """Number of unknowns of a frame."""
        return 6 + 3 * len(self.parents) + 3 * len(self.sliding)

    @property
    def sliding(self) -> list[int]:
        """Numbers of the joints that slide, from 0."""
        return np.flatnonzero(self.slide_sd).tolist()

    def slide_columns(self, joint: int) -> slice:
        """Return the columns of a joint's slide among the unknowns of a frame."""
        at = 6 + 3 * len(self.parents) + 3 * self.sliding.index(joint)
        return slice(at, at + 3)

    def path(self, segment: int) -> list[int]:
        """Return the numbers of the joints from a segment to the base, from 0."""
        joints = []
        while segment > 0:
            joints.append(segment - 1)
            segment = self.parents[segment - 1]
        return joints


@dataclass(frozen=True)
class BundleState:
    """Unknowns of the bundle adjustment."""

    local: FloatArray  # (M, 3) marker coordinates, m
    centres: FloatArray  # (n, 3) joint centres in the frames of the parents, m
    first: FloatArray  # (n, 3) unit axes a in the parent's frame; without meaning for a ball joint
    second: FloatArray  # (n, 3) unit axes b in the child's frame; without meaning for a ball joint
    cosine: FloatArray  # (n,) cosine κ of the angle between two axes
    glide: FloatArray  # (3,) glide of joint 1, m
    skin: FloatArray  # (M,) fraction of the segment's axial rotation that the skin under each marker does not follow
    origin: FloatArray  # (F, 3) origin of the base, m
    rotations: FloatArray  # (F, n + 1, 3, 3) segment to trial
    slides: FloatArray  # (F, n, 3) slides of the joints in the frames of the parents, m


@dataclass(frozen=True)
class Columns:
    """Columns of the chain's parameters: markers first, then joints, glide and skin."""

    markers: int
    centre: tuple[slice, ...]
    first: tuple[slice | None, ...]
    second: tuple[slice | None, ...]
    cosine: tuple[int | None, ...]
    glide: slice | None
    skin: slice
    size: int


def locate_columns(problem: BundleProblem) -> Columns:
    """Return the columns of the parameters of a problem."""
    markers, at = problem.points.shape[1], 3 * problem.points.shape[1]
    centre: list[slice] = []
    first: list[slice | None] = []
    second: list[slice | None] = []
    cosine: list[int | None] = []
    for kind in problem.kinds:
        centre.append(slice(at, at + 3))
        at += 3
        has_axes = kind != "ball"
        first.append(slice(at, at + 2) if has_axes else None)
        second.append(slice(at + 2, at + 4) if has_axes else None)
        at += 4 * has_axes
        cosine.append(at if kind == "two-axis" else None)
        at += kind == "two-axis"
    glide = slice(at, at + 3) if problem.glides else None
    at += 3 * problem.glides
    return Columns(
        markers, tuple(centre), tuple(first), tuple(second), tuple(cosine), glide, slice(at, at + markers), at + markers
    )


def tangents(axis: FloatArray) -> FloatArray:
    """Return two unit vectors (3, 2) normal to a unit axis (3,) and to each other."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    one = np.cross(axis, other)
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(axis, one)], axis=1)


def glide_share(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return the factor u = (1 - cos elevation) / 2 of the glide in every frame (F,)."""
    turned = np.swapaxes(state.rotations[:, 0], 1, 2) @ (state.rotations[:, 1] @ problem.long_axes[0])[..., None]
    return np.asarray((1 - turned[..., 0] @ problem.rest) / 2)


def segment_origins(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return the origins of the segments (F, n + 1, 3), m."""
    origins = [state.origin]
    for j, parent in enumerate(problem.parents):
        step = state.centres[j] + state.slides[:, j]
        if j == 0 and problem.glides:
            step = step + glide_share(problem, state)[:, None] * state.glide
        origins.append(origins[parent] + np.einsum("fij,fj->fi", state.rotations[:, parent], step))
    return np.stack(origins, axis=1)


def joint_rotations(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return the rotation Q of every joint, child to parent (F, n, 3, 3)."""
    parents = np.array(problem.parents, dtype=np.int64)
    return np.asarray(np.swapaxes(state.rotations[:, parents], 2, 3) @ state.rotations[:, 1:])


def twists(problem: BundleProblem, state: BundleState) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the axial rotations (F, n), rad, and their derivatives (F, n, 3) by rotations of the child and the parent.

    The axial rotation is the rotation about the long axis that remains after the shortest swing from
    :attr:`BundleProblem.untwisted`.
    """
    untwisted = problem.untwisted
    quaternion = so3.quaternion(np.swapaxes(untwisted, 1, 2) @ joint_rotations(problem, state))
    scalar, vector = quaternion[..., 0], quaternion[..., 1:]
    axis = problem.long_axes
    along = np.einsum("fni,ni->fn", vector, axis)
    size = np.maximum(scalar**2 + along**2, 1e-9)[..., None]
    common = scalar[..., None] ** 2 * axis + along[..., None] * vector
    across = scalar[..., None] * np.cross(axis, vector)
    twist = 2 * np.arctan2(along, scalar)
    twist = (twist + np.pi) % (2 * np.pi) - np.pi
    return twist, (common + across) / size, -np.einsum("nij,fnj->fni", untwisted, (common - across) / size)


def apply_step(problem: BundleProblem, state: BundleState, chain: FloatArray, frames: FloatArray) -> BundleState:
    """Return the state after a step of the chain's parameters (P,) and of the frames' unknowns (F, d)."""
    cols = locate_columns(problem)
    first, second, cosine = state.first.copy(), state.second.copy(), state.cosine.copy()
    for j in range(len(problem.kinds)):
        for axes, place in ((first, cols.first[j]), (second, cols.second[j])):
            if place is not None:
                axes[j] += tangents(axes[j]) @ chain[place]
                axes[j] /= np.linalg.norm(axes[j])
        at = cols.cosine[j]
        if at is not None:
            cosine[j] += chain[at]
    turned = 6 + 3 * len(problem.parents)
    turns = frames[:, 3:turned].reshape(len(frames), -1, 3)
    slides = state.slides.copy()
    slides[:, problem.sliding] += frames[:, turned:].reshape(len(frames), -1, 3)
    return replace(
        state,
        local=state.local + chain[: 3 * cols.markers].reshape(-1, 3),
        centres=state.centres + np.stack([chain[place] for place in cols.centre]),
        first=first,
        second=second,
        cosine=cosine,
        glide=state.glide + (chain[cols.glide] if cols.glide is not None else 0.0),
        skin=state.skin + chain[cols.skin],
        origin=state.origin + frames[:, :3],
        rotations=state.rotations @ so3.exp(turns),
        slides=slides,
    )
