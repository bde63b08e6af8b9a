"""Chain fitted link by link, and all centres, marker coordinates and angles fitted together (3.13 to 3.16).

The fit solves :mod:`mocap_id.kinematics.chain_fit` by Gauss-Newton; bursts (large residuals) have less weight.
The data do not determine the orientation of a segment frame. Each iteration therefore takes the shortest step, and
:func:`mocap_id.kinematics.chain_fit.orient_frames` sets the orientation afterwards (the purpose of lambda_phi in 3.16).
Each marker is weighted by its residuals, because skin over muscle slides more than skin over bone. The frames of a fit
are enough of every posture, and few of postures that last long (:func:`frames_along_motion`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, chunks
from mocap_id.errors import NumericalError, Refused
from mocap_id.kinematics.chain_fit import (
    ChainFit,
    ChainProblem,
    ChainState,
    centre_covariance,
    gauss_newton_step,
    joint_arcs,
    joint_positions,
    lag_one_covariance,
    length_sd,
    share_variance,
    unwrap_angles,
)
from mocap_id.kinematics.joint import (
    RigidBody,
    fit_body,
    fit_common_centre,
    fit_joint,
    planar_poses,
    still_body,
    unit_directions,
)

LinkMethod = Literal["rigid-body", "circle"]

_BLOCKS = 20  # blocks of time, each left out once for the covariance
_FRAMES_A_JOINT = 10
_TURNS = 50  # iterations of the rotations about a known centre
_TOLERANCE = 1e-9  # m
_UNSEEN = 7.5  # ratio of the whole slide to its part that is visible in the residuals of body pairs


def fit_links(points: ComplexArray, segment: IntArray, method: LinkMethod) -> ChainFit:
    """Fit the chain link by link, by rigid bodies or circles; every segment has at least two markers.

    Raises
    ------
    Refused
        ``too-few-frames`` if too few frames contain all segments.
    NumericalError
        The markers of a segment move on straight lines, so that their circles have no centre.
    """
    state = rigid_body_links(points, segment) if method == "rigid-body" else circle_links(points, segment)
    used = find_used_frames(state.angles)
    origin, turn = joint_positions(state)
    origin = np.concatenate([np.zeros((len(turn), 1)), origin], axis=1)
    turn = np.concatenate([np.ones((len(turn), 1)), turn], axis=1)
    off = points - (origin[:, segment] + turn[:, segment] * state.local)
    off[~used] = np.nan
    off[:, segment == 0] = points[:, segment == 0] - state.local[segment == 0]
    angles = unwrap_angles(np.where(used[:, None], state.angles, np.nan))
    arcs = joint_arcs(angles[used])
    covariance = np.full((len(arcs), 2, 2), np.nan)
    if method == "rigid-body":
        # jackknife: one block of time is left out at a time. The covariance includes the dependence between joints and
        # the correlation of residuals within a block, but not errors common to all blocks.
        blocks = np.array_split(np.flatnonzero(used), min(_BLOCKS, int(used.sum())))
        refitted = []
        for block in blocks:
            part = rigid_body_links(np.delete(points, block, axis=0), segment)
            centres = part.centres.copy()
            for k in range(1, len(centres)):  # each segment frame is rotated to match that of all blocks
                own = segment == k
                towards = np.vdot(part.local[own], state.local[own]) + np.conj(part.centres[k]) * state.centres[k]
                centres[k] *= np.exp(1j * np.angle(towards))
            refitted.append(centres)
        apart = np.stack(refitted)
        apart = apart - apart.mean(axis=0)
        xy = np.stack([apart.real, apart.imag], axis=2)
        covariance = (len(blocks) - 1) / len(blocks) * np.einsum("bji,bjk->jik", xy, xy)

        # Skin that slides by s over an arc shifts the centre by about s / arc without a residual. The visible part of
        # the slide is the part of the residuals that persists to the next frame. The invisible part is _UNSEEN times as
        # large, calibrated on simulated bodies. Each centre is relative to the joint below, whose slide is included.
        seen = np.isfinite(off[used])
        lasting, chance = lag_one_covariance(np.where(seen, off[used], 0), seen)
        slip = np.empty(len(arcs))
        for k in range(1, len(arcs) + 1):
            members = segment == k
            slip[k - 1] = max(np.mean(lasting[members] - chance[members]), 0) / 2 / members.sum()
        at_joint = (slip + np.concatenate([[0.0], slip[:-1]])) / np.maximum(arcs, 1e-6) ** 2
        variance = _UNSEEN**2 * (at_joint + np.concatenate([[0.0], at_joint[:-1]]))
        covariance = covariance + variance[:, None, None] * np.eye(2)
    sd = length_sd(state.centres, covariance)
    return ChainFit(state.centres, state.local, segment, angles, covariance, sd, _rms(off), arcs)


def rigid_body_links(points: ComplexArray, segment: IntArray) -> ChainState:
    """Fit rigid bodies and the joint of every neighbouring pair, without initial values.

    The result has coordinates of all M markers (base markers in the plane frame), and angles in all F frames, NaN where
    fewer than two markers of the segment are visible.
    """
    bodies: list[RigidBody] = [still_body(points, np.flatnonzero(segment == 0))]
    bodies += [fit_body(points, np.flatnonzero(segment == k)) for k in range(1, int(segment.max()) + 1)]
    pairs = [fit_joint(parent, child) for parent, child in pairwise(bodies)]
    origins = [0j, *(pair.in_child for pair in pairs)]
    centres = np.array([pair.in_parent - origin for pair, origin in zip(pairs, origins, strict=False)])
    local = np.zeros(points.shape[1], dtype=np.complex128)
    for body, origin in zip(bodies, origins, strict=True):
        local[body.markers] = body.template - origin
    return ChainState(centres, local, np.stack([np.angle(body.rotation) for body in bodies[1:]], axis=1))


def chain_angles(
    points: ComplexArray,
    segment: IntArray,
    centres: ComplexArray,
    local: ComplexArray,
    joint_markers: Mapping[int, ComplexArray],
) -> FloatArray:
    """Return the segments' angles (F, n), rad, of a known chain; NaN where the markers do not determine them.

    A segment with two distinct points determines its own angle. The angle of any other segment follows from the joints
    at its ends, if a neighbouring segment with two points or joint markers locate them. ``centres`` (n,) and ``local``
    (M,) are in the frames of the segments, m. ``joint_markers`` are positions (F,) of joints 1 … n according to their
    markers, m.
    """
    joints = len(centres)
    angles = np.full((len(points), joints), np.nan)
    place: list[ComplexArray | None] = [None] * (joints + 1)
    place[0] = np.full(len(points), centres[0])
    for k in range(1, joints + 1):
        own = np.flatnonzero(segment == k)
        if len(own) < 2 or np.ptp(local[own].real) + np.ptp(local[own].imag) < 0.05:
            continue
        seen = np.isfinite(points[:, own])
        turn, origin = planar_poses(np.where(seen, points[:, own], 0), seen.astype(np.float64), local[own])
        known = np.where(seen.sum(axis=1) >= 2, 1.0, np.nan)
        angles[:, k - 1] = np.angle(turn * known)
        place[k - 1] = origin * known if k > 1 else place[0]
        if k < joints:
            place[k] = (origin + turn * centres[k]) * known
    for joint, track in joint_markers.items():
        if place[joint - 1] is None:
            place[joint - 1] = track
    for k in range(joints):
        near, far = place[k], place[k + 1]
        if np.isnan(angles[:, k]).all() and near is not None and far is not None:
            angles[:, k] = np.angle(far - near) - np.angle(centres[k + 1])
    return angles


def circle_links(points: ComplexArray, segment: IntArray) -> ChainState:
    """Fit the links by the recursion of 3.2.1. The result is as for :func:`rigid_body_links`."""
    joints = int(segment.max())
    centres, local = np.zeros(joints, dtype=np.complex128), np.zeros(points.shape[1], dtype=np.complex128)
    local[segment == 0] = still_body(points, np.flatnonzero(segment == 0)).template
    angles, seen_from = np.zeros((len(points), joints)), points
    for joint in range(joints):
        own = segment == joint + 1
        centre = fit_common_centre(seen_from[:, own])
        if not np.isfinite(centre):
            raise NumericalError(
                f"the markers of segment {joint + 1} move on straight lines relative to segment {joint}, so their "
                "circles have no centre. Use `fit-joints: {estimator: bundle}`."
            )
        centres[joint] = centre
        # rotation (F,) and coordinates (k,) about the known centre by least squares; NaN with fewer than two markers
        arms = seen_from[:, own] - centre
        seen = np.isfinite(arms)
        z, counts = np.where(seen, arms, 0), np.maximum(seen.sum(axis=0), 1)
        place = z[int(np.argmax(seen.sum(axis=1)))]
        for _ in range(_TURNS):
            previous = place
            place = (np.conj(unit_directions(z @ np.conj(place)))[:, None] * z).sum(axis=0) / counts
            if np.max(np.abs(place - previous)) < _TOLERANCE:
                break
        turn = np.where(seen.sum(axis=1) >= 2, unit_directions(z @ np.conj(place)), np.nan)
        local[own] = place
        angles[:, joint] = (angles[:, joint - 1] if joint else 0) + np.angle(turn)
        seen_from = np.conj(turn)[:, None] * (seen_from - centre)  # 3.9
    return ChainState(centres, local, angles)


def find_used_frames(angles: FloatArray) -> BoolArray:
    """Return the frames (F,) in which every angle (F, n) is known. Refuse the trial if these are too few."""
    used = np.asarray(np.isfinite(angles).all(axis=1))
    joints = angles.shape[1]
    needed = _FRAMES_A_JOINT * joints
    if used.sum() < needed:
        raise Refused(
            "too-few-frames",
            f"{used.sum()} of {len(used)} frames contain at least two markers of each of {joints} moving segments; "
            f"{needed} are needed to fit their joints. Use a longer `window:`, or fill the gaps.",
            float(used.sum()),
            float(needed),
        )
    return used


def _rms(off: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt(np.nanmean(np.abs(off) ** 2, axis=0)))


_ITERATIONS = 300
_ADAPTED = 100  # iterations in which the limits of bursts follow the residuals; later, they could alternate
_CONVERGED = 1e-7  # relative decrease of the cost
_NEARLY = 1e-3  # relative decrease of the cost at which the markers are weighted by their residuals
_WEIGHINGS = 2
_SHORTENINGS = 6
_HUBER = 3.0  # a residual larger than this many times the scale is a burst
_OFF_JOINT = 0.01  # m; standard deviation of a marker from the joint that it represents, in x and in y
_EXACT = 1e-4  # m; markers with smaller residuals have equal weights


def fit_chain(
    points: ComplexArray,
    segment: IntArray,
    auxiliary: Mapping[int, ComplexArray] | None = None,
    pull: float = 0.01,
    start: ChainState | None = None,
) -> ChainFit:
    """Fit the serial chain to the markers of its segments.

    The trajectories ``points`` (F, M) are in the plane, m, NaN where missing, and ``segment`` (M,) is 0 on the base and
    1 … n from base to tip. ``auxiliary`` are positions (F,) in the plane, m, of joints 1 … n according to markers at
    the joints, NaN where missing (p_A of 3.15), and ``pull`` is the weight of such a point relative to an average
    marker (lambda_A of 3.16). ``start`` is a first guess: centres, coordinates of all M markers, and angles (F, n), NaN
    where unknown. Without it, every segment needs at least two markers.

    Raises
    ------
    Refused
        ``too-few-frames`` if too few frames contain all segments; ``joint-unsettled`` if the iteration does not
        converge.
    """
    moving, still = np.flatnonzero(segment > 0), np.flatnonzero(segment == 0)
    start = start or rigid_body_links(points, segment)
    used = np.flatnonzero(find_used_frames(start.angles))
    tracks = {joint: track[used] for joint, track in (auxiliary or {}).items()}
    problem = ChainProblem.with_joint_markers(points[np.ix_(used, moving)], segment[moving], tracks, int(segment.max()))
    local = np.concatenate([start.local[moving], np.zeros(int(problem.pinned.sum()))])
    state, problem, iterations = _solve(problem, ChainState(start.centres, local, start.angles[used]), pull)

    # residuals and arcs
    template = still_body(points, still).template
    local, residual = np.zeros(len(segment), dtype=np.complex128), np.zeros(len(segment))
    local[still], local[moving] = template, state.local[~problem.pinned]
    off = np.where(problem.weights > 0, problem.residuals(state), np.nan)
    residual[still], residual[moving] = _rms(points[:, still] - template), _rms(off[:, ~problem.pinned])
    angles = np.full((len(points), problem.joints), np.nan)
    angles[used] = state.angles
    angles = unwrap_angles(angles)
    arcs = joint_arcs(angles[used])

    # covariance of the centres, with that from the unknown distances of pinned markers to their joints
    full = centre_covariance(problem, state)
    placement = np.zeros(full.shape)
    at_rest = gauss_newton_step(problem, state)[0] if problem.pinned.any() else np.zeros(len(full))
    for column in np.flatnonzero(problem.pinned):
        for offset in (_OFF_JOINT, 1j * _OFF_JOINT):
            shifted = problem.points.copy()
            shifted[:, column] += offset
            moved = (gauss_newton_step(replace(problem, points=shifted), state)[0] - at_rest)[: len(full)]
            placement += np.outer(moved, moved)
    full += placement
    covariance = np.stack([full[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] for j in range(problem.joints)])
    sd = length_sd(state.centres, covariance)
    return ChainFit(state.centres, local, segment, angles, covariance, sd, residual, arcs, iterations)


def _solve(problem: ChainProblem, state: ChainState, pull: float) -> tuple[ChainState, ChainProblem, int]:
    """Return the best state, the problem with final weights (``pull`` for pinned markers) and the iteration count."""
    own, seen = ~problem.pinned, problem.weights > 0
    scale = np.where(problem.pinned, pull, 1.0)
    cost, weighings = np.inf, 0
    limits, moved, off = np.zeros(problem.joints), np.zeros(problem.joints), np.abs(problem.residuals(state))
    for iteration in range(1, _ITERATIONS + 1):
        # bursts, residuals above a limit for each segment, have less weight (Huber)
        for k in range(1, problem.joints + 1) if iteration <= _ADAPTED else ():
            members = (problem.segment == k) & own
            rayleigh = np.median(off[:, members][seen[:, members]]) / 1.1774  # scale of a Rayleigh distribution
            limits[k - 1] = _HUBER * max(rayleigh, 1e-9)
        limit = limits[problem.segment - 1]
        bursts = np.where(problem.pinned, 1.0, limit / np.maximum(off, limit))
        problem = replace(problem, weights=np.where(seen, scale * bursts, 0.0))

        # a Gauss-Newton step, which is halved while the cost increases
        before, previous = state, cost
        common, turns = gauss_newton_step(problem, before)
        highest = float(np.sum(problem.weights * off**2)) * (1 + _CONVERGED)
        for _ in range(_SHORTENINGS + 1):
            state = before.change(common, turns)
            off = np.abs(problem.residuals(state))
            cost = float(np.sum(problem.weights * off**2))
            if cost <= highest:
                break
            common, turns = common / 2, turns / 2
        moved = np.abs(state.centres - before.centres)
        fall = abs(previous - cost)
        if fall <= _NEARLY * cost and weighings < _WEIGHINGS:
            # each marker that is not pinned is weighted by its inverse variance, scaled to a mean of 1
            left = np.where(seen[:, own], off[:, own], 0)
            square = np.minimum(left, _HUBER * np.sqrt(np.mean(left**2, axis=0))) ** 2
            variance = square.sum(axis=0) / np.maximum(seen[:, own].sum(axis=0), 1)
            weights = problem.weights[:, own].mean(axis=0)
            variance = share_variance(variance, weights, problem.segment[own], state.local[own])
            weight = 1 / np.maximum(variance, _EXACT**2)
            scale[own] = weight / weight.mean()
            cost, weighings = np.inf, weighings + 1
        elif fall <= _CONVERGED * cost + 1e-18:
            return state, problem, iteration
    raise Refused(
        "joint-unsettled",
        f"the centre of joint {np.argmax(moved) + 1} still changes after {_ITERATIONS} iterations of the joint "
        "fit. Either the two segments of this joint hardly rotate relative to each other, or a marker is on the wrong "
        "segment. Check their markers in the report (segments), and set `segment: {count: …}`, list markers that are "
        "`together` or `apart`, or list markers to `ignore`",
        float(moved.max()),
    )


_STILL_SHARE = 0.1  # fraction of the frames that is spread evenly over time
_RESTING = 0.1  # fraction of the largest speed; slower markers are at rest
_WINDOWS = 200  # windows of a trial, over which the speed is measured


def frames_along_motion(points: ComplexArray | FloatArray, count: int, among: IntArray | None = None) -> IntArray:
    """Return at most ``count`` frames, ascending, evenly spaced along the path of the markers.

    Skin has the same error in the same posture. A hundred frames of quiet standing contain as much information as one,
    but would have a hundred times its weight if the frames were evenly spaced in time. Trajectories are complex (F, M)
    in the plane, or (F, M, 3) in space, m, NaN where missing. The frames are chosen from ``among``, by default from
    all.
    """
    among = np.arange(len(points)) if among is None else among
    frames = len(among)
    if frames <= count:
        return among
    speed = _speed(points, among, max(1, frames // _WINDOWS))
    moving = np.maximum(speed - np.quantile(speed, 0.05), 0)  # still markers move by noise only
    total = moving.mean()
    density = _STILL_SHARE + (1 - _STILL_SHARE) * (moving / total if total > 0 else np.ones(frames))
    travelled = np.cumsum(density)
    middles = (np.arange(count) + 0.5) / count * travelled[-1]
    return np.asarray(among[np.unique(np.searchsorted(travelled, middles))])


def frames_over_time(points: ComplexArray, count: int) -> IntArray:
    """Return at most ``count`` frames, evenly spaced in time, or along the motion if the points (F, M) mostly rest."""
    every = np.arange(len(points))
    if len(every) <= count:
        return every
    window = max(1, len(every) // _WINDOWS)
    visible = np.isfinite(points)
    known = (visible[window:] & visible[:-window]).mean(axis=1) > 0.5
    speed = _speed(points, every, window)[window // 2 :][: len(known)][known]
    if known.mean() > 0.5 and np.median(speed) < _RESTING * np.quantile(speed, 0.95):
        return frames_along_motion(points, count)
    return np.unique(np.linspace(0, every[-1], count).round().astype(np.int64))


def _speed(points: ComplexArray | FloatArray, among: IntArray, window: int) -> FloatArray:
    """Return the rms displacement (A,), m, of visible markers over ``window`` frames around the A frames ``among``."""
    rms = np.empty(len(among) - window)
    for here in chunks(len(rms)):
        moved = points[among[window:][here]] - points[among[here]]
        step = np.abs(moved) if moved.ndim == 2 else np.linalg.norm(moved, axis=2)
        seen = np.isfinite(step)
        square = np.where(seen, step, 0) ** 2
        rms[here] = np.sqrt(square.sum(axis=1) / np.maximum(seen.sum(axis=1), 1))
    before = window // 2
    return np.pad(rms, (before, window - before), mode="edge")
