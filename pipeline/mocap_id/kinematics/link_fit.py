"""Chains of markers on a base: hypotheses of rigid bodies, and fits with single-marker segments.

A hypothesis is a path from the base over real joints between rigid bodies. In a chain with single-marker segments,
assignment and chain are fitted alternately. Every marker is assigned to the segment that fits it best. Then the chain
is fitted to the markers with a robust loss (Cauchy's, with a decreasing scale). The iteration ends when no marker
changes its segment.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.chain_fit import ChainProblem, ChainState, gauss_newton_step, joint_positions
from mocap_id.kinematics.clusters import Base, Constraints, MarkerClusters
from mocap_id.kinematics.joint import PairJoint, RigidBody, arc, count_positions, fit_circles

FLOOR = 3e-4
"""Resolution of camera systems, m; smaller residuals do not reduce a cost."""

_REPORTED = 0.05  # smaller differences in cost are not reported
_MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class SegmentationRules:
    """Limits that define a still marker, a joint and a rigid body."""

    still_limit: float = 0.015  # largest scatter of a base marker, m
    min_arc: float = float(np.radians(6.0))  # smallest arc of a joint, rad
    max_residual: float = 0.05  # largest rms distance between the two bodies' points at a joint, m
    max_body_residual: float = 0.015  # largest rms distance of a body's markers from their positions on it, m
    merge_tolerance: float = 3.0  # largest growth of the residual when bodies that hardly rotate are merged
    split_gain: float = 4.0  # least gain in summed log residual for one more segment
    count: int | None = None  # number of segments with the base, if known
    longest: int = 6  # largest number of segments with the base; the rest of a longer chain is left out as a branch

    def is_joint(self, joint: PairJoint) -> bool:
        """Return whether two bodies rotate far enough about a point that is fixed in both."""
        return joint.residual <= self.max_residual and joint.arc >= self.min_arc


@dataclass(frozen=True)
class SegmentationProblem:
    """Input of every hypothesis: markers, base, rules and constraints."""

    points: ComplexArray  # (F, M) trajectories in the plane, m; NaN where missing
    lateral: FloatArray  # (M,) mean out-of-plane coordinate, m
    base: Base  # still markers
    ground: RigidBody  # base as a rigid body
    moving: IntArray  # columns of the moving markers
    rules: SegmentationRules
    constraints: Constraints
    clusters: MarkerClusters  # rigid bodies of the moving markers


@dataclass(frozen=True)
class Hypothesis:
    """One segmentation of the recording: bodies in order from base to tip, and its cost."""

    chain: tuple[RigidBody, ...]  # moving segments
    joints: tuple[PairJoint, ...]  # joint of each segment with the previous one
    left_out: tuple[RigidBody, ...]  # bodies of the level that are not on the chain
    predicted: FloatArray  # (M,) residual predicted through the joint, m; scatter of markers on no moving segment
    cost: float  # summed log of ``predicted`` + ``split_gain`` for each segment + ``cut``; lower is better
    best_of_level: bool  # whether this is the best chain of its level; only these can be chosen
    cut: float  # increase of the cost when the best chain of the level was shortened to the allowed length

    @property
    def markers(self) -> IntArray:
        """Columns of the markers on the moving segments, sorted."""
        return np.sort(np.concatenate([body.markers for body in self.chain]))

    def explain_cost(self, best: Hypothesis) -> str:
        """Return in words why the best hypothesis was chosen instead; ``chosen`` for the best one itself.

        The terms add up to the difference in cost: markers only on the best chain, markers only on this chain, markers
        on both, the number of segments, and the shortening of the chain. First come the terms that raise the cost.
        """
        if self is best:
            return "chosen"

        def compare(markers: IntArray) -> float:
            """Return the summed log residual of some markers, minus the same sum in the best hypothesis."""
            return float(np.sum(np.log(self.predicted[markers] / best.predicted[markers])))

        def count(number: int, what: str) -> str:
            return f"{number} {what}" if number == 1 else f"{number} {what}s"

        own, other = self.markers, best.markers
        out, extra = np.setdiff1d(other, own), np.setdiff1d(own, other)
        fit = compare(np.intersect1d(own, other))
        terms = {
            f"leaves out {count(len(out), 'marker')} of the chosen segments": compare(out),
            f"includes {count(len(extra), 'marker')} more": compare(extra),
            f"fits {'the other' if len(out) + len(extra) else 'the'} markers {'worse' if fit > 0 else 'better'}": fit,
            "a longer chain was better, and was shortened afterwards": self.cut,
        }
        more = len(self.chain) - len(best.chain)
        price = self.cost - best.cost - sum(terms.values())  # split_gain times the difference in the number of segments
        terms = {f"has {count(abs(more), 'segment')} {'more' if more > 0 else 'fewer'}": price, **terms}
        reported = sorted((each for each in terms.items() if abs(each[1]) >= _REPORTED), key=lambda each: -abs(each[1]))
        against = ", ".join(f"{words} (+{value:.1f})" for words, value in reported if value > 0)
        in_favour = ", ".join(f"{words} ({_MINUS}{-value:.1f})" for words, value in reported if value < 0)
        text = f"costs {sum(terms.values()):.1f} more" + (f": {against}" if against else "")
        return f"{text}; but {in_favour}" if in_favour else text


_APART = 0.2  # m; least distance between two limbs on either side of their parent
_MIDDLE = 0.03  # m; largest distance of their parent from the middle between two limbs
_ASIDE = 0.05  # m; least distance of a limb to one side of its parent
_SAME_PLACE = 0.15  # m; largest distance between the joints of a pair of limbs in the side view
_NEEDED = 1.2  # a segment is needed if the joint residual without it is larger by at least this factor
_DEEPEST = 9  # largest number of segments of a path, with the base
_LEVELS = 12  # largest number of bodies into which the markers are sorted


def find_hypotheses(problem: SegmentationProblem) -> Iterator[Hypothesis]:
    """Yield the best chain of every level, then the best chains of all other lengths, each chain once."""

    def key(bodies: Sequence[RigidBody]) -> tuple[tuple[int, ...], ...]:
        """Return the columns of all bodies' markers, to compare chains."""
        return tuple(tuple(int(marker) for marker in body.markers) for body in bodies)

    known: set[tuple[tuple[int, ...], ...]] = set()
    sorted_before: set[tuple[tuple[int, ...], ...]] = set()
    others: list[Hypothesis] = []
    for level in range(1, min(_LEVELS, len(problem.moving) // 2) + 1):
        # bodies are merged where one fits as well as two; there are none if the constraints forbid one
        bodies = problem.clusters.bodies_at(level)
        allowed = all(problem.constraints.allow(body.markers) for body in bodies)
        bodies = problem.clusters.merge(bodies, problem.rules.min_arc, problem.rules.merge_tolerance) if allowed else []
        if key(bodies) in sorted_before:
            continue
        sorted_before.add(key(bodies))
        paths = _best_chains(problem, bodies)
        if not paths:
            continue
        # the best chain of the level, shortened if too long, then the best chain of every other allowed length
        best = min(paths, key=lambda path: path[0])
        longest, cut = problem.rules.longest - 1, 0.0
        for path in (best, *(path for path in paths if path is not best and len(path[1]) <= longest)):
            chain, joints = path[1][:longest], path[2][:longest]
            on_chain = np.concatenate([link.markers for link in chain])
            left_out = tuple(body for body in bodies if not np.isin(body.markers, on_chain).all())
            predicted, cost = _rate_chain(problem, chain, joints)
            first = path is best
            hypothesis = Hypothesis(chain, joints, left_out, predicted, cost + cut, best_of_level=first, cut=cut)
            if not first:
                others.append(hypothesis)
                continue
            cut = cost - best[0]
            if key(chain) not in known:
                known.add(key(chain))
                yield hypothesis
    for other in others:
        if key(other.chain) not in known:
            known.add(key(other.chain))
            yield other


_Path: TypeAlias = tuple[float, tuple[RigidBody, ...], tuple[PairJoint, ...]]  # cost, segments and joints


def _best_chains(problem: SegmentationProblem, bodies: list[RigidBody]) -> list[_Path]:
    """Return the path with the lowest cost from the base, of all over real joints, for each number of segments."""
    rules, clusters, lateral = problem.rules, problem.clusters, problem.lateral
    links: list[RigidBody] = [problem.ground, *(body for body in bodies if body.residual <= rules.max_body_residual)]
    pairs = [(i, j) for i in range(len(links)) for j in range(1, len(links)) if i != j]
    joints = {(i, j): clusters.joint(links[i], links[j]) for i, j in pairs}
    real = {pair for pair, joint in joints.items() if rules.is_joint(joint)}
    # a serial chain contains no joints to pairs of limbs, one on each side of a body, and no joints from such a pair
    side = np.array([np.nanmean(lateral[body.markers]) for body in links])
    aside = {(i, j): side[j] - side[i] for i, j in real}
    real -= {
        (i, j)
        for i, j in real
        for k in range(len(links))
        if (i, k) in real
        and min(abs(aside[i, j]), abs(aside[i, k])) > _ASIDE
        and aside[i, j] * aside[i, k] < 0
        and abs(joints[i, j].in_parent - joints[i, k].in_parent) < _SAME_PLACE
    }
    real = {(i, j) for i, j in real if i == 0 or not _is_pair_of_limbs(lateral, links[j], links[i])}
    if rules.count is not None:
        # A chain with a given number of segments may end at a body that carries another one, such as a pelvis with a
        # trunk: the two bodies with a joint between them are merged to a tip. Else the markers of the other body would
        # be on no segment, and a model based on the chain would add their mass to the pelvis.
        for i, j in sorted({(min(pair), max(pair)) for pair in real if 0 not in pair}):
            tip = clusters.join(links[i], links[j])
            if tip is None or tip.residual > rules.max_residual:
                continue
            new = len(links)
            joints |= {(k, new): clusters.joint(link, tip) for k, link in enumerate(links)}
            below = {k for k, above in real if above in {i, j}} - {i, j}
            of_tip = {k for k in below if not _is_pair_of_limbs(lateral, tip, links[k])}
            real |= {(k, new) for k in of_tip if rules.is_joint(joints[k, new])}
            links.append(tip)

    def extend(path: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        """Yield every path over real joints that begins with ``path``; only with ``rules.count`` segments if given."""
        if len(path) > 1 and rules.count in (None, len(path)):
            yield path
        if len(path) < (rules.count or _DEEPEST):
            for following in range(1, len(links)):
                if following not in path and (path[-1], following) in real:
                    yield from extend((*path, following))

    best: dict[int, _Path] = {}
    for path in extend((0,)):
        chain = tuple(links[i] for i in path[1:])
        markers = np.concatenate([body.markers for body in chain])
        repeated = len(np.unique(markers)) < len(markers)  # a merged tip may contain a body of the chain
        triples = zip(path, path[1:], path[2:], strict=False)
        needless = any(joints[a, c].residual < _NEEDED * joints[a, b].residual for a, b, c in triples)
        if repeated or needless:
            continue
        path_joints = tuple(joints[pair] for pair in pairwise(path))
        _, cost = _rate_chain(problem, chain, path_joints)
        if len(path) not in best or cost < best[len(path)][0]:
            best[len(path)] = cost, chain, path_joints
    return list(best.values())


def _is_pair_of_limbs(lateral: FloatArray, child: RigidBody, parent: RigidBody) -> bool:
    """Return whether a body consists of two limbs that move alike on both sides of their parent, such as arms.

    Two legs that move alike do not count, because their neighbours (feet, pelvis) also have markers on both sides.
    """
    across = np.sort(lateral[child.markers])
    between = int(np.argmax(np.diff(across)))
    low, high = across[between], across[between + 1]
    from_middle = np.abs(lateral[parent.markers] - (low + high) / 2)
    return bool(high - low > _APART and (from_middle < _MIDDLE).any())


def _rate_chain(
    problem: SegmentationProblem, chain: tuple[RigidBody, ...], joints: tuple[PairJoint, ...]
) -> tuple[FloatArray, float]:
    """Return the residuals (M,) of markers predicted through the chain's joints (else the scatter), m, and the cost."""
    floor = max(problem.base.noise, FLOOR)
    residual = np.maximum(problem.base.scatter, floor)
    for body, joint in zip(chain, joints, strict=True):
        residual[body.markers] = np.sqrt(body.residual**2 + joint.residual**2 + floor**2)
    return residual, float(np.sum(np.log(residual[problem.moving]))) + problem.rules.split_gain * len(chain)


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
class LinkFit:
    """Chain fitted to all markers of a trial."""

    cost: float  # sum over markers of the mean log residual, plus ``SEGMENT_PRICE`` for each segment
    segment: IntArray  # (M,) 0 = base, -1 = none
    residual: FloatArray  # (M,) typical residual of each marker on its segment, m
    state: ChainState  # centres, coordinates of the M markers on their segments, angles in the frames ``used``
    used: IntArray  # (T,) frames in which every angle is known
    pins: dict[int, IntArray]  # columns of the markers that represent a joint, by the number of the joint from 0

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
        for unit in self.pins.values():
            segment[unit] = -1
        return tuple(count_positions(local[segment == k + 1]) for k in range(len(self.state.centres)))

    @property
    def loose(self) -> tuple[int, ...]:
        """Joints (from 0) of segments with a single point and no marker at either joint."""
        count = len(self.state.centres)
        weak = [k for k, points in enumerate(self.points) if not {k, k + 1} & self.pins.keys() and points < 2]
        return tuple(sorted({joint for k in weak for joint in (k, k + 1) if 0 < joint < count}))


def log_cost(residual: FloatArray) -> FloatArray:
    """Return the cost of residuals in metres. The cost does not grow beyond a residual of 50 mm."""
    return np.asarray(np.minimum(_log_cost(residual), _log_cost(_LEFT_OUT)))


def path_cost(problem: SegmentationProblem, path: Path) -> float:
    """Return the cost of a path before any fit, in a few frames; inf for too few frames or a too short segment."""
    state, used = _start_chain(path)
    short = np.abs(state.centres[1:]).min(initial=np.inf) < _SHORTEST
    if len(used) < _FRAMES_A_SEGMENT * len(path) or short:
        return np.inf
    few = used[:: max(1, len(used) // 60)]
    state = replace(state, angles=state.angles[few])
    costs, _ = costs_on_segments(problem.points[few], state)
    each = np.minimum(costs.min(axis=0), _log_cost(_LEFT_OUT))
    return float(each[np.isfinite(problem.base.scatter)].sum()) + SEGMENT_PRICE * len(path)


def fit_path(problem: SegmentationProblem, path: Path, pins: dict[int, IntArray]) -> LinkFit | None:
    """Fit the chain of a path, with pinned joints, to all markers; None with too few frames or markers."""
    state, used = _start_chain(path)
    if len(used) < _FRAMES_A_SEGMENT * len(path):
        return None
    used = used[np.unique(np.linspace(0, len(used) - 1, _FRAMES).round().astype(np.int64))]
    points, state = problem.points[used], replace(state, angles=state.angles[used])
    costs, local = costs_on_segments(points, state)
    known, every = np.isfinite(problem.base.scatter), np.arange(points.shape[1])
    segment: IntArray | None = None
    tracks = {joint + 1: points[:, unit].mean(axis=1) for joint, unit in pins.items()}
    off_axis = (SCALE / _OFF_AXIS) ** 2  # weight of a frame of a joint relative to a frame of a marker
    weights = [off_axis * (min(_INNER_FRAMES / len(used), 1.0) if joint else 1.0) for joint in pins]
    for _ in range(_ROUNDS):
        # every marker is assigned to the segment that fits it best, or to none if it is foreign there
        assigned = np.argmin(costs, axis=0)
        own = costs[assigned, every]
        assigned[~np.isfinite(own) | ~known] = -1
        residual = np.where(np.isfinite(own), _invert_cost(np.where(np.isfinite(own), own, 0)), np.inf)
        for k in range(len(costs)):
            members = assigned == k
            if members.any():
                limit = np.clip(_FOREIGN * np.median(residual[members]), *_FOREIGN_BETWEEN)
                assigned[members & (residual > limit)] = -1
        if segment is not None and np.array_equal(assigned, segment):
            break
        segment = assigned
        if (segment > 0).sum() <= len(path):
            return None
        start = replace(state, local=local[np.maximum(segment, 0), every])
        fitted = _fit_robustly(points, segment, start, tracks, weights)
        if fitted is None:
            return None
        state = fitted
        costs, local = costs_on_segments(points, state)
    if segment is None or np.abs(state.centres[1:]).min(initial=np.inf) < _SHORTEST:
        return None
    own, price = costs[np.maximum(segment, 0), every], _log_cost(_LEFT_OUT)
    each = np.where(segment >= 0, np.minimum(own, price), price)
    total = float(each[known].sum()) + SEGMENT_PRICE * len(path)
    residual = np.where(segment >= 0, _invert_cost(own), np.nan)
    return LinkFit(total, segment, residual, replace(state, local=local[np.maximum(segment, 0), every]), used, pins)


def _start_chain(path: Path) -> tuple[ChainState, IntArray]:
    """Return the initial chain of a path from its joints' tracks, and the frames in which all joints are known."""
    tracks = np.stack([joint for joint, _, _ in path], axis=1)
    angles = np.empty(tracks.shape)
    for k, (_, body, _) in enumerate(path):
        angles[:, k] = np.angle(body.rotation if body is not None else tracks[:, k + 1] - tracks[:, k])
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


def _fit_robustly(
    points: ComplexArray,
    segment: IntArray,
    state: ChainState,
    tracks: dict[int, ComplexArray],
    pin_weights: list[float],
) -> ChainState | None:
    """Return the chain fitted to its moving markers by Gauss-Newton with Cauchy's loss; None if singular.

    ``tracks`` (T,) are positions of joints 1 … n according to their markers, m, and ``pin_weights`` the weight of a
    frame of each, relative to a frame of another marker.
    """
    moving = np.flatnonzero(segment > 0)
    chain = ChainProblem.with_joint_markers(points[:, moving], segment[moving], tracks, len(state.centres))
    seen, weight = chain.weights > 0, np.array([1.0] * len(moving) + pin_weights)

    def loss(state: ChainState, scale: float) -> tuple[FloatArray, float]:
        """Return the weights of the residuals, and the loss. The weight of a pin is constant."""
        off = np.abs(chain.residuals(state)) / scale
        weights = np.where(chain.pinned, weight, weight / (1 + off**2))
        each = scale**2 * weight * np.where(chain.pinned, off**2, np.log1p(off**2))
        return np.where(seen, weights, 0.0), float(np.sum(each, where=seen))

    state = replace(state, local=np.concatenate([state.local[moving], np.zeros(len(tracks))]))
    for scale in SCALE * np.array(_ANNEALED):
        weights, cost = loss(state, scale)
        for _ in range(_STEPS):
            try:
                common, turns = gauss_newton_step(replace(chain, weights=weights), state)
            except np.linalg.LinAlgError:
                return None
            for shorter in (1.0, 0.4, 0.16, 0.06, 0.03):
                tried = state.change(shorter * common, shorter * turns)
                tried_weights, tried_cost = loss(tried, scale)
                if tried_cost < cost:
                    break
            else:
                break
            fall, state, weights, cost = cost - tried_cost, tried, tried_weights, tried_cost
            if fall < _SETTLED * cost:
                break
    return state


_ROUND = 0.012  # m; largest rms distance of a link marker from its circle
_NEAREST = 0.06  # m; smallest radius of this circle
_CONSTANT = 0.015  # m; largest rms change of the distance between the joints of one segment
_SHORTEST_LINK = 0.05  # m; shortest segment between two bodies
_AS_STILL = 0.012  # m; largest rms change of the distance from a still marker at the centre
_USUAL = 0.88  # fraction of the frames used for these residuals; the others may contain faults
_FEWEST_FRAMES = 20
_ONE_POINT = 0.03  # m; a left and a right marker this close in the plane are one point
_OTHER_SIDE = 0.08  # m; least distance across the plane between them
_MIN_SPREAD = 0.03  # m; rms size of a body whose rotation can be measured


PathSegment: TypeAlias = tuple[ComplexArray, RigidBody | None, IntArray]
"""Track (F,) of the joint with the previous segment in the plane, m; rigid body, None for a segment without one; and
columns of the segment's own markers."""

Path: TypeAlias = tuple[PathSegment, ...]


def find_linked_paths(problem: SegmentationProblem) -> Iterator[Path]:
    """Yield every path with a single-marker segment, from the base over bodies, link markers and joint markers.

    This is a depth-first search, in which each marker occurs at most once. Body 0 is the ground. Each circle of a
    point about a joint of a body is fitted once.
    """
    points, lateral, rules = problem.points, problem.lateral, problem.rules

    # every body of any level whose rotation can be measured, and the points on no rigid body of three points
    bodies_by_markers: dict[bytes, RigidBody] = {}
    for level in range(1, min(_LEVELS, max(len(problem.moving) // 2, 1)) + 1):
        found = problem.clusters.bodies_at(level)
        merged = problem.clusters.merge(found, rules.min_arc, rules.merge_tolerance)
        for body in (*merged, *found):
            large = float(np.sqrt(np.mean(np.abs(body.template) ** 2))) > _MIN_SPREAD
            if body.residual <= rules.max_body_residual and large and problem.constraints.allow(body.markers):
                bodies_by_markers[body.markers.tobytes()] = body
    bodies = [problem.ground, *bodies_by_markers.values()]
    on_bodies = [body.markers for body in bodies[1:] if len(list(group_points(points, lateral, body.markers))) > 2]
    loose = np.setdiff1d(problem.moving, np.concatenate(on_bodies)) if on_bodies else problem.moving
    units = list(group_points(points, lateral, loose))
    tracks = [points[:, unit].mean(axis=1) for unit in units]
    still = group_points(points, lateral, problem.base.markers)
    rests = [complex(np.nanmean(points[:, unit].mean(axis=1))) for unit in still]

    @cache
    def find_centres(index: int, unit: int) -> list[complex]:
        """Return the positions on a body, in its frame, about which a point moves on a circle."""
        body, track, centres = bodies[index], tracks[unit], list[complex]()
        if np.isin(units[unit], body.markers).any():
            return centres
        centre = _fit_circle(body.local(track[:, None])[:, 0], rules.min_arc)
        if centre is not None:
            centres.append(centre)
        for rest in rests if index == 0 else ():  # the arc of the ankle is too short to determine its centre
            radius, off = _measure_constancy(np.abs(track - rest))
            if off <= _AS_STILL and radius >= _NEAREST:
                centres.append(rest)
        return centres

    def connect(index: int) -> Iterator[tuple[Path, int]]:
        """Yield the connections from a body to others: a joint, or segments without a body of their own."""
        parent = bodies[index]
        for following, child in enumerate(bodies[1:], 1):
            if following == index or np.isin(child.markers, parent.markers).any():
                continue
            joint = problem.clusters.joint(parent, child)
            if rules.is_joint(joint):
                yield ((parent.position + parent.rotation * joint.in_parent, child, child.markers),), following
            for unit, (markers, track) in enumerate(zip(units, tracks, strict=True)):
                for near in find_centres(index, unit):
                    for far in find_centres(following, unit):
                        first = parent.position + parent.rotation * near
                        last = child.position + child.rotation * far
                        length, off = _measure_constancy(np.abs(first - last))
                        link: PathSegment = (first, None, markers)
                        end: PathSegment = (last, child, child.markers)
                        if off > _CONSTANT:
                            yield (link, (track, None, markers), end), following
                        elif length > _SHORTEST_LINK:
                            yield (link, end), following

    connections = [list(connect(index)) for index in range(len(bodies))]

    def extend(index: int, path: Path, used: frozenset[int]) -> Iterator[Path]:
        for parts, following in connections[index]:
            own = frozenset(int(m) for _, _, markers in parts for m in markers)
            if used & own or len(path) + len(parts) > rules.longest - 1:
                continue
            longer = (*path, *parts)
            if any(body is None for _, body, _ in longer):
                yield longer
            yield from extend(following, longer, used | own)

    yield from extend(0, (), frozenset())


def group_points(points: ComplexArray, lateral: FloatArray, markers: IntArray) -> Iterator[IntArray]:
    """Yield the columns of single markers, and of pairs: a left and a right marker at the same position in the plane.

    ``points`` (F, M) are trajectories in the plane, and ``lateral`` (M,) mean out-of-plane coordinates, m.
    """
    left = [int(marker) for marker in markers]
    while left:
        one = left.pop(0)
        apart = {
            other: float(np.nanmedian(np.abs(points[:, one] - points[:, other])))
            for other in left
            if abs(lateral[one] - lateral[other]) > _OTHER_SIDE
            and (np.isfinite(points[:, one]) & np.isfinite(points[:, other])).any()
        }
        mate = min(apart, key=apart.__getitem__, default=None)
        if mate is not None and apart[mate] < _ONE_POINT:
            left.remove(mate)
            yield np.array([one, mate])
        else:
            yield np.array([one])


def _measure_constancy(distance: FloatArray) -> tuple[float, float]:
    """Return the median of a distance (F,), and the rms difference without the largest, m; (0, inf) if hardly known."""
    known = distance[np.isfinite(distance)]
    if len(known) < _FEWEST_FRAMES:
        return 0.0, np.inf
    middle = float(np.median(known))
    off = np.sort((known - middle) ** 2)
    return middle, float(np.sqrt(np.mean(off[: int(_USUAL * len(off))])))


def _fit_circle(track: ComplexArray, least_arc: float) -> complex | None:
    """Return the centre of a point's track; None if this is not a circle with an arc of at least ``least_arc``, rad."""
    known = track[np.isfinite(track)]
    for _ in range(2):  # the second fit is without faults
        if len(known) < _FEWEST_FRAMES:
            return None
        centre = complex(fit_circles(known[:, None])[0])
        if not np.isfinite(centre):
            return None
        distance = np.abs(known - centre)
        radius, off = _measure_constancy(distance)
        if off > _ROUND or radius < _NEAREST or arc(np.exp(1j * np.angle(known - centre))) < least_arc:
            off_enough = np.abs(distance - radius)
            known = known[off_enough <= np.quantile(off_enough, _USUAL)]
            continue
        return centre
    return None


_MOST_POINTS = 24  # most moving points of a conventional marker set; larger sets have rigid bodies
_TRIED = 4  # number of fitted paths for every number of segments
_OFF_AXIS = 0.012  # m; standard deviation of the distance of a marker from its joint
_MORE_THAN_STILL = 1.12  # least ratio of the scatters of an ankle marker and of the stillest markers; heels are stiller
_RISE = 2.0  # largest rise of the cost for an ankle at a marker
_INNER_RISE = 4.0  # the same for an inner joint
_NEAR = 0.04  # m; a marker this close to an inner joint may represent it
_INNER_FRAMES = 30.0  # weight of this marker in frames, because its error is the same in all of them


def find_best_links(problem: SegmentationProblem) -> LinkFit | None:
    """Return the chain with the lowest cost that has a single-marker segment; None if no chain is possible."""
    points = problem.points
    if len(list(group_points(points, problem.lateral, problem.moving))) > _MOST_POINTS:
        return None
    paths = list(find_linked_paths(problem))
    costs = [path_cost(problem, path) for path in paths]
    fits: list[tuple[LinkFit, Path]] = []
    tried: Counter[int] = Counter()
    for index in np.argsort(costs):
        path = paths[index]
        if (
            not np.isfinite(costs[index])
            or tried[len(path)] >= _TRIED
            or problem.rules.count not in (None, len(path) + 1)
        ):
            continue
        tried[len(path)] += 1
        fit = fit_path(problem, path, {})
        if fit is None:
            continue
        members = [np.flatnonzero(fit.segment == k) for k in range(fit.segment.max() + 1)]
        if all(map(problem.constraints.allow, members)):
            fits.append((fit, path))
    if not fits:
        return None
    fit, path = min(fits, key=lambda each: each[0].cost)

    # markers represent the ankle and the inner joints, where this hardly raises the cost
    units = list(group_points(points, problem.lateral, problem.base.markers))
    moves = [float(np.mean(problem.base.scatter[unit])) for unit in units]
    best: LinkFit | None = None
    for unit, scatter in zip(units, moves, strict=True):
        if scatter < _MORE_THAN_STILL * min(moves):
            continue
        pinned = fit_path(problem, path, {0: unit})
        if pinned is not None and pinned.cost - fit.cost < _RISE and (best is None or pinned.cost < best.cost):
            best = pinned
    fit = best or fit
    for joint in range(1, len(path)):
        # the nearest marker that fits at this inner joint
        moving = np.flatnonzero((fit.segment == joint) | (fit.segment == joint + 1))
        place, _ = joint_positions(fit.state)
        near = []
        for unit in group_points(points, problem.lateral, moving):
            off = np.abs(points[:, unit].mean(axis=1)[fit.used] - place[:, joint])
            if np.isfinite(off).any() and np.nanmedian(off) < _NEAR:
                near.append((float(np.nanmedian(off)), unit))
        for _, unit in sorted(near, key=lambda each: each[0]):
            pinned = fit_path(problem, path, {**fit.pins, joint: unit})
            if pinned is not None and pinned.cost - fit.cost < _INNER_RISE:
                fit = pinned
                break
    # the still markers at the ankle are on segment 1
    ankle = fit.pins.get(0, np.zeros(0, dtype=np.int64))
    segment, local = fit.segment.copy(), fit.state.local.copy()
    segment[ankle] = 1
    local[ankle] = costs_on_segments(points[fit.used], fit.state)[1][1, ankle]
    fit = replace(fit, segment=segment, state=replace(fit.state, local=local))
    alone = [distinct for (_, body, _), distinct in zip(path, fit.points, strict=True) if body is None]
    return fit if min(alone) < 2 else None  # other chains are found by the search for rigid bodies
