"""Equations of the bundle adjustment of a chain in space: residuals, analytic Jacobians and normal equations.

Marker m of segment k has the measured position y. In the frame of the segment, whose origin is the centre of the
segment's joint,

    v = R_kᵀ (y - p_k),     residual  r = Eᵀ v - x_m,     E = exp(-s_m τ_k l_k)

with the coordinates x_m of the marker, the axial rotation τ_k of the segment about its long axis l_k, and the fraction
s_m of this rotation that the skin under the marker does not follow. The origin of a segment is the origin of its parent
plus R_parent (c + u g), with the centre c of the joint, the glide g of the girdle, and u = (1 - cos elevation) / 2.
Axes are constraints on the rotation Q = R_parentᵀ R_k: a · Q b = κ for two axes, Q b = a for a hinge. If whole clusters
slide on the bones, the centre of the joint between them is c + d. The slide d is unknown in every frame and has a prior
standard deviation.

Every frame has its own unknowns: the origin of the base, the rotations R_k ← R_k exp(δ_k), and the slides. These
unknowns are eliminated by a Schur complement, so that only the parameters of the chain remain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

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

    @cached_property
    def columns(self) -> Columns:
        """Columns of the chain's parameters (P)."""
        markers, at = self.points.shape[1], 3 * self.points.shape[1]
        centre: list[slice] = []
        first: list[slice | None] = []
        second: list[slice | None] = []
        cosine: list[int | None] = []
        for kind in self.kinds:
            centre.append(slice(at, at + 3))
            at += 3
            has_axes = kind != "ball"
            first.append(slice(at, at + 2) if has_axes else None)
            second.append(slice(at + 2, at + 4) if has_axes else None)
            at += 4 * has_axes
            cosine.append(at if kind == "two-axis" else None)
            at += kind == "two-axis"
        glide = slice(at, at + 3) if self.glides else None
        at += 3 * self.glides
        return Columns(markers, centre, first, second, cosine, glide, slice(at, at + markers), at + markers)


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
    centre: list[slice]
    first: list[slice | None]
    second: list[slice | None]
    cosine: list[int | None]
    glide: slice | None
    skin: slice
    size: int


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
    cols = problem.columns
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


FIRM = 200.0  # 1/rad; weight of a constraint on the axes, whose error is then far below 0.3°


def residuals(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return the residuals of the markers in the frames of their segments (F, M, 3), m; 0 where missing."""
    return np.asarray(_evaluate_markers(problem, state)[0] * (problem.weights > 0)[..., None])


def _evaluate_markers(
    problem: BundleProblem, state: BundleState
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return residuals, positions Eᵀ v without skin motion (F, M, 3), rotations Eᵀ, and axial rotations (F, M)."""
    origins = segment_origins(problem, state)
    at, segment = origins[:, problem.segment], problem.segment
    seen = np.einsum("fmji,fmj->fmi", state.rotations[:, segment], problem.points - at)
    twist = np.concatenate([np.zeros((len(origins), 1)), twists(problem, state)[0]], axis=1)[:, segment]
    axes = np.concatenate([np.zeros((1, 3)), problem.long_axes])[segment]
    back = so3.exp((state.skin * twist)[..., None] * axes)
    free = np.einsum("fmij,fmj->fmi", back, seen)
    off = free - state.local
    if problem.glides:
        off = off - (problem.on_glide * glide_share(problem, state)[:, None])[..., None] * state.glide
    return off, free, back, twist


@dataclass(frozen=True)
class Linear:
    """Residuals and Jacobians, all weighted. The N rows are those of the markers, constraints and slides."""

    off: FloatArray  # (F, N) residuals
    by_frame: FloatArray  # (F, N, d) derivatives with respect to the unknowns of the frame
    by_chain: FloatArray  # (F, N, P - 3 M) derivatives with respect to the chain's other parameters (not markers)


def linearise(problem: BundleProblem, state: BundleState, *, by_frame_only: bool = False) -> Linear:
    """Return residuals and Jacobians at a state, optionally only the Jacobian of the frames' unknowns."""
    cols, count = problem.columns, len(problem.parents)
    frames, markers = problem.weights.shape
    size = 0 if by_frame_only else cols.size - 3 * markers
    off, free, back, twist = _evaluate_markers(problem, state)
    _, by_child, by_parent = twists(problem, state)
    share = glide_share(problem, state)
    by_frame = np.zeros((frames, markers, 3, problem.frame_size))
    by_chain = np.zeros((frames, markers, 3, size))
    rotation = [slice(3 + 3 * k, 6 + 3 * k) for k in range(count + 1)]  # columns of the frame's unknowns
    slide = {j: slice(6 + 3 * (count + i), 9 + 3 * (count + i)) for i, j in enumerate(problem.sliding)}

    def beyond_markers(place: slice) -> slice:
        return slice(place.start - 3 * markers, place.stop - 3 * markers)

    def add_glide(here: IntArray, axes: FloatArray) -> None:
        """Add the derivatives of some markers with respect to the glide and to the elevation."""
        assert cols.glide is not None
        if not by_frame_only:
            by_chain[:, here, :, beyond_markers(cols.glide)] = -axes * share[:, None, None, None]
        relative = np.swapaxes(state.rotations[:, 0], 1, 2) @ state.rotations[:, 1]
        along = -(axes @ state.glide)[..., None]
        child = problem.rest @ relative @ so3.hat(problem.long_axes[0]) / 2
        parent = -problem.rest @ so3.hat(relative @ problem.long_axes[0]) / 2
        by_frame[:, here, :, rotation[1]] += along * child[:, None, None]
        by_frame[:, here, :, rotation[0]] += along * parent[:, None, None]

    # markers: pose of the segment, then the joints from the segment to the base, glide, and skin
    for k in range(count + 1):
        here = np.flatnonzero(problem.segment == k)
        turned = back[:, here] @ np.swapaxes(state.rotations[:, k], 1, 2)[:, None]  # trial to the frame of the skin
        by_frame[:, here, :, :3] = -turned
        by_frame[:, here, :, rotation[k]] = so3.hat(free[:, here]) @ back[:, here]
        segment = k
        while segment > 0:
            j, parent = segment - 1, problem.parents[segment - 1]
            lever = state.centres[j] + state.slides[:, j]
            axes = turned @ state.rotations[:, None, parent]
            if not by_frame_only:
                by_chain[:, here, :, beyond_markers(cols.centre[j])] = -axes
            if j in slide:
                by_frame[:, here, :, slide[j]] = -axes
            if j == 0 and problem.glides:
                lever = lever + share[:, None] * state.glide
                add_glide(here, axes)
            by_frame[:, here, :, rotation[parent]] += axes @ so3.hat(lever)[:, None]
            segment = parent
        if k == 0:
            riding = here[problem.on_glide[here]]
            if problem.glides and len(riding):
                add_glide(riding, np.broadcast_to(np.eye(3), (1, 1, 3, 3)))
            continue
        swirl = np.cross(problem.long_axes[k - 1], free[:, here])
        if not by_frame_only:
            place = cols.skin.start - 3 * markers + here
            by_chain[:, here, :, place] = swirl.transpose(1, 0, 2) * twist[:, here].T[..., None]
        moved = state.skin[here, None] * swirl
        by_frame[:, here, :, rotation[k]] += moved[..., None] * by_child[:, k - 1, None, None]
        by_frame[:, here, :, rotation[problem.parents[k - 1]]] += moved[..., None] * by_parent[:, k - 1, None, None]
    root = problem.weights[..., None]
    flat = (frames, 3 * markers)
    rows = [(off * root).reshape(flat)]
    frame_rows = [(by_frame * root[..., None]).reshape(*flat, -1)]
    chain_rows = [(by_chain * root[..., None]).reshape(*flat, -1)]

    # constraints on the axes: Q b = a for a hinge, a · Q b = κ for two axes
    for j, kind in enumerate(problem.kinds):
        if kind == "ball":
            continue
        turn, axis, pin = joint_rotations(problem, state)[:, j], state.first[j], state.second[j]
        rotated_pin = turn @ pin
        if kind == "hinge":
            value, project = rotated_pin - axis, np.broadcast_to(np.eye(3), turn.shape)
            by_axis = np.broadcast_to(-tangents(axis), (*rotated_pin.shape, 2))
        else:
            value, project = (rotated_pin @ axis - state.cosine[j])[:, None], np.broadcast_to(axis, (len(turn), 1, 3))
            by_axis = (rotated_pin @ tangents(axis))[:, None]
        of_frame, of_chain = np.zeros((*value.shape, problem.frame_size)), np.zeros((*value.shape, size))
        of_frame[..., rotation[j + 1]] = -project @ turn @ so3.hat(pin)
        of_frame[..., rotation[problem.parents[j]]] = project @ so3.hat(rotated_pin)
        first, second, cosine = cols.first[j], cols.second[j], cols.cosine[j]
        assert first is not None and second is not None
        if not by_frame_only:
            of_chain[..., beyond_markers(first)] = by_axis
            of_chain[..., beyond_markers(second)] = project @ turn @ tangents(pin)
            if cosine is not None:
                of_chain[..., cosine - 3 * markers] = -1
        rows.append(FIRM * value)
        frame_rows.append(FIRM * of_frame)
        chain_rows.append(FIRM * of_chain)

    for j, place in slide.items():
        rows.append(state.slides[:, j] / problem.slide_sd[j])
        of_frame = np.zeros((frames, 3, problem.frame_size))
        of_frame[:, :, place] = np.eye(3) / problem.slide_sd[j]
        frame_rows.append(of_frame)
        chain_rows.append(np.zeros((frames, 3, size)))
    return Linear(*(np.concatenate(each, axis=1) for each in (rows, frame_rows, chain_rows)))


@dataclass(frozen=True)
class Reduced:
    """Normal equations of the chain's parameters after elimination of the frames."""

    matrix: FloatArray  # (P, P)
    vector: FloatArray  # (P,)
    gain: FloatArray  # (F, d, P) negative derivative of the frames' unknowns with respect to the chain's parameters


def eliminate_frames(problem: BundleProblem, linear: Linear) -> Reduced:
    """Return the reduced normal equations (Schur complement over the frames)."""
    markers = problem.points.shape[1]
    frames, size = len(linear.off), linear.by_frame.shape[2]
    turned = np.swapaxes(linear.by_frame, 1, 2)
    inner = turned @ linear.by_frame
    weights = np.repeat(problem.weights, 3, axis=1)
    cross = np.concatenate([-turned[:, :, : 3 * markers] * weights[:, None], turned @ linear.by_chain], axis=2)
    right = -(turned @ linear.off[..., None])
    inverse = np.linalg.inv(inner + 1e-9 * np.eye(size))  # twice as fast as to solve for so many columns
    gain, own = inverse @ cross, (inverse @ right)[..., 0]
    chain = linear.by_chain.reshape(-1, linear.by_chain.shape[2])
    matrix = np.zeros((cross.shape[2],) * 2)
    matrix[: 3 * markers, : 3 * markers] = np.diag((weights**2).sum(axis=0))
    mixed = -np.einsum("fr,frp->rp", weights, linear.by_chain[:, : 3 * markers])
    matrix[: 3 * markers, 3 * markers :], matrix[3 * markers :, : 3 * markers] = mixed, mixed.T
    matrix[3 * markers :, 3 * markers :] = chain.T @ chain
    matrix -= cross.reshape(frames * size, -1).T @ gain.reshape(frames * size, -1)
    vector = np.concatenate([(weights * linear.off[:, : 3 * markers]).sum(axis=0), -chain.T @ linear.off.reshape(-1)])
    vector -= cross.reshape(frames * size, -1).T @ own.reshape(-1)
    return Reduced(matrix, vector, gain)
