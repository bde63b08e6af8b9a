"""Fit of a chain in space: kinds, centres and axes of the joints, and coordinates of the markers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import NumericalError
from mocap_id.geometry.spatial_chain import JointKind, SpatialChain, SpatialJoint
from mocap_id.kinematics.frame_sampling import frames_along_motion
from mocap_id.kinematics.space.bundle import (
    CENTRE_SD,
    MARKED_SD,
    Bundle,
    ChainPrior,
    count_correlated_frames,
    fit_frames_only,
    long_axes,
    solve_bundle,
)
from mocap_id.kinematics.space.bundle_equations import (
    BundleProblem,
    BundleState,
    glide_share,
    joint_rotations,
    residuals,
    tangents,
)
from mocap_id.kinematics.space.chain_result import SpatialFit, align_offset, collect_result, find_implausible_skin
from mocap_id.kinematics.space.chain_start import (
    CentreEstimator,
    Clusters,
    estimate_centre,
    find_joint_slides,
    fit_clusters,
)
from mocap_id.kinematics.space.joint_kinds import (
    PARALLEL,
    JointAxes,
    JointEvidence,
    find_girdle_markers,
    fit_hinge,
    fit_pin_axes,
    fit_two_axes,
    rotation_arc,
    weigh_kinds,
)

Estimator: TypeAlias = Literal["bundle"] | CentreEstimator

_FRAMES = 180
_FRAMES_OF_KINDS = 80
_FEWEST = 20
_FIRST_SD = 0.002  # m; first guess of the error of a marker
_LASTING = 1.5  # frames over which errors persist; a larger number is soft tissue
_UP = (0.0, 1.0, 0.0)
_BALL: JointKind = "ball"
_SIMPLEST: tuple[JointKind, ...] = ("hinge", "two-axis", _BALL)
_NO_AXES = JointAxes(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), 1.0)


def fit_spatial_chain(
    points: FloatArray,
    segment: IntArray,
    parents: Sequence[int],
    kinds: Mapping[int, JointKind] | None = None,
    *,
    estimator: Estimator = "bundle",
    near: Mapping[int, FloatArray] | None = None,
    firm: Collection[int] = (),
    girdle: Collection[int] = (),
    up: Sequence[float] = _UP,
) -> SpatialFit:
    """Fit a chain of rigid segments to marker trajectories by one bundle adjustment.

    Parameters
    ----------
    points : (F, M, 3) array
        Trajectories in the frame of the trial, m; NaN where missing.
    segment : (M,) int array
        Segment of each marker, 0 = base … n. Every segment has at least three markers that are not on one line.
    parents : sequence of int, length n
        Parent of segment 1 … n, smaller than the segment.
    kinds : mapping of int to kind, optional
        Kinds of joints that the user has set, by the number of their segment, 1 … n. The others are chosen by evidence.
        A two-axis joint with nearly parallel axes becomes a ball, because its axes would not determine its angles.
    estimator : {"bundle", "score", "sphere", "helical"}
        ``bundle`` is the bundle adjustment. The others find centres from pairs of clusters. The result then has no
        covariances, no glide and no motion of the skin, and every centre counts as known.
    near : mapping of int to (F, 3) array, optional
        Trajectories of points near the joints, such as the middle of the epicondyles, by the number of the segment, m;
        NaN where missing.
    firm : collection of int
        Segments, 1 … n, for which no sliding of the skin under axial rotation is fitted, such as a shoulder girdle.
    girdle : collection of int
        Markers, 0 … M - 1, that are on the shoulder girdle by their names. Others are found by their motion.
    up : (3,) sequence
        Direction from which the elevation of the girdle is measured, in the frame of the trial.

    Raises
    ------
    NumericalError
        Too few frames contain all segments, or the iteration does not converge.
    """
    used = choose_frames(points, segment, _FRAMES)
    clusters, used = fit_clusters_at(points, segment, used)
    few = np.unique(np.linspace(0, len(used) - 1, min(len(used), _FRAMES_OF_KINDS)).astype(np.int64))
    beside = {k: track[used] for k, track in (near or {}).items()}
    above = np.asarray(up, dtype=np.float64)
    slides = estimate_slide_sds(clusters, segment, parents) if estimator == "bundle" else np.zeros(len(parents))
    named = np.isin(np.arange(len(segment)), list(girdle))
    start = _Start(points[used], segment, tuple(parents), clusters, above, beside, slides, named, frozenset(firm))
    start, rough = _rough_bundle(start, few)
    evidence = _weigh_joints(start, rough, few, kinds or {})
    chosen: tuple[JointKind, ...] = tuple(each.kind for each in evidence)
    if estimator != "bundle":
        problem, state, _ = start.build_problem(np.arange(len(used)), chosen, rough, estimator=estimator)
        return collect_result(fit_frames_only(problem, state), evidence)
    bundle = _whole_bundle(start, chosen, rough)
    final = zip(evidence, bundle.problem.kinds, strict=True)
    return collect_result(bundle, tuple(replace(each, kind=kind) for each, kind in final))


def _rough_bundle(start: _Start, frames: IntArray) -> tuple[_Start, Bundle]:
    """Return the input without implausible skin motion, and the fit to some frames with ball joints only."""
    balls = (_BALL,) * len(start.parents)
    rough = solve_bundle(*start.build_problem(frames, balls))
    if unlike := find_implausible_skin(rough.problem, rough.state):
        start = replace(start, firm=start.firm | set(unlike))
        rough = solve_bundle(*start.build_problem(frames, balls))
    return start, rough


def _weigh_joints(
    start: _Start, rough: Bundle, frames: IntArray, kinds: Mapping[int, JointKind]
) -> tuple[JointEvidence, ...]:
    """Return the evidence for the kind of each joint: the simpler kind of two fits, with and without axial skin motion.

    An axial rotation that all markers of a segment share is hardly visible, so its error can tilt an axis. Therefore a
    simpler kind is preferred if it explains the joint rotation without this axial rotation.
    """
    evidence = _weigh_all_kinds(rough, start.clusters, kinds)
    if all(each.kind == "hinge" for j, each in enumerate(evidence, start=1) if j not in kinds):
        return evidence
    every = frozenset(range(1, len(start.parents) + 1))
    bare = solve_bundle(*replace(start, firm=every).build_problem(frames, (_BALL,) * len(start.parents)))
    pairs = zip(evidence, _weigh_all_kinds(bare, start.clusters, kinds), strict=True)
    return tuple(min(pair, key=lambda each: _SIMPLEST.index(each.kind)) for pair in pairs)


def _weigh_all_kinds(bundle: Bundle, clusters: Clusters, kinds: Mapping[int, JointKind]) -> tuple[JointEvidence, ...]:
    """Return the evidence for the kind of each joint, from a fit with ball joints."""
    turns, evidence = joint_rotations(bundle.problem, bundle.state), []
    for j, parent in enumerate(bundle.problem.parents):
        arc = rotation_arc(clusters.relative_rotation(parent, j + 1))
        evidence.append(weigh_kinds(turns[:, j], bundle.rotation_noise(j), arc, kinds.get(j + 1)))
    return tuple(evidence)


def _whole_bundle(start: _Start, kinds: tuple[JointKind, ...], rough: Bundle) -> Bundle:
    """Return the fit to all frames, repeated until the kinds of all joints and the skin motion are plausible.

    Two axes that are nearly parallel become a ball joint. Implausible skin motion is set to zero.
    """
    every, guess = np.arange(len(start.points)), rough
    while True:
        riding = _find_riding_markers(rough, kinds, start.named)
        bundle = solve_bundle(*start.build_problem(every, kinds, guess, riding))
        parallel = (np.abs(bundle.state.cosine) > PARALLEL) & (np.array(kinds) == "two-axis")
        if parallel.any():
            kinds = tuple(_BALL if near else kind for kind, near in zip(kinds, parallel, strict=True))
            guess = rough  # because wrong axes distort the whole fit
        elif unlike := set(find_implausible_skin(bundle.problem, bundle.state)) - start.firm:
            start, guess = replace(start, firm=start.firm | unlike), bundle
        else:
            return bundle


def estimate_slide_sds(clusters: Clusters, segment: IntArray, parents: Sequence[int]) -> FloatArray:
    """Return the standard deviation of each joint's slide (n,), m; 0 without a slide.

    The standard deviation is increased, because the slides of neighbouring frames are correlated.
    """
    slides = find_joint_slides(clusters, segment, parents)
    about = slides - slides.mean(axis=0)
    return np.asarray(np.sqrt((about**2).mean(axis=(0, 2)) * count_correlated_frames(about)))


def choose_frames(points: FloatArray, segment: IntArray, count: int) -> IntArray:
    """Return at most ``count`` frames along the motion in which every segment has three visible markers or more."""
    seen: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    enough = np.all([seen[:, segment == k].sum(axis=1) >= 3 for k in range(int(segment.max()) + 1)], axis=0)
    among = np.flatnonzero(enough)
    if len(among) < _FEWEST:
        raise NumericalError(
            f"{len(among)} frames contain three markers of every segment; {_FEWEST} are needed to fit the joints"
        )
    return frames_along_motion(points.reshape(len(points), -1).astype(np.complex128), count, among)


def fit_clusters_at(points: FloatArray, segment: IntArray, used: IntArray) -> tuple[Clusters, IntArray]:
    """Return the clusters in the frames in which all their poses are known, and these frames."""
    seen: BoolArray = np.asarray(np.isfinite(points[used]).all(axis=2))
    reference = int(np.argmax(seen[: max(len(used) // 10, 1)].sum(axis=1)))
    clusters = fit_clusters(points[used], segment, reference)
    known = np.isfinite(clusters.rotation).all(axis=(1, 2, 3))
    return replace(clusters, rotation=clusters.rotation[known], origin=clusters.origin[known]), used[known]


@dataclass(frozen=True)
class _Start:
    """Markers, clusters and settings from which the first guess of each fit is built."""

    points: FloatArray
    segment: IntArray
    parents: tuple[int, ...]
    clusters: Clusters
    up: FloatArray
    near: Mapping[int, FloatArray]
    slides: FloatArray
    named: BoolArray
    firm: frozenset[int] = frozenset()

    def _guess_centres(self, estimator: Estimator) -> tuple[FloatArray, FloatArray]:
        """Return the joint centres (n, 3) in the parents' frames and the segments' origins in their clusters, m."""
        own, centres = np.zeros((len(self.parents) + 1, 3)), np.zeros((len(self.parents), 3))
        name: CentreEstimator = "score" if estimator == "bundle" else estimator
        for j, parent in enumerate(self.parents):
            markers = self.clusters.local[self.segment == j + 1]
            if j + 1 in self.near and estimator == "bundle":
                centres[j], own[j + 1] = (self.clusters.median_position(k, self.near[j + 1]) for k in (parent, j + 1))
            else:
                centres[j], own[j + 1] = estimate_centre(name, self.clusters, parent, j + 1, markers)
        return centres - own[list(self.parents)], own

    def build_problem(
        self,
        frames: IntArray,
        kinds: tuple[JointKind, ...],
        rough: Bundle | None = None,
        riding: BoolArray | None = None,
        estimator: Estimator = "bundle",
    ) -> tuple[BundleProblem, BundleState, ChainPrior]:
        """Return problem, first guess and prior for some frames.

        ``rough`` is a fit with ball joints, and ``riding`` (M,) marks the base markers on the girdle.
        """
        points, clusters = self.points[frames], self.clusters
        count, markers = len(self.parents), points.shape[1]
        centres, own = self._guess_centres(estimator)
        inner = np.isin(np.arange(1, count + 1), self.parents)
        axes, along = [_NO_AXES] * count, np.zeros(count, dtype=bool)
        soft = inner & ~np.isin(np.arange(1, count + 1), list(self.firm))
        if rough is not None:
            pairs = [_guess_axes(rough, j, kinds[j], bool(inner[j])) for j in range(count)]
            axes, along = [each[0] for each in pairs], np.array([each[1] for each in pairs])
            soft &= np.array([rough.together[self.segment == k + 1].mean() > _LASTING for k in range(count)])
        seen: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
        rotation = clusters.rotation[frames]
        rest = (np.swapaxes(clusters.rotation[:, 0], 1, 2) @ self.up).mean(axis=0)
        riding = np.zeros(markers, dtype=bool) if riding is None else riding
        state = BundleState(
            np.nan_to_num(clusters.local) - own[self.segment],
            centres,
            np.array([each.first for each in axes]),
            np.array([each.second for each in axes]),
            np.array([each.cosine for each in axes]),
            np.zeros(3),
            np.zeros(markers),
            clusters.origin[frames, 0],
            rotation,
            np.zeros((len(frames), count, 3)),
        )
        weights = seen / _FIRST_SD
        if rough is not None:
            if estimator == "bundle":
                local, known = _move_along_hinges(rough, kinds, axes, centres)
                skin = rough.state.skin * np.isin(self.segment, np.flatnonzero(soft) + 1)
                state = replace(state, local=local, centres=known, skin=skin)
            weights = seen / (rough.sd * np.sqrt(rough.together))
        problem = BundleProblem(
            np.where(seen[..., None], points, 0.0),
            weights,
            self.segment,
            self.parents,
            kinds,
            np.asarray(rest / np.linalg.norm(rest)),
            riding,
            bool(riding.any()),
            np.zeros((count, 3)),
            self.slides,
        )
        sd = np.array([MARKED_SD if j + 1 in self.near else CENTRE_SD for j in range(count)])
        return replace(problem, long_axes=long_axes(problem, state)), state, ChainPrior(centres, along, soft, sd)


def _move_along_hinges(
    rough: Bundle, kinds: tuple[JointKind, ...], axes: list[JointAxes], centres: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return markers (M, 3) and centres (n, 3), m, of a rough fit, with hinges shifted along their axes."""
    problem, local, known = rough.problem, rough.state.local.copy(), rough.state.centres.copy()
    for j in np.flatnonzero([kind == "hinge" for kind in kinds]):
        ahead = axes[j].first @ (centres[j] - known[j])
        known[j] += ahead * axes[j].first
        local[problem.segment == j + 1] -= ahead * axes[j].second
        known[np.array(problem.parents) == j + 1] -= ahead * axes[j].second
    return local, known


def _guess_axes(rough: Bundle, j: int, kind: JointKind, inner: bool) -> tuple[JointAxes, bool]:
    """Return the first guess of the axes of a joint, and whether the second may be the long axis of its segment.

    The segment is ``inner`` if it carries another joint.
    """
    turn = joint_rotations(rough.problem, rough.state)[:, j]
    if kind == "ball":
        return _NO_AXES, False
    if kind == "hinge":
        return fit_hinge(turn), False
    pair = fit_pin_axes(turn, rough.rotation_noise(j), rough.problem.long_axes[j]) if inner else None
    return pair or fit_two_axes(turn), pair is not None


def _find_riding_markers(rough: Bundle, kinds: tuple[JointKind, ...], named: BoolArray) -> BoolArray:
    """Return the base markers (M,) on the shoulder girdle, which follow the elevation of segment 1."""
    problem, state = rough.problem, rough.state
    if kinds[0] != "ball" or problem.parents[0] != 0:
        return np.zeros(len(problem.segment), dtype=bool)
    seen = problem.weights > 0
    base, share = problem.segment == 0, glide_share(problem, state)
    return find_girdle_markers(residuals(problem, state), seen, base, share, named)


_AXIS_REFINEMENT_LASTING = np.radians(
    0.6
)  # rms change of the angle between the axes by skin that slides with the joint
_OTHER_ANGLE = np.radians(5)  # typical change of this angle by a constant displacement of the skin
_ITERATIONS = 8
_SHOWN = 0.85  # largest ratio of the standard deviations of the first axis after and before the correction


def refine_axes(chain: SpatialChain, rotations: FloatArray) -> tuple[SpatialChain, tuple[int, ...]]:
    """Return the calibrated chain with corrected axes of two-axis joints, and the numbers of these joints, from 0.

    Only joints whose axes become clearly more certain are corrected.

    ``rotations`` (F, n + 1, 3, 3) are the rotations of the clusters in the new trial, NaN where unknown.
    """
    joints, refined = list(chain.joints), []
    for k, joint in enumerate(chain.joints):
        turn = np.swapaxes(rotations[:, joint.parent], 1, 2) @ rotations[:, k + 1]
        turn = turn[np.isfinite(turn).all(axis=(1, 2))]
        if not has_known_axes(joint) or not len(turn):
            continue
        refined_joint = _refine_joint(joint, turn)
        if np.trace(refined_joint.axes_covariance[0]) < _SHOWN**2 * np.trace(joint.axes_covariance[0]):
            joints[k] = refined_joint
            refined.append(k)
    return replace(chain, joints=tuple(joints)), tuple(refined)


def has_known_axes(joint: SpatialJoint) -> bool:
    """Return whether a joint has two axes with known covariances."""
    return joint.kind == "two-axis" and bool(np.isfinite(joint.axes_covariance).all())


def _refine_joint(joint: SpatialJoint, turn: FloatArray) -> SpatialJoint:
    """Return the joint with axes and κ refined by Gauss-Newton; the error of the skin is the same in all frames."""
    axis, pin = joint.first_axis, joint.second_axis
    before = cosine = float(axis @ joint.offset @ pin)
    bases = tangents(axis), tangents(pin)
    known = [
        np.linalg.inv(basis.T @ covariance @ basis)
        for basis, covariance in zip(bases, joint.axes_covariance, strict=True)
    ]
    weight = 1 / (_AXIS_REFINEMENT_LASTING**2 * len(turn))
    for _ in range(_ITERATIONS):
        along, across = tangents(axis), tangents(pin)
        rotated_pin = turn @ pin
        rows = np.column_stack([rotated_pin @ along, (axis @ turn) @ across, -np.ones(len(turn))])
        matrix = weight * rows.T @ rows
        vector = weight * rows.T @ (rotated_pin @ axis - cosine)
        places = (slice(0, 2), axis, joint.first_axis, along), (slice(2, 4), pin, joint.second_axis, across)
        for (at, now, start, by), basis, inverse in zip(places, bases, known, strict=True):
            turned = basis.T @ by
            matrix[at, at] += turned.T @ inverse @ turned
            vector[at] += turned.T @ inverse @ basis.T @ (now - start)
        matrix[4, 4] += 1 / _OTHER_ANGLE**2
        vector[4] += (cosine - before) / _OTHER_ANGLE**2
        step = -np.linalg.solve(matrix, vector)
        axis, pin, cosine = axis + along @ step[:2], pin + across @ step[2:4], cosine + float(step[4])
        axis, pin = axis / np.linalg.norm(axis), pin / np.linalg.norm(pin)
    spread = np.linalg.inv(matrix)
    along, across = tangents(axis), tangents(pin)
    return replace(
        joint,
        first_axis=axis,
        second_axis=pin,
        axes_covariance=np.stack([along @ spread[:2, :2] @ along.T, across @ spread[2:4, 2:4] @ across.T]),
        offset=align_offset(joint.offset, axis, pin, cosine),
    )
