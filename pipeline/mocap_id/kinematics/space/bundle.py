"""Bundle adjustment of a chain in space: all parameters by Levenberg-Marquardt, markers weighted by their residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import NumericalError
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import JointKind
from mocap_id.kinematics.space.bodies import mean_rotation

_LEAST_ALONG = 0.5  # least 1 + cos of the angle from the rest direction to the long axis


@dataclass(frozen=True)
class BundleProblem:
    """Input of the bundle adjustment: markers, chain, and likely values of the chain's parameters.

    The axial rotation of a ball joint on the base is measured from the shortest swing from ``rest``. For other joints
    it is measured from the shortest swing from the reference pose.

    The centre of a joint is likely between its clusters. The second axis of a two-axis joint is likely the long axis of
    its segment; for example, the forearm rotates about the line from elbow to wrist. The skin follows the axial
    rotation of the bone at the far end of a segment, at elbow and wrist, and lags behind it by a fraction that grows
    towards the near end.
    """

    points: FloatArray  # (F, M, 3) marker positions, m; 0 where missing
    weights: FloatArray  # (F, M) inverse standard deviation of one coordinate, 1/m; 0 where missing
    segment: IntArray  # (M,) segment of each marker
    parents: tuple[int, ...]  # parent of segments 1 … n
    kinds: tuple[JointKind, ...]  # kind of each joint
    rest: FloatArray  # (3,) direction of segment 1 at zero elevation, in the frame of the base
    on_glide: BoolArray  # (M,) base markers on the shoulder girdle; without them, no glide is estimated
    long_axes: FloatArray  # (n, 3) long axis of each segment in its own frame, towards its joint
    slide_sd: FloatArray  # (n,) standard deviation of each joint's slide along each axis, m; 0 without a slide
    likely_centres: FloatArray  # (n, 3) likely centres in the frames of the parents, m
    centre_sd: FloatArray  # (n,) standard deviation of each coordinate of the centres about them, m
    along: BoolArray  # (n,) two-axis joints whose second axis may be the long axis of their segment
    soft: BoolArray  # (n,) segments 1 … n whose skin may move

    @cached_property
    def glides(self) -> bool:
        """Whether the glide is estimated."""
        return bool(self.on_glide.any())

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
        return Columns(centre, first, second, cosine, glide, slice(at, at + markers), at + markers)


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
    """Columns of the chain's parameters: coordinates of the markers first, then joints, glide and skin."""

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
        local=state.local + chain[: state.local.size].reshape(-1, 3),
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


Linear: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Weighted equations, whose N rows are those of the markers, constraints and slides.

They are the residuals (F, N), and their derivatives with respect to the unknowns of the frame, (F, N, d), and to the
chain's parameters beyond the markers' coordinates, (F, N, P - 3 M)."""


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
    return np.concatenate(rows, axis=1), np.concatenate(frame_rows, axis=1), np.concatenate(chain_rows, axis=1)


def eliminate_frames(problem: BundleProblem, linear: Linear) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the normal equations of the chain's parameters, matrix (P, P) and vector (P,), without the frames.

    The frames are eliminated one by one (Schur complement). The third result (F, d, P) is the negative derivative of
    the frames' unknowns with respect to the chain's parameters.
    """
    off, by_frame, by_chain = linear
    own_rows = 3 * problem.points.shape[1]
    frames, size = len(off), by_frame.shape[2]
    turned = np.swapaxes(by_frame, 1, 2)
    inner = turned @ by_frame
    weights = np.repeat(problem.weights, 3, axis=1)
    cross = np.concatenate([-turned[:, :, :own_rows] * weights[:, None], turned @ by_chain], axis=2)
    right = -(turned @ off[..., None])
    inverse = np.linalg.inv(inner + 1e-9 * np.eye(size))  # twice as fast as to solve for so many columns
    gain, own = inverse @ cross, (inverse @ right)[..., 0]
    chain = by_chain.reshape(-1, by_chain.shape[2])
    matrix = np.zeros((cross.shape[2],) * 2)
    matrix[:own_rows, :own_rows] = np.diag((weights**2).sum(axis=0))
    mixed = -np.einsum("fr,frp->rp", weights, by_chain[:, :own_rows])
    matrix[:own_rows, own_rows:], matrix[own_rows:, :own_rows] = mixed, mixed.T
    matrix[own_rows:, own_rows:] = chain.T @ chain
    matrix -= cross.reshape(frames * size, -1).T @ gain.reshape(frames * size, -1)
    vector = np.concatenate([(weights * off[:, :own_rows]).sum(axis=0), -chain.T @ off.reshape(-1)])
    vector -= cross.reshape(frames * size, -1).T @ own.reshape(-1)
    return matrix, vector, gain


CENTRE_SD = 0.1
"""Standard deviation of each coordinate of a centre about the point between its clusters, m."""
MARKED_SD = 0.03
"""Standard deviation of each coordinate of a centre about markers that are known to be beside the joint, m."""
_ON_HINGE = 0.005  # m; standard deviation along a hinge, where the motion does not determine the centre
_GLIDE = 0.02  # m; standard deviation of each coordinate of the glide of the girdle
_LONG_AXIS = np.radians(3.5)  # standard deviation in the fit; small, because the fit treats soft tissue as noise
_OFF_LONG_AXIS = np.radians(8)  # typical angle between the axis of pronation and the line between the joints
_SLOPE = 0.6  # fraction of axial rotation that the skin does not follow at the near end of a segment
_SCATTER = 0.12  # scatter of single markers about the linear increase from the far end
_NO_SKIN = 1e-4


def prior_equations(problem: BundleProblem, state: BundleState) -> tuple[FloatArray, FloatArray]:
    """Return the weighted residuals (K,) of the likely values, and their derivatives (K, P) by the parameters."""
    cols = problem.columns
    values, rows = [], []

    def add(value: FloatArray, place: slice, by: FloatArray) -> None:
        block = np.zeros((len(value), cols.size))
        block[:, place] = by
        values.append(value)
        rows.append(block)

    for j, place in enumerate(cols.centre):
        sd, off = problem.centre_sd[j], state.centres[j] - problem.likely_centres[j]
        add(off / sd, place, np.eye(3) / sd)
        if problem.kinds[j] == "hinge":
            axis = state.first[j][None]
            add(axis @ off / _ON_HINGE, place, axis / _ON_HINGE)
        second = cols.second[j]
        if problem.along[j] and second is not None:
            across = tangents(problem.long_axes[j]).T / _LONG_AXIS
            add(across @ state.second[j], second, across @ tangents(state.second[j]))
    if cols.glide is not None:
        add(state.glide / _GLIDE, cols.glide, np.eye(3) / _GLIDE)
    root = np.eye(len(problem.segment)) / _NO_SKIN  # (M, M) of the inverse covariance of the fractions of skin
    for k in np.flatnonzero(problem.soft) + 1:
        here = np.flatnonzero(problem.segment == k)
        length = np.linalg.norm(state.centres[problem.parents.index(k)])
        height = np.clip(1 + state.local[here] @ problem.long_axes[k - 1] / length, 0, 1.2)
        covariance = _SCATTER**2 * np.eye(len(here)) + _SLOPE**2 * np.outer(height, height)
        root[np.ix_(here, here)] = np.linalg.cholesky(np.linalg.inv(covariance)).T
    add(root @ state.skin, cols.skin, root)
    return np.concatenate(values), np.concatenate(rows)


_ITERATIONS = 60
_CONVERGED = 1e-4  # relative decrease of the cost
_NEARLY = 1e-2  # relative decrease of the cost at which the weights are renewed
_WEIGHINGS = 5
_PATIENCE = 8  # iterations after which the weights are renewed in any case
_HUBER = 3.0  # standard deviations; larger residuals are outliers
_FINEST = 1e-4  # m; smallest standard deviation of a marker
_EVEN = 0.5  # the same, relative to the median of the segments, because computed markers have no residuals
_SHARED = 0.1  # weight of the segment's typical variance in the variance of a marker
_LONGEST = 40  # frames; largest lag of the autocorrelation of residuals
_FRAME_STEPS = 5
_ANYWHERE = 1.0  # m; standard deviation of a marker that is never visible
_FREE = 1e-4  # smallest damping
_FIXED = 1e-4  # rad, m; standard deviation of the axes of a segment relative to its markers
_STEP = {"markers": 0.01, "centres": 0.02, "axes": 0.2, "skin": 0.2}  # typical steps; m, m, rad, 1


@dataclass(frozen=True)
class Bundle:
    """Solution of the bundle adjustment."""

    problem: BundleProblem  # with the final weights
    state: BundleState
    linear: Linear  # equations at the solution, without the likely values
    gain: FloatArray  # (F, d, P) negative derivative of the frames' unknowns with respect to the chain's parameters
    matrix: FloatArray  # (P, P) normal matrix with the likely values and with the rows that fix the segment axes
    sd: FloatArray  # (M,) standard deviation of one coordinate of each marker, m
    together: FloatArray  # (M,) number of frames over which the error of each marker persists; they count as one
    iterations: int

    def rotation_noise(self, joint: int) -> FloatArray:
        """Return the covariance (3, 3), rad², of the rotation of a joint at one time, in the parent's axes."""
        turn = joint_rotations(self.problem, self.state)[:, joint]
        own = self.cluster_noise(joint + 1)
        return np.asarray(
            self.cluster_noise(self.problem.parents[joint]) + (turn @ own @ np.swapaxes(turn, 1, 2)).mean(0)
        )

    def cluster_noise(self, k: int) -> FloatArray:
        """Return the covariance (3, 3), rad², of the rotation of a cluster at one time, in its own axes."""
        here = self.problem.segment == k
        weight = 1 / self.sd[here] ** 2
        about = self.state.local[here] - weight @ self.state.local[here] / weight.sum()
        square = (weight[:, None] * about).T @ about
        return np.asarray(np.linalg.inv(np.trace(square) * np.eye(3) - square))


def solve_bundle(problem: BundleProblem, state: BundleState) -> Bundle:
    """Fit the chain to the markers, starting from the weights in ``problem`` (zero where missing) and from ``state``.

    Raises
    ------
    NumericalError
        The iteration does not converge.
    """
    cols = problem.columns
    seen = problem.weights > 0
    own = np.arange(cols.size) < state.local.size  # coordinates of the markers
    sd, together = np.full(seen.shape[1], np.nan), np.ones(seen.shape[1])
    steps = np.where(own, _STEP["markers"], _STEP["axes"])
    for place in (*cols.centre, *([cols.glide] if cols.glide else [])):
        steps[place] = _STEP["centres"]
    steps[cols.skin] = _STEP["skin"]
    scale = 1 / steps**2

    # the axes of a segment's frame, and the origin of the base, are arbitrary: the mean rotation of each segment's
    # markers, and the shift of the base markers, are fixed
    rows = []
    for k in range(len(problem.parents) + 1):
        here = np.flatnonzero(problem.segment == k)
        about = state.local[here] - state.local[here].mean(axis=0)
        inertia = np.sum(about**2) * np.eye(3) - about.T @ about
        turn, shift = np.zeros((2, 3, cols.size))
        levers = np.linalg.solve(inertia, so3.hat(about).transpose(1, 0, 2).reshape(3, -1)).reshape(3, -1, 3)
        for m, lever in zip(here, levers.transpose(1, 0, 2), strict=True):
            turn[:, 3 * m : 3 * m + 3] = lever
            shift[:, 3 * m : 3 * m + 3] = np.eye(3) / len(here)
        rows += [turn, shift] if k == 0 else [turn]
    gauge = np.concatenate(rows) / _FIXED
    fixed = gauge.T @ gauge + np.diag(own / _ANYWHERE**2)
    damping, weighings, since = 1.0, 0, 0

    def sum_squares(linear: Linear, state: BundleState) -> float:
        """Return the cost: the sum of squared weighted residuals of markers and likely values."""
        return float(np.sum(linear[0] ** 2) + np.sum(prior_equations(problem, state)[0] ** 2))

    state, linear = _settle_repeatedly(problem, state)
    cost = sum_squares(linear, state)
    for iteration in range(1, _ITERATIONS + 1):
        matrix, vector, gain = eliminate_frames(problem, linear)
        value, prior = prior_equations(problem, state)
        matrix, vector = matrix + prior.T @ prior, vector - prior.T @ value
        while True:
            step = np.asarray(np.linalg.solve(matrix + fixed + np.diag(damping * scale), vector), dtype=np.float64)
            tried, tried_linear = fit_frames(problem, apply_step(problem, state, step, -gain @ step))
            tried_cost = sum_squares(tried_linear, tried)
            if tried_cost <= cost * (1 + 1e-9) or damping > 1e6:
                break
            damping *= 10
        fall = max(cost - tried_cost, 0.0)
        if tried_cost <= cost:
            state, linear, cost = tried, tried_linear, tried_cost
        damping = max(damping / 10, _FREE)
        since += 1
        if weighings < _WEIGHINGS and (fall <= _NEARLY * cost or since == _PATIENCE):
            sd, together = marker_errors(problem, state, linear)
            root = 1 / (sd * np.sqrt(together))
            size, limit = np.linalg.norm(residuals(problem, state), axis=2), _HUBER * np.sqrt(3) * sd
            outliers = np.sqrt(np.minimum(1.0, limit / np.maximum(size, limit)))
            axes = long_axes(problem.parents, problem.segment, state)
            problem = replace(problem, weights=seen * root * outliers, long_axes=axes)
            linear = linearise(problem, state)
            cost = sum_squares(linear, state)
            weighings, damping = weighings + 1, max(damping, 1e-2)
            since = 0
        elif fall <= (_CONVERGED if iteration < _ITERATIONS else _NEARLY) * cost:
            matrix, _, gain = eliminate_frames(problem, linear)
            prior = prior_equations(problem, state)[1]
            return Bundle(problem, state, linear, gain, matrix + prior.T @ prior + fixed, sd, together, iteration)
    raise NumericalError(
        f"the joint fit did not converge in {_ITERATIONS} iterations; check the markers of the segments"
    )


def _settle_repeatedly(problem: BundleProblem, state: BundleState) -> tuple[BundleState, Linear]:
    """Return the state after steps of the frames' unknowns only, repeated while the cost decreases, and its equations.

    In a first guess, the rotations in the frames do not agree with the joint axes. From there, steps of all unknowns
    can end in another minimum with wrong axes.
    """
    cost = np.inf
    for _ in range(_FRAME_STEPS):
        state, linear = fit_frames(problem, state)
        before, cost = cost, float(np.sum(linear[0] ** 2))
        if before - cost <= _NEARLY * cost:
            break
    return state, linear


def fit_frames(problem: BundleProblem, state: BundleState) -> tuple[BundleState, Linear]:
    """Return the state after one step of the frames' unknowns only, and its equations.

    Frames in which the step increases the cost stay unchanged. The constraints make the cost a curved valley, so the
    steps of the chain's parameters would be short without this step.
    """
    off, by_frame, _ = linearise(problem, state, by_frame_only=True)
    turned = np.swapaxes(by_frame, 1, 2)
    inner = turned @ by_frame + 1e-9 * np.eye(problem.frame_size)
    own = np.asarray(-np.linalg.solve(inner, turned @ off[..., None])[..., 0], dtype=np.float64)
    unmoved = np.zeros(problem.columns.size)
    settled = apply_step(problem, state, unmoved, own)
    after = linearise(problem, settled)
    worse = (after[0] ** 2).sum(axis=1) > (off**2).sum(axis=1)
    if worse.any():
        settled = apply_step(problem, state, unmoved, np.where(worse[:, None], 0.0, own))
        after = linearise(problem, settled)
    return settled, after


def long_axes(parents: tuple[int, ...], segment: IntArray, state: BundleState) -> FloatArray:
    """Return the long axis (n, 3) of each segment, from its next joint or its markers' mean to its own joint."""
    axes = np.zeros((len(parents), 3))
    for k in range(1, len(parents) + 1):
        children = [j for j, parent in enumerate(parents) if parent == k]
        far = state.centres[children[0]] if children else state.local[segment == k].mean(axis=0)
        axes[k - 1] = -far / max(float(np.linalg.norm(far)), 1e-6)
    return axes


def fit_frames_only(problem: BundleProblem, state: BundleState) -> Bundle:
    """Fit only the frames' unknowns, with given parameters of the chain; the normal matrix of the result is NaN."""
    state, linear = _settle_repeatedly(problem, state)
    sd, together = marker_errors(problem, state, linear)
    matrix, _, gain = eliminate_frames(problem, linear)
    return Bundle(problem, state, linear, gain, np.full(matrix.shape, np.nan), sd, together, 0)


def marker_errors(problem: BundleProblem, state: BundleState, linear: Linear) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviation (M,), m, of each marker, and the number of frames (M,) that share its error.

    A residual is smaller than the error, because the unknowns of the frame absorb a part of it.
    """
    _, by_frame, _ = linear
    seen = problem.weights > 0
    off = residuals(problem, state)
    inner = np.swapaxes(by_frame, 1, 2) @ by_frame
    markers = problem.points.shape[1]
    rows = by_frame[:, : 3 * markers]
    absorbed = np.einsum("frd,frd->fr", rows, np.swapaxes(np.linalg.solve(inner, np.swapaxes(rows, 1, 2)), 1, 2))
    left = np.where(seen, np.maximum(3 - absorbed.reshape(len(off), markers, 3).sum(axis=2), 0.05), 0).sum(axis=0)
    size = np.linalg.norm(off, axis=2)
    limit = _HUBER * np.sqrt(np.maximum((size**2).sum(axis=0) / np.maximum(seen.sum(axis=0), 1), 1e-12))
    square = (np.minimum(size, limit) ** 2).sum(axis=0)
    variance = np.empty(markers)
    usual = []
    for k in np.unique(problem.segment):
        here = problem.segment == k
        typical = square[here].sum() / left[here].sum()
        extra = _SHARED * left[here].mean()
        variance[here] = (square[here] + extra * typical) / (left[here] + extra)
        usual.append(typical)
    least = max(_FINEST**2, _EVEN**2 * float(np.median(usual)))
    return np.sqrt(np.maximum(variance, least)), count_correlated_frames(off)


def count_correlated_frames(off: FloatArray) -> FloatArray:
    """Return the number of frames (M,) over which residuals (F, M, 3) persist: the integrated autocorrelation."""
    energy = np.maximum((off**2).sum(axis=(0, 2)), 1e-18)
    total = np.ones(off.shape[1])
    open_ = np.ones(off.shape[1], dtype=bool)
    for lag in range(1, min(_LONGEST, len(off) // 4)):
        correlation = (off[lag:] * off[:-lag]).sum(axis=(0, 2)) / energy
        open_ &= correlation > 2 / np.sqrt(3 * len(off))
        total += np.where(open_, 2 * correlation, 0.0)
    return total


_ALONG_HINGE = 0.1  # m; standard deviation of a centre along its hinge
_TURN = 0.5  # variance of the rotation of a cluster, relative to the persistent part of its residuals
_SLIDE = 0.4  # variance of the slides of a marker, relative to the persistent variance of its residual


def chain_covariance(bundle: Bundle) -> FloatArray:
    """Return the covariance (P, P) of the parameters of the chain; NaN if only the frames' unknowns were fitted.

    Errors that follow the rotation of a joint are added to the inverse of the normal matrix: slides, rotations of the
    clusters and displacements of single markers. So are a typical error of the likely axes, and the arbitrary position
    of each hinge centre along its axis.
    """
    if np.isnan(bundle.matrix).any():
        return bundle.matrix
    inverse = np.linalg.inv(bundle.matrix)
    problem, state, cols = bundle.problem, bundle.state, bundle.problem.columns
    off, by_frame, by_chain = bundle.linear
    rows = 3 * len(problem.segment)
    frames = len(off)
    by = np.concatenate([np.zeros((frames, rows, rows)), by_chain[:, :rows]], axis=2)
    weights = np.repeat(problem.weights, 3, axis=1)
    by[:, np.arange(rows), np.arange(rows)] -= weights
    by -= by_frame[:, :rows] @ bundle.gain
    by *= weights[..., None]
    lasting = bundle.sd**2 * np.maximum(1 - 1 / bundle.together, 0)
    turns = joint_rotations(problem, state)
    total = inverse

    # second derivatives (F, 3 J, P) of the cost by slides of J joints, as multiples of their rms, and by parameters
    size = np.array([np.sqrt(np.mean(state.slides[:, j] ** 2)) for j in problem.sliding])
    weights = np.repeat(size / problem.slide_sd[problem.sliding], 3)
    last = slice(off.shape[1] - 3 * len(problem.sliding), None)
    sliding = np.asarray(weights[:, None] * (by_frame[:, last] @ bundle.gain))

    for j, parent in enumerate(problem.parents):
        shape = so3.log(mean_rotation(turns[:, j]).T @ turns[:, j])
        shape = shape - shape.mean(axis=0)
        values, vectors = np.linalg.eigh(shape.T @ shape / len(shape))
        shape = shape @ (vectors / np.sqrt(np.maximum(values, 1e-8)))  # with unit variance
        flat = (shape.T @ sliding.reshape(frames, -1)).reshape(-1, inverse.shape[0]) @ inverse
        total = total + _SLIDE * flat.T @ flat
        moved = (shape.T @ by.reshape(frames, -1)).reshape(-1, rows, inverse.shape[0]) @ inverse
        size = np.repeat(np.sqrt(_SLIDE * lasting * np.isin(problem.segment, [parent, j + 1])), 3)
        flat = (moved * size[:, None]).reshape(-1, inverse.shape[0])
        total = total + flat.T @ flat
        for k in (parent, j + 1):
            # displacements (3, 3 M) of the markers in three independent rotations of the cluster of typical size, m
            here = np.flatnonzero(problem.segment == k)
            share = float(np.sum(lasting[here]) / np.sum(bundle.sd[here] ** 2))
            sizes, axes = np.linalg.eigh(bundle.cluster_noise(k))
            about = state.local[here] - state.local[here].mean(axis=0)
            turned = np.zeros((3, len(bundle.sd), 3))
            turned[:, here] = np.cross(axes.T[:, None], about) * np.sqrt(share * sizes)[:, None, None]
            flat = (turned.reshape(3, -1) @ moved).reshape(-1, inverse.shape[0])
            total = total + _TURN * flat.T @ flat
    gradients = np.zeros((2 * len(problem.kinds), cols.size))  # of the cost for typical errors of the likely axes
    for j, second in enumerate(cols.second):
        if problem.along[j] and second is not None:
            across = tangents(problem.long_axes[j]).T @ tangents(state.second[j])
            gradients[2 * j : 2 * j + 2, second] = across * _OFF_LONG_AXIS / _LONG_AXIS**2
    flat = gradients @ inverse
    total = total + flat.T @ flat
    along_hinges = np.zeros((cols.size, cols.size))
    for j, kind in enumerate(problem.kinds):
        if kind == "hinge":
            move = np.zeros(cols.size)
            move[cols.centre[j]] = state.first[j]
            for m in np.flatnonzero(problem.segment == j + 1):
                move[3 * m : 3 * m + 3] = -state.second[j]
            for i in np.flatnonzero(np.array(problem.parents) == j + 1):
                move[cols.centre[i]] = -state.second[j]
            along_hinges += _ALONG_HINGE**2 * np.outer(move, move)
    return np.asarray(total + along_hinges)
