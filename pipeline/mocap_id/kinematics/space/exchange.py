"""Exchange of markers between neighbouring bodies, where their residuals become smaller.

A division may separate sliding skin from its segment, and join a segment that hardly moves, such as the hand, to its
neighbour. This division fits the markers well, but not best, because a marker on the wrong body moves relative to this
body when the joint rotates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics.space.bodies import LEAST, NARROW, SpatialBodies, SpatialBody, fit_pair_joint, subtract_means
from mocap_id.kinematics.space.division import build_partition, spanning_tree
from mocap_id.kinematics.space.unexplained_motion import unexplained_residuals

_MARGIN = 0.3  # least gain in summed log residual
_FLOOR, _OWN_FLOOR = 1e-3, 0.5e-3  # m; smaller residuals (of all motion, of unexplained motion) have equal costs
_UNKNOWN = 10.0  # m; residual on a body whose markers are on one line
_FAR = 4.0  # largest ratio of residuals on the other body and on its own for a marker that may be exchanged
_CLOSE = 0.012  # m; a marker with a smaller residual on the other body may also be exchanged
_NEAR_JOINT = 0.06  # m; distance from the joint within which a marker fits both bodies
_LANDMARK = 3.0  # penalty for reassigning a single marker near the joint
_SMALL = 0.02  # m; relative motion of two bodies below which their markers are divided again
_HOPELESS = 2.0  # largest increase of the plain cost for which the cost of the unexplained motion is computed
_ROUNDS = 3

_Pair: TypeAlias = tuple[SpatialBody, SpatialBody]


def exchange_markers(sorter: SpatialBodies, bodies: Sequence[SpatialBody]) -> tuple[SpatialBody, ...]:
    """Return the bodies of a division after neighbours have exchanged one or two markers at a time."""
    exchange = _Exchange(sorter, bodies)
    for _ in range(_ROUNDS):
        improved = [exchange.improve(i, j) for i, j in exchange.edges]
        if not any(improved):
            break
    return tuple(exchange.bodies)


class _Exchange:
    """Bodies, the tree of their joints, and cached costs."""

    def __init__(self, sorter: SpatialBodies, bodies: Sequence[SpatialBody]) -> None:
        self.sorter, self.bodies = sorter, list(bodies)
        self.edges = spanning_tree(build_partition(bodies).joints, len(bodies))
        self._costs: dict[bytes, float] = {}

    def improve(self, i: int, j: int) -> bool:
        """Exchange markers of two neighbours while this reduces the cost; return whether the bodies have changed."""
        before = self.bodies[i]
        new = fit_pair_joint(self.bodies[i], self.bodies[j]).free < _SMALL
        for _ in range(_ROUNDS):
            pair: _Pair = self.bodies[i], self.bodies[j]
            plain, own = _plain_cost(*pair), self._own_cost(*pair, i, j)
            best, chosen = plain + own - _MARGIN, pair
            choices: list[tuple[_Pair, float]] = [
                *self._propose_exchanges(*pair),
                *(self._propose_divisions(*pair) if new else ()),
            ]
            for choice, doubt in choices:
                rigid = _plain_cost(*choice) + doubt
                if rigid > plain + _HOPELESS:
                    continue
                cost = rigid + self._own_cost(*choice, i, j)
                if cost < best:
                    best, chosen = cost, choice
            if chosen is pair:
                break
            self.bodies[i], self.bodies[j] = chosen
            new = False
        return self.bodies[i] is not before

    def _own_cost(self, first: SpatialBody, second: SpatialBody, i: int, j: int) -> float:
        """Return the summed log residual of two bodies, without the motion that their neighbours explain."""
        at = {i: first, j: second}
        total = 0.0
        for k, body in at.items():
            others = [b if a == k else a for a, b in self.edges if k in (a, b)]
            around = [at.get(other, self.bodies[other]) for other in others]
            key = b"|".join(each.markers.tobytes() for each in (body, *around))
            if key not in self._costs:
                left = unexplained_residuals(self.sorter.points, body, around)
                self._costs[key] = float(np.sum(np.log(left**2 + _OWN_FLOOR**2))) / 2
            total += self._costs[key]
        return total

    def _propose_exchanges(self, first: SpatialBody, second: SpatialBody) -> Iterator[tuple[_Pair, float]]:
        """Yield both bodies after one marker, or one of each, has changed its body, and the penalty for this."""
        joint = fit_pair_joint(first, second)
        leaving, joining = self._find_movable(first, second), self._find_movable(second, first)
        doubts = self._penalise(first, leaving, joint.in_first), self._penalise(second, joining, joint.in_second)
        moves: list[tuple[list[int], list[int], float]]
        moves = [([m], [], doubt) for m, doubt in zip(leaving, doubts[0], strict=True)]
        moves += [([], [m], doubt) for m, doubt in zip(joining, doubts[1], strict=True)]
        moves += [([m], [k], 0.0) for m in leaving for k in joining]
        for out, back, doubt in moves:
            markers = [
                np.sort(np.append(np.setdiff1d(body.markers, gone), come).astype(np.int64))
                for body, gone, come in ((first, out, back), (second, back, out))
            ]
            if self._is_possible(*markers):
                made = self.sorter.body(markers[0]), self.sorter.body(markers[1])
                if min(body.width for body in made) >= NARROW:
                    yield made, doubt

    def _propose_divisions(self, first: SpatialBody, second: SpatialBody) -> Iterator[tuple[_Pair, float]]:
        """Yield other divisions of the markers of both bodies, in both orders."""
        for one, other in self.sorter.divisions(np.sort(np.concatenate([first.markers, second.markers]))):
            if self._is_possible(one.markers, other.markers):
                yield (one, other), 0.0
                yield (other, one), 0.0

    def _find_movable(self, body: SpatialBody, other: SpatialBody) -> list[int]:
        """Return the markers of a body that also fit the other body roughly."""
        own = body.residual[body.markers]
        close = other.residual[body.markers] <= np.maximum(_FAR * own, _CLOSE)
        return [int(m) for m in body.markers[close]]

    def _penalise(self, body: SpatialBody, markers: list[int], centre: FloatArray) -> list[float]:
        """Return the penalties for removing single markers from a body: 0 except near the joint ``centre`` (3,), m."""
        if not markers:
            return []
        _, place, _ = subtract_means(body.local(self.sorter.points[:, markers]))
        near = np.linalg.norm(place - centre, axis=1) <= _NEAR_JOINT
        return [_LANDMARK if each else 0.0 for each in near]

    def _is_possible(self, first: IntArray, second: IntArray) -> bool:
        """Return whether both groups are large enough for a body and satisfy the constraints of the user."""
        constraints = self.sorter.constraints
        apart = np.isin(constraints.unit[first], constraints.unit[second]).any()
        return not apart and min(len(first), len(second)) >= LEAST and all(map(constraints.allow, (first, second)))


def _plain_cost(first: SpatialBody, second: SpatialBody) -> float:
    """Return the summed log residual of two bodies."""
    residual = np.concatenate([body.residual[body.markers] for body in (first, second)])
    return float(np.sum(np.log(np.minimum(residual, _UNKNOWN) ** 2 + _FLOOR**2))) / 2
