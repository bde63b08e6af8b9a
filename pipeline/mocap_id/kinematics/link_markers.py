"""Chains in which a segment has a single marker, or shares it with a neighbour (conventional marker sets).

Two rigid bodies A and B may be connected by a segment that is not a rigid body of markers. Its marker u then moves on a
circle about a joint a of A, and on another circle about a joint b of B:

- ``link marker``: the distance of a and b is constant. One segment from a to b contains u.
- ``joint marker``: this distance varies. Two segments, from a to u and from u to b, meet at a joint at u.

A left and a right marker at the same position count as one point.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.circle import fit_circles
from mocap_id.kinematics.hypotheses import SegmentationProblem
from mocap_id.kinematics.joint import arc
from mocap_id.kinematics.rigid_body import RigidBody

_ROUND = 0.012  # m; largest rms distance of a link marker from its circle
_NEAREST = 0.06  # m; smallest radius of this circle
_CONSTANT = 0.015  # m; largest rms change of the distance between the joints of one segment
_SHORTEST = 0.05  # m; shortest segment
_AS_STILL = 0.012  # m; largest rms change of the distance from a still marker at the centre
_USUAL = 0.88  # fraction of the frames used for these residuals; the others may contain faults
_FEWEST_FRAMES = 20
_SAME_PLACE = 0.03  # m; a left and a right marker this close in the plane are one point
_OTHER_SIDE = 0.08  # m; least distance across the plane between them
_MIN_SPREAD = 0.03  # m; rms size of a body whose rotation can be measured
_LEVELS = 12


@dataclass(frozen=True)
class Step:
    """One segment of a path, and its joint with the previous segment."""

    joint: ComplexArray  # (F,) track of this joint in the plane, m
    body: RigidBody | None  # rigid body of the segment; None if it has none
    unit: IntArray  # columns of the markers of a segment without a body; empty for a body

    @property
    def markers(self) -> IntArray:
        """Columns of the segment's own markers."""
        return self.unit if self.body is None else self.body.markers


Path = tuple[Step, ...]


def find_linked_paths(problem: SegmentationProblem) -> Iterator[Path]:
    """Yield every path with a single-marker segment, from the base over bodies, link markers and joint markers."""
    yield from _Search(problem).paths()


class _Search:
    """Search over bodies and single points. Each circle of a point about a joint of a body is fitted once."""

    def __init__(self, problem: SegmentationProblem) -> None:
        self.problem = problem
        self.bodies = _find_bodies(problem)
        self.units = list(group_points(problem.points, problem.lateral, _find_loose_markers(problem, self.bodies)))
        self.tracks = [average_track(problem.points, unit) for unit in self.units]
        still = group_points(problem.points, problem.lateral, problem.base.markers)
        self.still = [complex(np.nanmean(average_track(problem.points, unit))) for unit in still]
        self._centres: dict[tuple[int, int], list[complex]] = {}

    def paths(self) -> Iterator[Path]:
        """Yield the paths to all bodies by depth-first search, each marker at most once. Body 0 is the ground."""
        edges = [list(self._find_connections(index)) for index in range(len(self.bodies))]
        longest = self.problem.rules.longest - 1

        def extended(index: int, path: Path, used: frozenset[int]) -> Iterator[Path]:
            for steps, following in edges[index]:
                own = frozenset(int(m) for step in steps for m in step.markers)
                if used & own or len(path) + len(steps) > longest:
                    continue
                longer = (*path, *steps)
                if any(step.body is None for step in longer):
                    yield longer
                yield from extended(following, longer, used | own)

        yield from extended(0, (), frozenset())

    def _find_connections(self, index: int) -> Iterator[tuple[Path, int]]:
        """Yield the connections from a body to others: a joint, or segments without a body of their own."""
        parent, rules = self.bodies[index], self.problem.rules
        none = np.array([], dtype=np.int64)
        for following, child in enumerate(self.bodies[1:], 1):
            if following == index or np.isin(child.markers, parent.markers).any():
                continue
            joint = self.problem.clusters.joint(parent, child)
            if rules.is_joint(joint):
                yield (Step(_track_point(parent, joint.in_parent), child, none),), following
            for unit, (markers, track) in enumerate(zip(self.units, self.tracks, strict=True)):
                for near in self._find_centres(index, unit):
                    for far in self._find_centres(following, unit):
                        first, last = _track_point(parent, near), _track_point(child, far)
                        length, off = _measure_constancy(np.abs(first - last))
                        end = Step(last, child, none)
                        if off > _CONSTANT:
                            yield (Step(first, None, markers), Step(track, None, markers), end), following
                        elif length > _SHORTEST:
                            yield (Step(first, None, markers), end), following

    def _find_centres(self, index: int, unit: int) -> list[complex]:
        """Return the positions on a body, in its frame, about which a point moves on a circle."""
        key = index, unit
        if key not in self._centres:
            self._centres[key] = list(self._search_centres(index, unit))
        return self._centres[key]

    def _search_centres(self, index: int, unit: int) -> Iterator[complex]:
        body, track = self.bodies[index], self.tracks[unit]
        if np.isin(self.units[unit], body.markers).any():
            return
        centre = _fit_circle(body.local(track[:, None])[:, 0], self.problem.rules.min_arc)
        if centre is not None:
            yield centre
        for place in self.still if index == 0 else ():  # the arc of the ankle is too short to determine its centre
            radius, off = _measure_constancy(np.abs(track - place))
            if off <= _AS_STILL and radius >= _NEAREST:
                yield place


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
        if mate is not None and apart[mate] < _SAME_PLACE:
            left.remove(mate)
            yield np.array([one, mate])
        else:
            yield np.array([one])


def average_track(points: ComplexArray, unit: IntArray) -> ComplexArray:
    """Return the mean (F,) of some markers, m; NaN unless all of them are visible."""
    return np.asarray(points[:, unit].mean(axis=1))


def _find_bodies(problem: SegmentationProblem) -> list[RigidBody]:
    """Return the ground, then every body of any level whose rotation can be measured."""
    bodies_by_markers: dict[bytes, RigidBody] = {}
    for level in range(1, min(_LEVELS, max(len(problem.moving) // 2, 1)) + 1):
        bodies = problem.clusters.bodies_at(level)
        merged = problem.clusters.merge(bodies, problem.rules.min_arc, problem.rules.merge_tolerance)
        for body in (*merged, *bodies):
            rigid = body.residual <= problem.rules.max_body_residual
            large = float(np.sqrt(np.mean(np.abs(body.template) ** 2))) > _MIN_SPREAD
            if rigid and large and problem.constraints.allow(body.markers):
                bodies_by_markers[body.markers.tobytes()] = body
    return [problem.ground, *bodies_by_markers.values()]


def _find_loose_markers(problem: SegmentationProblem, bodies: list[RigidBody]) -> IntArray:
    """Return the moving markers that are on no rigid body of three points."""
    on_bodies = [
        body.markers
        for body in bodies[1:]
        if len(list(group_points(problem.points, problem.lateral, body.markers))) > 2
    ]
    return np.setdiff1d(problem.moving, np.concatenate(on_bodies)) if on_bodies else problem.moving


def _track_point(body: RigidBody, place: complex) -> ComplexArray:
    """Return the track (F,) of a point on a body, m."""
    return np.asarray(body.position + body.rotation * place)


def _measure_constancy(distance: FloatArray) -> tuple[float, float]:
    """Return the median of a distance (F,), m, and the rms difference from it without the largest differences.

    With too few frames, the result is (0, inf).
    """
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
        centre = complex(fit_circles(known[:, None]).centre[0])
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
