"""Fit of a chain in space: kinds, centres and axes of the joints, and coordinates of the markers.

The first guess comes from the marker clusters as rigid bodies. A cluster that is fixed to a plate keeps its shape while
it moves by centimetres on the bone. The distances between its markers do not change, but the two clusters of a joint
then locate the joint centre at two different points. If these are farther apart than errors of single markers explain,
the fit includes a slide of the joint. Without it, the displacement would rotate the clusters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import NumericalError
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import JointKind, SpatialChain, SpatialJoint
from mocap_id.kinematics.bundle import frames_along_motion
from mocap_id.kinematics.space.bodies import fit_shape, rigid_poses
from mocap_id.kinematics.space.bundle import (
    CENTRE_SD,
    MARKED_SD,
    Bundle,
    BundleProblem,
    BundleState,
    apply_step,
    chain_covariance,
    count_correlated_frames,
    fit_frames_only,
    glide_share,
    joint_rotations,
    long_axes,
    residuals,
    solve_bundle,
    tangents,
)
from mocap_id.kinematics.space.skeleton import (
    PARALLEL,
    JointAxes,
    JointEvidence,
    fit_hinge,
    fit_pin_axes,
    fit_two_axes,
    rotation_arc,
    weigh_kinds,
)

Estimator: TypeAlias = Literal["bundle", "score", "sphere", "helical"]

_FRAMES = 180
_FRAMES_OF_KINDS = 80
_FEWEST = 20
_FIRST_SD = 0.002  # m; first guess of the error of a marker
_LASTING = 1.5  # frames over which errors persist; a larger number is soft tissue
_UP = (0.0, 1.0, 0.0)
_BALL: JointKind = "ball"
_SIMPLEST: tuple[JointKind, ...] = ("hinge", "two-axis", _BALL)
_NO_AXES: JointAxes = (np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), 1.0)


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

    The trajectories ``points`` (F, M, 3) are in the frame of the trial, m, NaN where missing, and ``segment`` (M,) is
    the segment of each marker, 0 = base … n. Every segment has at least three markers that are not on one line.
    ``parents`` are the parents of segments 1 … n, smaller than the segments. Segments are numbers 1 … n in:

    - ``kinds``: kinds of joints that the user has set. The others are chosen by evidence. A two-axis joint with nearly
      parallel axes becomes a ball, because its axes would not determine its angles.
    - ``near``: trajectories (F, 3) of points near the joints, such as the middle of the epicondyles, m; NaN where
      missing.
    - ``firm``: segments for which no sliding of the skin under axial rotation is fitted, such as a shoulder girdle.

    ``bundle`` is the bundle adjustment. The other estimators find centres from pairs of clusters; the result then has
    no covariances, no glide and no motion of the skin, and every centre counts as known. ``girdle`` are the markers,
    0 … M - 1, that are on the shoulder girdle by their names; others are found by their motion. ``up`` (3,) is the
    direction from which the elevation of the girdle is measured, in the frame of the trial.

    Raises
    ------
    NumericalError
        Too few frames contain all segments, or the iteration does not converge.
    """
    given, parents = kinds or {}, tuple(parents)
    seen: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    enough = np.all([seen[:, segment == k].sum(axis=1) >= 3 for k in range(int(segment.max()) + 1)], axis=0)
    among = np.flatnonzero(enough)
    if len(among) < _FEWEST:
        raise NumericalError(
            f"{len(among)} frames contain three markers of every segment; {_FEWEST} are needed to fit the joints"
        )
    used = frames_along_motion(points.reshape(len(points), -1).astype(np.complex128), _FRAMES, among)
    reference = int(np.argmax(seen[used][: max(len(used) // 10, 1)].sum(axis=1)))
    local, rotation, origin, cluster_sd = fit_clusters(points[used], segment, reference)
    known = np.isfinite(rotation).all(axis=(1, 2, 3))
    rotation, origin, used = rotation[known], origin[known], used[known]
    count, points = len(parents), points[used]
    beside = {k: track[used] for k, track in (near or {}).items()}
    slide_sd = np.zeros(count)
    if estimator == "bundle":
        slide_sd = _estimate_slide_sds(local, rotation, origin, cluster_sd, segment=segment, parents=parents)
    inner = np.isin(np.arange(1, count + 1), parents)  # segments that carry another joint
    rest = (np.swapaxes(rotation[:, 0], 1, 2) @ np.asarray(up, dtype=np.float64)).mean(axis=0)

    def build_problem(
        frames: IntArray,
        kinds: tuple[JointKind, ...],
        firm: frozenset[int],
        *,
        rough: Bundle | None = None,
        riding: BoolArray | None = None,
        estimator: Estimator = "bundle",
    ) -> tuple[BundleProblem, BundleState]:
        """Return problem and first guess for some frames.

        ``rough`` is a fit with ball joints, and ``riding`` (M,) marks the base markers on the girdle.
        """
        seen: BoolArray = np.asarray(np.isfinite(points[frames]).all(axis=2))

        # centres in the clusters of the parents, and origins of the segments in their own clusters
        own, centres = np.zeros((count + 1, 3)), np.zeros((count, 3))
        for j, parent in enumerate(parents):
            if j + 1 in beside and estimator == "bundle":
                centres[j], own[j + 1] = (
                    np.nanmedian(np.einsum("fji,fj->fi", rotation[:, k], beside[j + 1] - origin[:, k]), axis=0)
                    for k in (parent, j + 1)
                )
            else:
                turns, apart = (rotation[:, parent], rotation[:, j + 1]), origin[:, j + 1] - origin[:, parent]
                centres[j], own[j + 1] = estimate_centre(estimator, *turns, apart, local[segment == j + 1])
        centres = centres - own[list(parents)]

        soft = inner & ~np.isin(np.arange(1, count + 1), list(firm))
        axes, along = [_NO_AXES] * count, np.zeros(count, dtype=bool)
        first_centres, first_local = centres, np.nan_to_num(local) - own[segment]
        skin = np.zeros(len(segment))
        weights = seen / _FIRST_SD
        if rough is not None:
            joints = joint_rotations(rough.problem, rough.state)
            for j, kind in enumerate(kinds):
                if kind == "hinge":
                    axes[j] = fit_hinge(joints[:, j])
                elif kind == "two-axis":
                    pin = rough.problem.long_axes[j]
                    pair = fit_pin_axes(joints[:, j], rough.rotation_noise(j), pin) if inner[j] else None
                    axes[j], along[j] = pair or fit_two_axes(joints[:, j]), pair is not None
            soft &= np.array([rough.together[segment == k + 1].mean() > _LASTING for k in range(count)])
            weights = seen / (rough.sd * np.sqrt(rough.together))
            if estimator == "bundle":  # markers and centres of the rough fit, with hinges shifted along their axes
                first_centres, first_local = rough.state.centres.copy(), rough.state.local.copy()
                skin = rough.state.skin * np.isin(segment, np.flatnonzero(soft) + 1)
                for j, (kind, (first, second, _)) in enumerate(zip(kinds, axes, strict=True)):
                    if kind == "hinge":
                        ahead = first @ (centres[j] - first_centres[j])
                        first_centres[j] += ahead * first
                        first_local[segment == j + 1] -= ahead * second
                        first_centres[np.array(parents) == j + 1] -= ahead * second
        firsts, seconds, cosines = zip(*axes, strict=True)
        state = BundleState(
            first_local,
            first_centres,
            np.array(firsts),
            np.array(seconds),
            np.array(cosines),
            np.zeros(3),
            skin,
            origin[frames, 0],
            rotation[frames],
            np.zeros((len(frames), count, 3)),
        )
        problem = BundleProblem(
            np.where(seen[..., None], points[frames], 0.0),
            weights,
            segment,
            parents,
            kinds,
            np.asarray(rest / np.linalg.norm(rest)),
            np.zeros(len(segment), dtype=bool) if riding is None else riding,
            long_axes(parents, segment, state),
            slide_sd,
            centres,
            np.array([MARKED_SD if j + 1 in beside else CENTRE_SD for j in range(count)]),
            along,
            soft,
        )
        return problem, state

    # fit to some frames with ball joints only; implausible skin motion is set to zero
    every = np.arange(len(used))
    few = np.unique(np.linspace(0, len(used) - 1, min(len(used), _FRAMES_OF_KINDS)).astype(np.int64))
    balls, still = (_BALL,) * count, frozenset(firm)
    rough = solve_bundle(*build_problem(few, balls, still))
    if unlike := find_implausible_skin(rough.problem, rough.state):
        still |= unlike
        rough = solve_bundle(*build_problem(few, balls, still))

    # kinds of the joints: an axial rotation that all markers of a segment share is hardly visible, so its error can
    # tilt an axis. Therefore a simpler kind is preferred if it explains the rotation without motion of the skin.
    arcs = [
        rotation_arc(np.swapaxes(rotation[:, parent], 1, 2) @ rotation[:, j]) for j, parent in enumerate(parents, 1)
    ]

    def weigh(bundle: Bundle) -> tuple[JointEvidence, ...]:
        turns = joint_rotations(bundle.problem, bundle.state)
        return tuple(
            weigh_kinds(turns[:, j], bundle.rotation_noise(j), arc, given.get(j + 1)) for j, arc in enumerate(arcs)
        )

    evidence = weigh(rough)
    if any(each.kind != "hinge" for j, each in enumerate(evidence, start=1) if j not in given):
        bare = solve_bundle(*build_problem(few, balls, frozenset(range(1, count + 1))))
        pairs = zip(evidence, weigh(bare), strict=True)
        evidence = tuple(min(pair, key=lambda each: _SIMPLEST.index(each.kind)) for pair in pairs)
    chosen: tuple[JointKind, ...] = tuple(each.kind for each in evidence)
    if estimator != "bundle":
        return collect_result(
            fit_frames_only(*build_problem(every, chosen, still, rough=rough, estimator=estimator)), evidence
        )

    # fit to all frames, repeated until the kinds of all joints and the skin motion are plausible
    guess, named = rough, np.isin(np.arange(len(segment)), list(girdle))
    while True:
        riding = _find_girdle_markers(rough, chosen, named)
        bundle = solve_bundle(*build_problem(every, chosen, still, rough=guess, riding=riding))
        parallel = (np.abs(bundle.state.cosine) > PARALLEL) & (np.array(chosen) == "two-axis")
        if parallel.any():
            chosen = tuple(_BALL if near else kind for kind, near in zip(chosen, parallel, strict=True))
            guess = rough  # because wrong axes distort the whole fit
        elif unlike := find_implausible_skin(bundle.problem, bundle.state) - still:
            still, guess = still | unlike, bundle
        else:
            final = zip(evidence, chosen, strict=True)
            return collect_result(bundle, tuple(replace(each, kind=kind) for each, kind in final))


_FAR = 0.3  # m; typical distance of a joint from its clusters
_BEYOND = 2.5  # least ratio of the slide to the displacement that single markers explain; up to 1.8 without a slide
_LEAST = 0.001  # m
_USUAL = 0.95  # fraction of the frames used; the others may contain swapped markers
_SOFT = 0.01  # m; typical motion of the shared point
_TURN = 0.25  # lag between the two poses of a finite rotation, as a fraction of the frames
_LEAST_TURN = 1e-3  # weight of the child's mean position, for directions that the motion does not determine


def fit_clusters(
    points: FloatArray, segment: IntArray, reference: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit a rigid body to the markers (F, M, 3), m, of every segment, with the trial's axes in frame ``reference``.

    The results are the marker coordinates (M, 3) relative to the centroid of their cluster, m; rotation (F, n + 1,
    3, 3), cluster to trial, and origin (F, n + 1, 3), m, of every cluster; and the standard deviation (n + 1,) of one
    coordinate of a marker in its cluster, m.
    """
    local = np.full((points.shape[1], 3), np.nan)
    rotations, origins, variances = [], [], []
    for k in range(int(segment.max()) + 1):
        here = np.flatnonzero(segment == k)
        start = points[reference, here] - np.nanmean(points[reference, here], axis=0)
        shape = local[here] = fit_shape(points[:, here], start)
        rotation, origin, _ = rigid_poses(points[:, here], shape)
        off = points[:, here] - origin[:, None] - np.einsum("fij,mj->fmi", rotation, shape)
        known = int(np.isfinite(shape).all(axis=1).sum())
        rotations.append(rotation)
        origins.append(origin)
        variances.append(np.nanmean(off**2) * known / max(known - 2, 1))
    return local, np.stack(rotations, axis=1), np.stack(origins, axis=1), np.sqrt(np.array(variances))


def estimate_centre(
    estimator: Estimator, own: FloatArray, other: FloatArray, apart: FloatArray, local: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a joint centre (3,) in the frame of the parent's cluster and in that of the child's cluster, m.

    ``own`` and ``other`` (F, 3, 3) are the rotations of the clusters of parent and child, ``apart`` (F, 3) is the
    vector between their origins, m, and ``local`` (k, 3) are the markers of the child in the frame of its cluster, m.
    ``score`` (also for ``bundle``) is the symmetrical centre of rotation (SCoRE, Ehrig et al. 2006), the point that
    moves least between the two bodies, with a weak pull to the middle between the bodies for directions that the motion
    does not determine.
    """
    origin = np.einsum("fji,fj->fi", own, apart)
    if estimator in ("bundle", "score"):
        rows = np.concatenate([own, -other], axis=2).reshape(-1, 6)
        likely = np.concatenate([origin.mean(axis=0), -np.einsum("fji,fj->fi", other, apart).mean(axis=0)])
        weight = (_SOFT / _FAR) ** 2 * len(own)
        inverse = np.linalg.inv(rows.T @ rows + weight * np.eye(6))
        point = inverse @ (rows.T @ apart.reshape(-1) + weight * likely / 2)
        return point[:3], point[3:]
    turn = np.asarray(np.swapaxes(own, 1, 2) @ other)
    if estimator == "sphere":  # common centre of the spheres on which the markers of the child move in the parent
        places = origin[:, None] + np.einsum("fij,kj->fki", turn, local)
        middle = places.mean(axis=0)
        about = places - middle
        square = (about**2).sum(axis=2)
        rows, likely = 2 * about.reshape(-1, 3), places.mean(axis=(0, 1))
        right = (square - square.mean(axis=0) + 2 * np.einsum("fki,ki->fk", about, middle)).reshape(-1)
    else:  # point nearest to the helical axes of the child in the parent
        lag = max(int(_TURN * len(turn)), 1)
        finite = turn[lag:] @ np.swapaxes(turn[:-lag], 1, 2)
        rows, likely = (np.eye(3) - finite).reshape(-1, 3), origin.mean(axis=0)
        right = (origin[lag:] - np.einsum("fij,fj->fi", finite, origin[:-lag])).reshape(-1)
    normal = rows.T @ rows
    pull = _LEAST_TURN * np.linalg.eigvalsh(normal)[-1] * np.eye(3)
    centre = np.asarray(np.linalg.solve(normal + pull, rows.T @ right + pull @ likely))
    return centre, np.einsum("fji,fj->fi", turn, centre - origin).mean(axis=0)


def _estimate_slide_sds(
    local: FloatArray,
    rotation: FloatArray,
    origin: FloatArray,
    sd: FloatArray,
    *,
    segment: IntArray,
    parents: tuple[int, ...],
) -> FloatArray:
    """Return the standard deviation of each joint's slide (n,), m; 0 without a slide. See :func:`fit_clusters`.

    The slide (F, n, 3) is the displacement between both clusters at the joint. The standard deviation is increased,
    because the slides of neighbouring frames are correlated.
    """
    slides = np.zeros((len(rotation), len(parents), 3))
    for j, parent in enumerate(parents):
        between = origin[:, j + 1] - origin[:, parent]
        centre, own = estimate_centre("score", rotation[:, parent], rotation[:, j + 1], between, local)
        ends = [origin[:, k] + rotation[:, k] @ place for k, place in ((parent, centre), (j + 1, own))]
        apart = np.einsum("fji,fj->fi", rotation[:, parent], ends[1] - ends[0])
        square = np.sort(np.sum((apart - np.median(apart, axis=0)) ** 2, axis=1))
        size = float(np.sqrt(square[: max(int(_USUAL * len(square)), 1)].mean() / 3))
        explained = 0.0  # variance per axis of the point in both clusters from independent errors of their markers
        for k, point in ((parent, centre), (j + 1, own)):
            markers = local[segment == k]
            markers = markers[np.isfinite(markers).all(axis=1)]
            inertia = np.sum(markers**2) * np.eye(3) - markers.T @ markers
            lever = so3.hat(point)
            turned = np.trace(lever @ np.linalg.solve(inertia, lever.T)) / 3
            explained += float(sd[k] ** 2 * (1 / len(markers) + turned))
        if size > max(_LEAST, _BEYOND * float(np.sqrt(explained))):
            slides[:, j] = apart
    about = slides - slides.mean(axis=0)
    return np.asarray(np.sqrt((about**2).mean(axis=(0, 2)) * count_correlated_frames(about)))


_LEAST_GLIDE = 0.004  # m; least modelled motion at an elevation of 180°
_EXPLAINED = 0.5  # least fraction of the marker's motion in the base that follows the elevation
_STANDS_OUT = 3.0  # least ratio of the motion of a girdle marker to the typical motion of the base markers
_RANGE = 0.15  # least range of u; otherwise the arm is hardly raised
_FEWEST_ON_BASE = 4  # fewest base markers that are not on the girdle


def _find_girdle_markers(rough: Bundle, kinds: tuple[JointKind, ...], named: BoolArray) -> BoolArray:
    """Return the base markers (M,) on the shoulder girdle, which move with the elevation of segment 1.

    Base markers that are on the girdle by their names, ``named`` (M,), are included whatever their motion. Sliding skin
    may hide it, and without the glide, the elevation of every raised arm would be overestimated. No marker is returned
    if segment 1 has no ball joint on the base, if the arm is hardly raised, or if too few base markers would remain.
    """
    problem, state = rough.problem, rough.state
    none = np.zeros(len(problem.segment), dtype=bool)
    if kinds[0] != "ball" or problem.parents[0] != 0:
        return none
    off, seen, base, share = (
        residuals(problem, state),
        problem.weights > 0,
        problem.segment == 0,
        glide_share(problem, state),
    )
    low, high = np.quantile(share, [0.05, 0.95])
    if high - low < _RANGE or base.sum() <= _FEWEST_ON_BASE:
        return none
    motion, explained = np.zeros(off.shape[1]), np.zeros(off.shape[1])
    for m in np.flatnonzero(base):
        here = seen[:, m]
        if here.sum() < 10:
            continue
        u = share[here] - share[here].mean()
        y = off[here, m] - off[here, m].mean(axis=0)
        slope = u @ y / (u @ u)
        motion[m] = np.linalg.norm(slope)
        explained[m] = motion[m] ** 2 * (u @ u) / np.sum(y**2)
    usual = np.median(motion[base])
    on_girdle = base & (named | (motion > np.maximum(_LEAST_GLIDE, _STANDS_OUT * usual)) & (explained > _EXPLAINED))
    return np.asarray(on_girdle) if base.sum() - on_girdle.sum() >= _FEWEST_ON_BASE else none


_UNKNOWN = 0.02  # m; largest standard deviation of a known centre across its axis
_COMMON = 0.5  # largest fraction of axial rotation that the skin beside the next joint does not follow
_OPPOSITE, _WHOLE = -0.25, 0.9  # range of plausible fractions
_LEAST_ARC = float(np.radians(6))  # least rotation that determines a centre; soft tissue alone may reach this


@dataclass(frozen=True)
class SpatialFit:
    """Chain fitted to markers.

    The origin of a segment's frame is the centre of its joint. The frame's axes are nearly parallel to those of the
    trial in the first frame of the fit.
    """

    chain: SpatialChain
    evidence: tuple[JointEvidence, ...]
    residual: FloatArray  # (M,) rms residual of each marker, including skin motion by axial rotation, m
    lengths: FloatArray  # (n - 1,) distances of joints 2 … n from the joint of their parent segment, m
    length_sd: FloatArray  # (n - 1,) standard deviations of these lengths, m
    bundle: Bundle  # solution, for :func:`move_centre`
    covariance: FloatArray  # (P, P) covariance of the parameters in the order of ``bundle.problem.columns``

    def centre_among_markers(self, joint: int, segment: int) -> FloatArray:
        """Return the covariance (3, 3), m², of the centre of a joint, 1 … n, relative to a segment's mean marker."""
        about = _centre_jacobian(self.bundle.problem, joint - 1, segment)
        return np.asarray(about @ self.covariance @ about.T)


def collect_result(
    bundle: Bundle, evidence: tuple[JointEvidence, ...], covariance: FloatArray | None = None
) -> SpatialFit:
    """Return the result of a bundle adjustment; the covariance (P, P) of the parameters is computed if not given."""
    problem, state, cols = bundle.problem, bundle.state, bundle.problem.columns
    covariance = chain_covariance(bundle) if covariance is None else covariance
    turns = joint_rotations(problem, state)[0]
    joints = []
    for j, (kind, parent) in enumerate(zip(problem.kinds, problem.parents, strict=True)):
        axis, pin = state.first[j], state.second[j]
        about = _centre_jacobian(problem, j, parent)
        near = about @ covariance @ about.T
        if not np.isnan(near).any():  # the motion must determine the centre, except along the axis of a hinge
            across = np.eye(3) if kind == "ball" else tangents(axis)
            determined = bool(np.linalg.eigvalsh(across.T @ near @ across)[-1] < _UNKNOWN**2)
        else:
            determined = True
        joint = SpatialJoint(
            kind,
            parent,
            state.centres[j],
            covariance[cols.centre[j], cols.centre[j]],
            long_axis=problem.long_axes[j],
            untwisted=problem.untwisted[j],
            known=evidence[j].arc >= _LEAST_ARC and determined,
            slide_sd=float(np.sqrt(np.mean(state.slides[:, j] ** 2))),
        )
        if kind != "ball":
            spread = np.full((2, 3, 3), np.nan)
            for i, (place, each) in enumerate(((cols.first[j], axis), (cols.second[j], pin))):
                if place is not None and (i == 0 or kind == "two-axis"):
                    spread[i] = tangents(each) @ covariance[place, place] @ tangents(each).T
            offset = align_offset(turns[j], axis, pin, state.cosine[j] if kind == "two-axis" else 1.0)
            joint = replace(joint, first_axis=axis, second_axis=pin, axes_covariance=spread, offset=offset)
        if j == 0 and cols.glide is not None:
            glide_covariance = covariance[cols.glide, cols.glide]
            joint = replace(joint, glide=state.glide, glide_covariance=glide_covariance, rest=problem.rest)
        joints.append(joint)
    seen = problem.weights > 0
    local = np.where(np.asarray(seen.any(axis=0))[:, None], state.local, np.nan)
    skin_sd = np.sqrt(np.maximum(np.diag(covariance[cols.skin, cols.skin]), 0.0))
    skin = _anchor_skin(problem, state)
    whole = residuals(problem, replace(state, skin=np.zeros(len(problem.segment))))
    square = (whole**2).sum(axis=2)
    inner = [j for j, parent in enumerate(problem.parents) if parent > 0]
    lengths = np.linalg.norm(state.centres[inner], axis=1)
    along = state.centres[inner] / lengths[:, None]
    variances = [axis @ joints[j].covariance @ axis for axis, j in zip(along, inner, strict=True)]
    return SpatialFit(
        SpatialChain(tuple(joints), problem.segment, local, problem.on_glide, skin, skin_sd),
        evidence,
        np.sqrt(square.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)),
        lengths,
        np.sqrt(np.array(variances, dtype=np.float64)),
        bundle,
        covariance,
    )


def _anchor_skin(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return the fractions (M,) of axial rotation that the skin does not follow, changed to 0 beside the next joint.

    The motion determines the differences between markers, but hardly the mean of all markers of a segment. With the
    fraction c beside the next joint, 1 - s becomes (1 - s) / (1 - c). A last segment has no next joint.
    """
    skin: FloatArray = np.zeros_like(state.skin)
    for j, parent in enumerate(problem.parents):
        here = np.flatnonzero(problem.segment == parent)
        if parent > 0 and len(here):
            skin[here] = 1 - (1 - state.skin[here]) / (1 - np.clip(_common_share(problem, state, j), -0.5, 0.9))
    return skin


def _common_share(problem: BundleProblem, state: BundleState, j: int) -> float:
    """Return the mean fraction ``state.skin`` of the parent's two markers that are nearest to joint j."""
    here = np.flatnonzero(problem.segment == problem.parents[j])
    away = np.linalg.norm(state.local[here] - state.centres[j], axis=1)
    return float(state.skin[here[np.argsort(away)[:2]]].mean())


def find_implausible_skin(problem: BundleProblem, state: BundleState) -> frozenset[int]:
    """Return the segments whose fractions ``state.skin`` are impossible for skin and must describe another motion."""
    anchored = _anchor_skin(problem, state)
    segments = []
    for j, parent in enumerate(problem.parents):
        here = problem.segment == parent
        if parent > 0 and here.any():
            low, high = anchored[here].min(), anchored[here].max()
            if abs(_common_share(problem, state, j)) > _COMMON or low < _OPPOSITE or high > _WHOLE:
                segments.append(parent)
    return frozenset(segments)


def _centre_jacobian(problem: BundleProblem, j: int, segment: int) -> FloatArray:
    """Return the derivatives (3, P) of the vector from a segment's mean marker to joint ``j``, numbered from 0."""
    here = np.flatnonzero(problem.segment == segment)
    rows = np.zeros((3, problem.columns.size))
    if segment == problem.parents[j]:
        rows[:, problem.columns.centre[j]] = np.eye(3)
    for m in here:
        rows[:, 3 * m : 3 * m + 3] = -np.eye(3) / len(here)
    return rows


def align_offset(turn: FloatArray, axis: FloatArray, pin: FloatArray, cosine: float) -> FloatArray:
    """Return the rotation (3, 3) nearest to ``turn`` that brings ``axis`` and ``pin`` to the angle with this cosine.

    The unit axis (3,) is in the frame of the parent, and the unit pin (3,) in the frame of the child.
    """
    rotated_pin = turn @ pin
    normal = np.cross(axis, rotated_pin)
    size = float(np.linalg.norm(normal))
    if size < 1e-9:
        normal, size = tangents(axis)[:, 0], 1.0
    angle = np.arccos(np.clip(cosine, -1, 1)) - np.arccos(np.clip(rotated_pin @ axis, -1, 1))
    return np.asarray(so3.exp(angle * normal / size) @ turn)


def move_centre(fit: SpatialFit, joint: int, point: FloatArray, covariance: FloatArray) -> SpatialFit:
    """Return the fit, updated with another measurement of a joint centre, such as palpated landmarks.

    All parameters change according to their covariance (a Kalman update), so markers, centres and axes stay consistent.
    In a direction that the motion hardly determines, such as along a hinge, the centre follows the measured point.
    ``joint`` is the number of the joint's segment, 1 … n. The point (3,), m, is in the frame of the parent segment of
    ``fit.chain``, among its markers, and has the covariance (3, 3), m².
    """
    problem, state = fit.bundle.problem, fit.bundle.state
    about = _centre_jacobian(problem, joint - 1, problem.parents[joint - 1])
    known = about @ fit.covariance
    gain = np.linalg.solve(known @ about.T + covariance, known).T
    step = gain @ (point - state.centres[joint - 1])
    moved = apply_step(problem, state, step, -fit.bundle.gain @ step)
    return collect_result(replace(fit.bundle, state=moved), fit.evidence, fit.covariance - gain @ known)


# rms change of the angle between the axes by skin that slides with the joint
_CHANGING_ANGLE = np.radians(0.6)
_OTHER_ANGLE = np.radians(5)  # typical change of this angle by a constant displacement of the skin
_ITERATIONS = 8
_SHOWN = 0.85  # largest ratio of the standard deviations of the first axis after and before the correction


def refine_axes(chain: SpatialChain, rotations: FloatArray) -> tuple[SpatialChain, tuple[int, ...]]:
    """Return the calibrated chain with corrected axes of two-axis joints, and the numbers of these joints, from 0.

    Only joints whose axes become clearly more certain are corrected. ``rotations`` (F, n + 1, 3, 3) are the rotations
    of the clusters in the new trial, NaN where unknown.
    """
    joints, refined = list(chain.joints), []
    for k, joint in enumerate(chain.joints):
        turn = np.swapaxes(rotations[:, joint.parent], 1, 2) @ rotations[:, k + 1]
        turn = turn[np.isfinite(turn).all(axis=(1, 2))]
        if not has_known_axes(joint) or not len(turn):
            continue

        # axes and κ are refined by Gauss-Newton; the error of the skin is the same in all frames
        axis, pin = joint.first_axis, joint.second_axis
        before = cosine = float(axis @ joint.offset @ pin)
        bases = tangents(axis), tangents(pin)
        known = [
            np.linalg.inv(basis.T @ covariance @ basis)
            for basis, covariance in zip(bases, joint.axes_covariance, strict=True)
        ]
        weight = 1 / (_CHANGING_ANGLE**2 * len(turn))
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
        better = replace(
            joint,
            first_axis=axis,
            second_axis=pin,
            axes_covariance=np.stack([along @ spread[:2, :2] @ along.T, across @ spread[2:4, 2:4] @ across.T]),
            offset=align_offset(joint.offset, axis, pin, cosine),
        )
        if np.trace(better.axes_covariance[0]) < _SHOWN**2 * np.trace(joint.axes_covariance[0]):
            joints[k] = better
            refined.append(k)
    return replace(chain, joints=tuple(joints)), tuple(refined)


def has_known_axes(joint: SpatialJoint) -> bool:
    """Return whether a joint has two axes with known covariances."""
    return joint.kind == "two-axis" and bool(np.isfinite(joint.axes_covariance).all())
