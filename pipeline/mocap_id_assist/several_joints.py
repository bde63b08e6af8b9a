"""Springs that maximise the functional workspace of several joints (eq. 7.6, 7.10, 7.11), and sub-workspaces.

The workspace is measured in cells of the plane: a cell counts if a sampled posture in it can be held with torques
within the person's limits. The search is a best-first branch and bound over boxes of stiffnesses and rest angles. For a
box, the torques of each posture are within intervals, which are exact at the corners of the box. They give an upper
bound of the cells for all springs of the box. The middle of a box gives a lower bound; if it is the best so far, a
pattern search improves it. The search ends if no box can improve the result by more than the tolerance, or after a
number of boxes. The gap is an upper bound of the possible improvement for these postures.

A sub-workspace (thesis 9.6) is the set of postures held with one setting of the springs. Sub-workspaces are the nodes
of a graph, and their overlaps are its edges. In an overlap, a device can change its setting while the person holds the
posture, because the person's torque is sufficient with both settings.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, sobol
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id_assist.holding_kernels import count_cells
from mocap_id_assist.one_joint import PENALTY, OneJoint
from mocap_id_assist.workspace import JointLimits, PlanarArm


@dataclass(frozen=True)
class ChainMasses:
    """Masses of a planar chain; ValueError is raised if a mass is not finite, or if all masses are zero."""

    centres: FloatArray  # (n, 2) centre of each joint in the frame of the previous segment, m
    # (n, 3) m, mx, my of each moving segment in its own frame, kg and kg·m. Identified parameters are sufficient:
    # only the combinations that they determine affect the torques.
    masses: FloatArray
    gravity: float = 9.81  # m/s², along -y

    def __post_init__(self) -> None:
        if not np.isfinite(self.masses).all():
            raise ValueError("a mass is not finite; expected finite masses and first moments of all segments")
        if not self.masses.any():
            raise ValueError("all masses are zero; expected at least one segment with a mass")

    def torques(self, q: FloatArray) -> FloatArray:
        """Return the joint torques (..., n), N·m, that hold postures (..., n), rad, against gravity.

        A torque is the moment g Σ (m (x - x_joint) + mx cos α - my sin α) of the segments distal to the joint, whose
        angles are α.
        """
        angle, origin = segment_poses(q, self.centres)
        lever = rotate(angle[..., 1:], self.masses[:, 1:])[..., 0]  # (..., n)
        mass = self.masses[:, 0]
        x = origin[..., 1:, 0]
        moment = np.cumsum((mass * x + lever)[..., ::-1], axis=-1)[..., ::-1]
        beyond = np.cumsum(mass[::-1])[::-1]
        return np.asarray(self.gravity * (moment - beyond * x))

    def one_joint(
        self, joint: int, posture: FloatArray, limits: tuple[float, float], torque: tuple[float, float]
    ) -> OneJoint:
        """Return the model of one joint, counted from 0, while the other joints are fixed at ``posture`` (n,), rad.

        ValueError is raised as for :class:`OneJoint`.
        """
        postures = np.tile(posture, (2, 1)).astype(np.float64)
        postures[:, joint] = 0.0, np.pi / 2
        cosine, sine = self.torques(postures)[:, joint].tolist()
        return OneJoint(sine, cosine, *limits, *torque)


_CELLS = 8  # average number of postures per cell, so that few cells contain no posture
_REACHED = 1e-4  # m: largest distance of the tip from a reached point


@dataclass(frozen=True)
class SpringPlace:
    """A possible linear spring, which pulls the sum of its joints' angles towards its rest angle."""

    joints: tuple[int, ...]  # one joint, or two joints that the spring spans, counted from 0
    stiffest: float  # largest stiffness, N·m/rad
    rest: tuple[float, float] = (-2 * np.pi, 2 * np.pi)  # smallest and largest rest angle of the sum, rad


@dataclass(frozen=True)
class Postures:
    """N sampled postures that represent a functional workspace."""

    gravity: FloatArray  # (N, n) torque that holds each joint without a spring, N·m
    stretch: FloatArray  # (N, S) sum of the angles of each spring's joints, rad
    cell: IntArray  # (N,) cell of the plane that contains the tip; each required point has its own cell
    cells: int  # number C of cells of the workspace
    required: int  # number R of required points; their cells are C … C + R - 1
    size: float  # area of a cell, m²
    q: FloatArray  # (N, n) rad
    tips: FloatArray  # (N, 2) m


def sample_postures(  # noqa: PLR0917
    arm: PlanarArm,
    weights: ChainMasses,
    limits: JointLimits,
    places: Sequence[SpringPlace],
    required: FloatArray,
    count: int = 4096,
    seed: int = 0,
) -> Postures:
    """Sample postures evenly within the joint limits, and find further postures that reach each required point.

    ``required`` (R, 2) are points in the plane frame at which the tip must be held, m. ``count`` and ``seed`` determine
    the samples.

    ValueError is raised if a required point cannot be reached.
    """
    q = limits.lower + sobol(count, limits.dimension, seed) * (limits.upper - limits.lower)
    tips = arm.tips(q)
    low, high = tips.min(axis=0), tips.max(axis=0)
    side = float(np.sqrt(np.prod(high - low) / (count / _CELLS)))
    index = np.floor((tips - low) / side).astype(np.int64)
    _, cell = np.unique(index @ np.array([1 << 20, 1]), return_inverse=True)
    cells = int(cell.max()) + 1
    parts, owners = [q], [cell.astype(np.int64)]
    for k, point in enumerate(required):
        postures = _find_postures(arm, limits, point, q[np.argsort(np.linalg.norm(tips - point, axis=1))[:48]])
        if not len(postures):
            raise ValueError(f"the required point ({point[0]:g}, {point[1]:g}) m cannot be reached")
        parts.append(postures)
        owners.append(np.full(len(postures), cells + k, dtype=np.int64))
    q = np.concatenate(parts)
    stretch = np.zeros((len(q), len(places)))
    for s, place in enumerate(places):
        stretch[:, s] = q[:, list(place.joints)].sum(axis=1)
    return Postures(weights.torques(q), stretch, np.concatenate(owners), cells, len(required), side**2, q, arm.tips(q))


def _find_postures(arm: PlanarArm, limits: JointLimits, point: FloatArray, starts: FloatArray) -> FloatArray:
    """Return postures (K, n) within the limits that reach the point, by Gauss–Newton steps from each start."""
    q = starts.copy()
    step, n = 1e-6, limits.dimension
    for _ in range(40):
        off = point - arm.tips(q)
        columns = [
            (arm.tips(q + step * np.eye(n)[j]) - arm.tips(q - step * np.eye(n)[j])) / (2 * step) for j in range(n)
        ]
        jacobian = np.stack(columns, axis=-1)  # (K, 2, n)
        normal = jacobian @ np.swapaxes(jacobian, -1, -2) + 1e-10 * np.eye(2)
        move = np.swapaxes(jacobian, -1, -2) @ np.linalg.solve(normal, off[..., None])
        q = np.clip(q + move[..., 0], limits.lower, limits.upper)
    reached = q[np.linalg.norm(arm.tips(q) - point, axis=1) < _REACHED]
    distinct = np.unique(np.round(reached, 6), axis=0, return_index=True)[1]
    return np.asarray(reached[np.sort(distinct)])


BOXES = 20_000
"""Number of boxes after which the search ends."""


_TOLERANCE = 0.005  # fraction of the cells
_HELPS = 0.01  # least gain for which springs are prescribed, as a fraction of the cells
_SLACK = 1e-3  # fraction of the largest allowed stiffness: a softer spring counts as no spring


@dataclass(frozen=True)
class Springs:
    """The best of the S possible springs that the search found; a box is a range of stiffnesses and rest angles."""

    stiffness: FloatArray  # (S,) N·m/rad
    rest: FloatArray  # (S,) rad; NaN for an unused spring
    area: float  # area of the functional workspace with the springs, m²
    without: float  # area without springs, m²
    reachable: float  # area that the joint limits allow, m²
    gap: float  # upper bound of the further gain in area by any other springs, m²
    boxes: int  # number of evaluated boxes
    helps: bool  # whether the springs give a relevant gain


class _Search:
    """Numbers of cells and their bounds for springs (S, 2), given by stiffness and rest angle."""

    def __init__(self, postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, penalty: float) -> None:
        joints = postures.gravity.shape[1]
        self.postures, self.torque, self.penalty = postures, torque, penalty
        across = [[j in place.joints for j in range(joints)] for place in places]
        self.across: BoolArray = np.array(across, dtype=np.bool_).reshape(-1, joints)
        self.low = np.array([[0.0, place.rest[0]] for place in places]).reshape(-1, 2)
        self.high = np.array([[place.stiffest, place.rest[1]] for place in places]).reshape(-1, 2)
        self.boxes = 0

    def count_cells(self, low: FloatArray, high: FloatArray) -> int:
        """Return an upper bound of the cells for the springs of a box; -1 if a required point cannot be held."""
        p = self.postures
        return count_cells(p.gravity, p.stretch, p.cell, p.cells, p.required, self.across, self.torque, low, high)

    def penalise(self, springs: FloatArray) -> float:
        """Return the penalty for the stiffnesses of springs (S, 2), as a number of cells."""
        return float(self.penalty * self.postures.cells * np.sum(springs[:, 0] / self.high[:, 0]))

    def objective(self, springs: FloatArray) -> float:
        """Return the number of held cells minus the penalty of the springs; -inf if a required point is not held."""
        count = self.count_cells(springs, springs)
        return -np.inf if count < 0 else count - self.penalise(springs)

    def bound_objective(self, low: FloatArray, high: FloatArray) -> float:
        """Return an upper bound of the objective of all springs in a box."""
        self.boxes += 1
        count = self.count_cells(low, high)
        return -np.inf if count < 0 else count - self.penalise(low)

    def split(self, low: FloatArray, high: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return the two halves of a box; the stiffness or rest angle with the largest effect on torques is divided."""
        width = high - low
        far = np.maximum(
            np.abs(self.postures.stretch.max(axis=0) - low[:, 1]),
            np.abs(self.postures.stretch.min(axis=0) - high[:, 1]),
        )
        effect = np.stack([width[:, 0] * far, width[:, 1] * high[:, 0]], axis=1)
        side = np.unravel_index(int(effect.argmax()), effect.shape)
        middle = 0.5 * (low[side] + high[side])
        below, above = high.copy(), low.copy()
        below[side], above[side] = middle, middle
        return [(low, below), (above, high)]

    def improve(self, springs: FloatArray) -> FloatArray:
        """Return springs improved by a pattern search in stiffness and rest angle; steps are halved if none helps."""
        best, worth = springs.copy(), self.objective(springs)
        step = 0.1 * (self.high - self.low)
        for _ in range(12):
            before = worth
            for side in np.ndindex(best.shape):
                for sign in (1.0, -1.0):
                    trial = best.copy()
                    trial[side] = np.clip(trial[side] + sign * step[side], self.low[side], self.high[side])
                    other = self.objective(trial)
                    if other > worth:
                        best, worth = trial, other
            if worth == before:
                step = 0.5 * step
        return best


def prescribe_several(
    postures: Postures,
    places: Sequence[SpringPlace],
    torque: FloatArray,
    penalty: float = PENALTY,
    boxes: int = BOXES,
) -> Springs:
    """Return the springs with which a person can hold the largest functional workspace of several joints.

    ``places`` are the possible springs; if there are none, the result describes the workspace without assistance.
    ``torque`` (n, 2) are the person's limits, N·m. ``penalty`` is the fraction of the cells that justifies the largest
    allowed stiffness. The search ends after a number of boxes.

    ValueError is raised if the search found no springs that hold every required point.
    """
    search = _Search(postures, places, torque, penalty)
    nothing = np.stack([np.zeros(len(places)), 0.5 * (search.low + search.high)[:, 1]], axis=1)
    none = search.objective(nothing)
    best, worth, bound = _branch_and_bound(search, nothing, none, boxes) if places else (nothing, none, none)
    if worth == -np.inf:
        if bound > -np.inf:
            raise ValueError("the search found no springs that hold every required point")
        raise ValueError("no springs can hold every required point")
    size, cells = postures.size, postures.cells
    helps = worth > max(none, 0.0) + _HELPS * cells or none == -np.inf
    chosen = nothing
    if helps:  # without very soft springs, unless this reduces the number of cells
        fewer = best.copy()
        fewer[best[:, 0] <= _SLACK * search.high[:, 0], 0] = 0.0
        chosen = fewer if search.count_cells(fewer, fewer) >= search.count_cells(best, best) else best
    stiffness = chosen[:, 0]
    # the cells held without springs, even if required points are not held: their cells count as others
    p = postures
    free = count_cells(
        p.gravity, p.stretch, p.cell, cells + p.required, 0, search.across, search.torque, nothing, nothing
    )
    return Springs(
        stiffness=stiffness,
        rest=np.where(stiffness > 0, chosen[:, 1], np.nan),
        area=size * search.count_cells(chosen, chosen),
        without=size * free,
        reachable=size * cells,
        gap=size * max(bound - (worth if helps else none), 0.0),
        boxes=search.boxes,
        helps=bool(helps),
    )


def _branch_and_bound(search: _Search, start: FloatArray, worth: float, boxes: int) -> tuple[FloatArray, float, float]:
    """Return the best springs, their objective, and an upper bound of the objective of all springs."""
    best, ticket = start, 0
    queue = [(-search.bound_objective(search.low, search.high), ticket, search.low, search.high)]
    slack = _TOLERANCE * search.postures.cells
    while queue and search.boxes < boxes:
        if -queue[0][0] <= worth + slack:
            break
        _, _, low, high = heapq.heappop(queue)
        for one, other in search.split(low, high):
            promise = search.bound_objective(one, other)
            middle = 0.5 * (one + other)
            here = search.objective(middle)
            if here > worth:
                best = search.improve(middle)
                worth = search.objective(best)
            if promise > worth + slack:
                ticket += 1
                heapq.heappush(queue, (-promise, ticket, one, other))
    best = search.improve(best) if worth > -np.inf else best
    worth = search.objective(best) if worth > -np.inf else worth
    bound = max(worth + (slack if search.boxes > 1 else 0.0), -queue[0][0] if queue else -np.inf)
    return best, worth, bound


def find_held_postures(
    postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, springs: Springs
) -> BoolArray:
    """Return whether each posture (N,) can be held with the springs."""
    needed = postures.gravity.copy()
    for s, place in enumerate(places):
        if springs.stiffness[s] > 0:
            pull = springs.stiffness[s] * (postures.stretch[:, s] - springs.rest[s])
            needed[:, list(place.joints)] += pull[:, None]
    return np.asarray(np.all((needed >= torque[:, 0]) & (needed <= torque[:, 1]), axis=1))


@dataclass(frozen=True)
class SubWorkspace:
    """A sub-workspace: the postures that can be held with one setting of the springs."""

    name: str
    tasks: tuple[str, ...]
    stiffness: FloatArray | None  # (S,) stiffness of the least assistance, N·m/rad; None if no spring is sufficient
    rest: FloatArray | None  # (S,) rest angles, rad; NaN for no spring
    held: BoolArray  # (N,) whether each sampled posture can be held


@dataclass(frozen=True)
class Graph:
    """Graph of sub-workspaces. Its edges are their overlaps, in which the setting can be changed."""

    nodes: tuple[SubWorkspace, ...]
    # both nodes, fraction of the sampled postures that are in both, and index of the posture in the middle of these
    switches: tuple[tuple[tuple[int, int], float, int], ...]
    postures: FloatArray  # (N, n) sampled postures, rad

    def find_path(self, start: int, end: int) -> tuple[int, ...] | None:
        """Return the nodes of the shortest path between two nodes, both included; None if there is none."""
        previous: dict[int, int] = {start: start}
        queue = deque([start])
        while queue:
            here = queue.popleft()
            if here == end:
                path = [end]
                while path[-1] != start:
                    path.append(previous[path[-1]])
                return tuple(reversed(path))
            for between, _, _ in self.switches:
                if here in between:
                    other = between[1] if between[0] == here else between[0]
                    if other not in previous:
                        previous[other] = here
                        queue.append(other)
        return None


def build_graph(nodes: Sequence[SubWorkspace], postures: FloatArray) -> Graph:
    """Return the graph of sub-workspaces, whose switches are overlaps of the sampled postures (N, n), rad."""
    switches = []
    for a in range(len(nodes)):
        for b in range(a + 1, len(nodes)):
            if nodes[a].stiffness is None or nodes[b].stiffness is None:
                continue
            both = np.flatnonzero(nodes[a].held & nodes[b].held)
            if len(both):
                middle = np.median(postures[both], axis=0)
                nearest = both[np.abs(postures[both] - middle).sum(axis=1).argmin()]
                switches.append(((a, b), len(both) / len(postures), int(nearest)))
    return Graph(tuple(nodes), tuple(switches), postures)
