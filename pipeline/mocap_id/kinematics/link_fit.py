"""Fit of a chain with single-marker segments: the segment of each marker, and the joints that are at a marker.

Assignment and chain are fitted alternately. Every marker is assigned to the segment that fits it best. Then the chain
is fitted to the markers with a robust loss (Cauchy's, with a decreasing scale). The iteration ends when no marker
changes its segment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.chain_equations import (
    ChainProblem,
    ChainState,
    apply_step,
    eliminate_angles,
    joint_positions,
    predict_markers,
)
from mocap_id.kinematics.hypotheses import FLOOR, SegmentationProblem
from mocap_id.kinematics.joint import arc
from mocap_id.kinematics.link_markers import Path
from mocap_id.kinematics.rigid_body import count_positions

SEGMENT_PRICE = 4.0
"""Cost of one more segment."""

SCALE = 0.002
"""Scale of the cost, m; smaller residuals cost little."""

_ANNEALED = (4.0, 2.0, 1.0)  # successive scales of the loss, in units of SCALE
_LEFT_OUT = 0.05  # m; a marker on no segment costs as much as one with this residual
_FOREIGN = 4.0  # a marker is on no segment beyond this multiple of the segment's median residual
_FOREIGN_BETWEEN = (0.008, 0.025)  # m; range of this limit
_FRAMES = 150
_ROUNDS = 3
_STEPS = 20
_SETTLED = 1e-4  # relative decrease of the cost
_FRAMES_A_SEGMENT = 15
_SHORTEST = 0.03  # m; a shorter link is not accepted


@dataclass(frozen=True)
class Pin:
    """Markers that represent a joint."""

    joint: int  # number of the joint from 0
    unit: IntArray  # columns of the markers
    track: ComplexArray  # (F,) position of the joint according to these markers, m
    weight: float  # weight of one frame of the joint relative to one frame of a marker


@dataclass(frozen=True)
class LinkFit:
    """Chain fitted to all markers of a trial."""

    cost: float  # sum over markers of the mean log residual, plus ``SEGMENT_PRICE`` for each segment
    segment: IntArray  # (M,) 0 = base, -1 = none
    residual: FloatArray  # (M,) typical residual of each marker on its segment, m
    state: ChainState  # centres, coordinates of the M markers on their segments, angles in the frames ``used``
    used: IntArray  # (T,) frames in which every angle is known
    pins: tuple[Pin, ...] = ()  # joints that markers represent

    @property
    def arcs(self) -> FloatArray:
        """2.5 to 97.5 % ranges (n,) of the joint angles, rad."""
        turns = np.diff(self.state.angles, axis=1, prepend=0.0)
        return np.array([arc(np.exp(1j * turn)) for turn in turns.T])

    def ratios(self, points: ComplexArray) -> tuple[float, ...]:
        """Return, for each joint, the residual of the markers beyond it without the joint, divided by that with it."""
        origin, turn = joint_positions(self.state)
        ratios = []
        for k in range(1, len(self.state.centres) + 1):
            own = points[np.ix_(self.used, np.flatnonzero(self.segment >= k))]
            seen = own if k == 1 else np.conj(turn[:, k - 2 : k - 1]) * (own - origin[:, k - 2 : k - 1])
            fixed = np.sqrt(np.nanmean(np.abs(seen - np.nanmean(seen, axis=0)) ** 2))
            ratios.append(float(fixed / max(np.nanmedian(self.residual[self.segment >= k]), FLOOR)))
        return tuple(ratios)

    @property
    def points(self) -> tuple[int, ...]:
        """Number of distinct points of each moving segment, without points that represent a joint."""
        local, segment = self.state.local, self.segment.copy()
        for pin in self.pins:
            segment[pin.unit] = -1
        return tuple(count_positions(local[segment == k + 1]) for k in range(len(self.state.centres)))

    @property
    def loose(self) -> tuple[int, ...]:
        """Joints (from 0) of segments with a single point and no marker at either joint."""
        count, pinned = len(self.state.centres), {pin.joint for pin in self.pins}
        weak = [k for k, points in enumerate(self.points) if not {k, k + 1} & pinned and points < 2]
        return tuple(sorted({joint for k in weak for joint in (k, k + 1) if 0 < joint < count}))


def log_cost(residual: FloatArray) -> FloatArray:
    """Return the cost of residuals in metres. The cost does not grow beyond a residual of 50 mm."""
    return np.asarray(np.minimum(_log_cost(residual), _log_cost(_LEFT_OUT)))


def path_cost(problem: SegmentationProblem, path: Path) -> float:
    """Return the cost of a path before any fit, in a few frames; inf for too few frames or a too short segment."""
    state, used = _start_chain(path)
    if len(used) < _FRAMES_A_SEGMENT * len(path):
        return np.inf
    few = used[:: max(1, len(used) // 60)]
    state = replace(state, angles=state.angles[few])
    if np.abs(state.centres[1:]).min(initial=np.inf) < _SHORTEST:
        return np.inf
    costs, _ = costs_on_segments(problem.points[few], state)
    each = np.minimum(costs.min(axis=0), _log_cost(_LEFT_OUT))
    return float(each[np.isfinite(problem.base.scatter)].sum()) + SEGMENT_PRICE * len(path)


def fit_path(problem: SegmentationProblem, path: Path, pins: tuple[Pin, ...] = ()) -> LinkFit | None:
    """Fit the chain of a path, with pinned joints, to all markers; None with too few frames or markers."""
    state, used = _start_chain(path)
    if len(used) < _FRAMES_A_SEGMENT * len(path):
        return None
    used = used[np.unique(np.linspace(0, len(used) - 1, _FRAMES).round().astype(np.int64))]
    points, state = problem.points[used], replace(state, angles=state.angles[used])
    costs, local = costs_on_segments(points, state)
    segment: IntArray | None = None
    for _ in range(_ROUNDS):
        assigned = _assign_segments(problem, costs)
        if segment is not None and np.array_equal(assigned, segment):
            break
        segment = assigned
        if (segment > 0).sum() <= len(path):
            return None
        fitted = _fit_bundle(points, segment, replace(state, local=_select_own(local, segment)), pins, used)
        if fitted is None:
            return None
        state = fitted
        costs, local = costs_on_segments(points, state)
    if segment is None or np.abs(state.centres[1:]).min(initial=np.inf) < _SHORTEST:
        return None
    own = costs[np.maximum(segment, 0), np.arange(len(segment))]
    price = _log_cost(_LEFT_OUT)
    each = np.where(segment >= 0, np.minimum(own, price), price)
    total = float(each[np.isfinite(problem.base.scatter)].sum()) + SEGMENT_PRICE * len(path)
    residual = np.where(segment >= 0, _invert_cost(own), np.nan)
    return LinkFit(total, segment, residual, replace(state, local=_select_own(local, segment)), used, pins)


def _start_chain(path: Path) -> tuple[ChainState, IntArray]:
    """Return the initial chain of a path from its joints' tracks, and the frames in which all joints are known."""
    tracks = np.stack([step.joint for step in path], axis=1)
    angles = np.empty(tracks.shape)
    for k, step in enumerate(path):
        angles[:, k] = np.angle(step.body.rotation if step.body is not None else tracks[:, k + 1] - tracks[:, k])
    known = np.isfinite(angles).all(axis=1) & np.isfinite(tracks).all(axis=1)
    centres = np.zeros(len(path), dtype=np.complex128)
    if known.any():
        centres[0] = tracks[known, 0].mean()
        along = np.exp(-1j * angles[known, :-1]) * np.diff(tracks[known], axis=1)
        centres[1:] = along.mean(axis=0)
    return ChainState(centres, np.zeros(0, dtype=np.complex128), angles), np.flatnonzero(known)


def costs_on_segments(points: ComplexArray, state: ChainState) -> tuple[FloatArray, ComplexArray]:
    """Return cost (inf if hardly visible) and coordinates, m, of every marker on every segment, each (n + 1, M)."""
    origin, turn = joint_positions(state)
    counts = np.isfinite(points).sum(axis=0)
    costs = np.full((len(state.centres) + 1, points.shape[1]), np.inf)
    local = np.zeros(costs.shape, dtype=np.complex128)
    seen = np.flatnonzero(counts >= 10)
    for k in range(len(costs)):
        own = points[:, seen] if k == 0 else np.conj(turn[:, k - 1 : k]) * (points[:, seen] - origin[:, k - 1 : k])
        local[k, seen] = np.nanmedian(own.real, axis=0) + 1j * np.nanmedian(own.imag, axis=0)
        costs[k, seen] = np.nanmean(_log_cost(np.abs(own - local[k, seen])), axis=0)
    return costs, local


def _log_cost(residual: FloatArray | float) -> FloatArray:
    return np.asarray(0.5 * np.log1p((np.asarray(residual) / SCALE) ** 2))


def _invert_cost(cost: FloatArray) -> FloatArray:
    """Return the residuals, m, with these costs; the inverse of :func:`_log_cost`."""
    return np.asarray(SCALE * np.sqrt(np.expm1(2 * cost)))


def _assign_segments(problem: SegmentationProblem, costs: FloatArray) -> IntArray:
    """Return the segment (M,) that fits each marker best; -1 if none does."""
    segment = np.argmin(costs, axis=0)
    own = costs[segment, np.arange(costs.shape[1])]
    segment[~np.isfinite(own) | ~np.isfinite(problem.base.scatter)] = -1
    residual = np.where(np.isfinite(own), _invert_cost(np.where(np.isfinite(own), own, 0)), np.inf)
    for k in range(len(costs)):
        members = segment == k
        if members.any():
            limit = np.clip(_FOREIGN * np.median(residual[members]), *_FOREIGN_BETWEEN)
            segment[members & (residual > limit)] = -1
    return np.asarray(segment)


def _select_own(local: ComplexArray, segment: IntArray) -> ComplexArray:
    """Return the coordinates (M,) of every marker on its own segment."""
    return np.asarray(local[np.maximum(segment, 0), np.arange(len(segment))])


def _fit_bundle(
    points: ComplexArray, segment: IntArray, state: ChainState, pins: tuple[Pin, ...], used: IntArray
) -> ChainState | None:
    """Return the chain fitted to its moving markers by Gauss-Newton with Cauchy's loss; None if singular."""
    moving = np.flatnonzero(segment > 0)
    tracks = {pin.joint + 1: pin.track[used] for pin in pins}
    chain = ChainProblem.with_joint_markers(points[:, moving], segment[moving], tracks, len(state.centres))
    seen, weight = chain.weights > 0, np.array([1.0] * len(moving) + [pin.weight for pin in pins])

    def loss(state: ChainState, scale: float) -> tuple[FloatArray, float]:
        """Return the weights of the residuals, and the loss. The weight of a pin is constant."""
        off = np.abs(chain.points - predict_markers(chain, state)) / scale
        weights = np.where(chain.pinned, weight, weight / (1 + off**2))
        each = scale**2 * weight * np.where(chain.pinned, off**2, np.log1p(off**2))
        return np.where(seen, weights, 0.0), float(np.sum(each, where=seen))

    state = replace(state, local=np.concatenate([state.local[moving], np.zeros(len(pins))]))
    for scale in SCALE * np.array(_ANNEALED):
        weights, cost = loss(state, scale)
        for _ in range(_STEPS):
            try:
                common, turns = eliminate_angles(replace(chain, weights=weights), state).step()
            except np.linalg.LinAlgError:
                return None
            for shorter in (1.0, 0.4, 0.16, 0.06, 0.03):
                tried = apply_step(state, (shorter * common, shorter * turns))
                tried_weights, tried_cost = loss(tried, scale)
                if tried_cost < cost:
                    break
            else:
                break
            fall, state, weights, cost = cost - tried_cost, tried, tried_weights, tried_cost
            if fall < _SETTLED * cost:
                break
    return state
