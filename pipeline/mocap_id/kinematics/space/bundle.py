"""Bundle adjustment of a chain in space: all parameters by Levenberg-Marquardt, markers weighted by their residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import NumericalError
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bundle_equations import (
    BundleProblem,
    BundleState,
    Linear,
    apply_step,
    eliminate_frames,
    joint_rotations,
    linearise,
    residuals,
    tangents,
)
from mocap_id.kinematics.space.rigid_body import mean_rotation

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


@dataclass(frozen=True)
class ChainPrior:
    """Likely values of the parameters of a chain.

    The centre of a joint is between its clusters. The second axis of a two-axis joint is the long axis of its segment;
    for example, the forearm rotates about the line from elbow to wrist. The skin follows the axial rotation of the bone
    at the far end of a segment, at elbow and wrist, and lags behind it by a fraction that grows towards the near end.
    """

    centres: FloatArray  # (n, 3) likely centres in the frames of the parents, m
    along: BoolArray  # (n,) two-axis joints whose second axis may be the long axis of their segment
    soft: BoolArray  # (n,) segments 1 … n whose skin may move
    centre_sd: FloatArray  # (n,) standard deviation of each coordinate of the centres, m

    def equations(self, problem: BundleProblem, state: BundleState) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residuals (K,) of the prior, and their derivatives (K, P) by the parameters."""
        cols = problem.columns
        values, rows = [], []

        def add(value: FloatArray, place: slice, by: FloatArray) -> None:
            block = np.zeros((len(value), cols.size))
            block[:, place] = by
            values.append(value)
            rows.append(block)

        for j, place in enumerate(cols.centre):
            sd = self.centre_sd[j]
            add((state.centres[j] - self.centres[j]) / sd, place, np.eye(3) / sd)
            if problem.kinds[j] == "hinge":
                axis = state.first[j][None]
                add(axis @ (state.centres[j] - self.centres[j]) / _ON_HINGE, place, axis / _ON_HINGE)
            second = cols.second[j]
            if self.along[j] and second is not None:
                across = tangents(problem.long_axes[j]).T / _LONG_AXIS
                add(across @ state.second[j], second, across @ tangents(state.second[j]))
        if cols.glide is not None:
            add(state.glide / _GLIDE, cols.glide, np.eye(3) / _GLIDE)
        root = np.eye(len(problem.segment)) / _NO_SKIN  # (M, M) of the inverse covariance of the fractions of skin
        for k in np.flatnonzero(self.soft) + 1:
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
    linear: Linear  # equations at the solution, without priors
    gain: FloatArray  # (F, d, P) negative derivative of the frames' unknowns with respect to the chain's parameters
    matrix: FloatArray  # (P, P) normal matrix with priors and with the rows that fix the segment axes
    sd: FloatArray  # (M,) standard deviation of one coordinate of each marker, m
    together: FloatArray  # (M,) number of frames over which the error of each marker persists; they count as one
    iterations: int
    prior: ChainPrior | None = None

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


def solve_bundle(problem: BundleProblem, state: BundleState, prior: ChainPrior) -> Bundle:
    """Fit the chain to the markers, starting from the weights in ``problem`` (zero where missing) and from ``state``.

    Raises
    ------
    NumericalError
        The iteration does not converge.
    """
    cols = problem.columns
    seen = problem.weights > 0
    sd, together = np.full(seen.shape[1], np.nan), np.ones(seen.shape[1])
    steps = np.full(cols.size, _STEP["axes"])
    steps[: 3 * cols.markers] = _STEP["markers"]
    for place in (*cols.centre, *([cols.glide] if cols.glide else [])):
        steps[place] = _STEP["centres"]
    steps[cols.skin] = _STEP["skin"]
    scale = 1 / steps**2
    fixed = gauge_rows(problem, state) / _FIXED
    fixed = fixed.T @ fixed + np.diag((np.arange(cols.size) < 3 * cols.markers) / _ANYWHERE**2)
    damping, weighings, since = 1.0, 0, 0

    def sum_squares(linear: Linear, state: BundleState) -> float:
        """Return the cost: the sum of squared weighted residuals of markers and prior."""
        return float(np.sum(linear.off**2) + np.sum(prior.equations(problem, state)[0] ** 2))

    state, linear = _settle_repeatedly(problem, state)
    cost = sum_squares(linear, state)
    for iteration in range(1, _ITERATIONS + 1):
        reduced = eliminate_frames(problem, linear)
        value, rows = prior.equations(problem, state)
        matrix, vector = reduced.matrix + rows.T @ rows, reduced.vector - rows.T @ value
        while True:
            step = np.asarray(np.linalg.solve(matrix + fixed + np.diag(damping * scale), vector), dtype=np.float64)
            tried, tried_linear = fit_frames(problem, apply_step(problem, state, step, -reduced.gain @ step))
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
            problem = replace(problem, weights=seen * root * outliers)
            problem = replace(problem, long_axes=long_axes(problem, state))
            linear = linearise(problem, state)
            cost = sum_squares(linear, state)
            weighings, damping = weighings + 1, max(damping, 1e-2)
            since = 0
        elif fall <= (_CONVERGED if iteration < _ITERATIONS else _NEARLY) * cost:
            reduced = eliminate_frames(problem, linear)
            rows = prior.equations(problem, state)[1]
            matrix = reduced.matrix + rows.T @ rows + fixed
            return Bundle(problem, state, linear, reduced.gain, matrix, sd, together, iteration, prior)
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
        before, cost = cost, float(np.sum(linear.off**2))
        if before - cost <= _NEARLY * cost:
            break
    return state, linear


def fit_frames(problem: BundleProblem, state: BundleState) -> tuple[BundleState, Linear]:
    """Return the state after one step of the frames' unknowns only, and its equations.

    Frames in which the step increases the cost stay unchanged. The constraints make the cost a curved valley, so the
    steps of the chain's parameters would be short without this step.
    """
    linear = linearise(problem, state, by_frame_only=True)
    turned = np.swapaxes(linear.by_frame, 1, 2)
    inner = turned @ linear.by_frame + 1e-9 * np.eye(problem.frame_size)
    own = np.asarray(-np.linalg.solve(inner, turned @ linear.off[..., None])[..., 0], dtype=np.float64)
    unmoved = np.zeros(problem.columns.size)
    before = (linear.off**2).sum(axis=1)
    settled = apply_step(problem, state, unmoved, own)
    after = linearise(problem, settled)
    worse = (after.off**2).sum(axis=1) > before
    if worse.any():
        settled = apply_step(problem, state, unmoved, np.where(worse[:, None], 0.0, own))
        after = linearise(problem, settled)
    return settled, after


def gauge_rows(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return derivatives (K, P) of the mean rotation of each segment's markers, rad, and of the base markers' shift, m.

    The axes of a segment's frame, and the origin of the base, are arbitrary, so they are fixed to the markers.
    """
    rows = []
    for k in range(len(problem.parents) + 1):
        here = np.flatnonzero(problem.segment == k)
        about = state.local[here] - state.local[here].mean(axis=0)
        inertia = np.sum(about**2) * np.eye(3) - about.T @ about
        turn, shift = np.zeros((2, 3, problem.columns.size))
        levers = np.linalg.solve(inertia, so3.hat(about).transpose(1, 0, 2).reshape(3, -1)).reshape(3, -1, 3)
        for m, lever in zip(here, levers.transpose(1, 0, 2), strict=True):
            turn[:, 3 * m : 3 * m + 3] = lever
            shift[:, 3 * m : 3 * m + 3] = np.eye(3) / len(here)
        rows.append(turn)
        if k == 0:
            rows.append(shift)
    return np.concatenate(rows)


def long_axes(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return the long axis (n, 3) of each segment, from its next joint or its markers' mean to its own joint."""
    axes = np.zeros((len(problem.parents), 3))
    for k in range(1, len(problem.parents) + 1):
        children = [j for j, parent in enumerate(problem.parents) if parent == k]
        far = state.centres[children[0]] if children else state.local[problem.segment == k].mean(axis=0)
        axes[k - 1] = -far / max(float(np.linalg.norm(far)), 1e-6)
    return axes


def fit_frames_only(problem: BundleProblem, state: BundleState) -> Bundle:
    """Fit only the frames' unknowns, with given parameters of the chain; the normal matrix of the result is NaN."""
    state, linear = _settle_repeatedly(problem, state)
    sd, together = marker_errors(problem, state, linear)
    reduced = eliminate_frames(problem, linear)
    return Bundle(problem, state, linear, reduced.gain, np.full(reduced.matrix.shape, np.nan), sd, together, 0)


def marker_errors(problem: BundleProblem, state: BundleState, linear: Linear) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviation (M,), m, of each marker, and the number of frames (M,) that share its error.

    A residual is smaller than the error, because the unknowns of the frame absorb a part of it.
    """
    seen = problem.weights > 0
    off = residuals(problem, state)
    inner = np.swapaxes(linear.by_frame, 1, 2) @ linear.by_frame
    markers = problem.points.shape[1]
    rows = linear.by_frame[:, : 3 * markers]
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
    problem, state, linear, cols = bundle.problem, bundle.state, bundle.linear, bundle.problem.columns
    rows = 3 * len(problem.segment)
    frames = len(linear.off)
    by = np.concatenate([np.zeros((frames, rows, rows)), linear.by_chain[:, :rows]], axis=2)
    weights = np.repeat(problem.weights, 3, axis=1)
    by[:, np.arange(rows), np.arange(rows)] -= weights
    by -= linear.by_frame[:, :rows] @ bundle.gain
    by *= weights[..., None]
    lasting = bundle.sd**2 * np.maximum(1 - 1 / bundle.together, 0)
    turns = joint_rotations(problem, state)
    total = inverse

    # second derivatives (F, 3 J, P) of the cost by slides of J joints, as multiples of their rms, and by parameters
    size = np.array([np.sqrt(np.mean(state.slides[:, j] ** 2)) for j in problem.sliding])
    weights = np.repeat(size / problem.slide_sd[problem.sliding], 3)
    last = slice(linear.off.shape[1] - 3 * len(problem.sliding), None)
    sliding = np.asarray(weights[:, None] * (linear.by_frame[:, last] @ bundle.gain))

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
    if bundle.prior is not None:
        gradients = np.zeros((2 * len(problem.kinds), cols.size))  # of the cost for typical errors of the likely axes
        for j, second in enumerate(cols.second):
            if bundle.prior.along[j] and second is not None:
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
