"""The user's constraints on markers (together, apart), alone and in the segmentation."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from mocap_id.errors import Refused
from mocap_id.kinematics.clusters import Constraints, MarkerClusters, find_base
from mocap_id.kinematics.link_fit import SegmentationRules
from mocap_id.kinematics.segmentation import segment_markers

RULES = SegmentationRules()


def drawn(rng: np.random.Generator, count: int, most: int = 4) -> tuple[list[list[int]], list[list[int]]]:
    """Return random groups of columns for ``together`` and ``apart``."""
    groups = [
        [[int(i) for i in rng.choice(count, rng.integers(2, 4), replace=False)] for _ in range(rng.integers(0, most))]
        for _ in range(2)
    ]
    return groups[0], groups[1]


def compatible(seed: int, count: int, most: int = 4) -> Constraints:
    """Return random constraints without contradiction."""
    rng = np.random.default_rng(seed)
    while True:
        constraints = Constraints.of(count, *drawn(rng, count, most))
        if not constraints.contradictory.any():
            return constraints


@pytest.mark.parametrize("seed", range(40))
def test_units_and_barred_pairs_are_those_of_a_graph(seed: int) -> None:
    count = 9
    together, apart = drawn(np.random.default_rng(seed), count)
    found = Constraints.of(count, together, apart)
    graph = np.zeros((count, count))
    for group in together:
        for i, j in combinations(group, 2):
            graph[i, j] = 1
    component = connected_components(graph, directed=False)[1]
    assert ((found.unit[:, None] == found.unit) == (component[:, None] == component)).all()
    asked = {(component[i], component[j]) for group in apart for i, j in combinations(group, 2)}
    for i in range(count):
        for j in range(count):
            expected = (component[i], component[j]) in asked or (component[j], component[i]) in asked
            assert found.barred[i, j] == expected
    contradicted = {a for a, b in asked if a == b}
    assert found.contradictory.tolist() == [bool(component[i] in contradicted) for i in range(count)]


def test_together_is_transitive_in_any_order() -> None:
    for groups in ([[0, 1], [1, 2], [3, 4], [4, 0]], [[4, 0], [3, 4], [1, 2], [1, 0]]):
        unit = Constraints.of(6, groups).unit
        assert len(set(unit[:5])) == 1
        assert unit[5] != unit[0]


def test_an_indirect_contradiction_is_found() -> None:
    fine = Constraints.of(5, [[0, 1], [2, 3]], [[1, 2]])
    assert not fine.contradictory.any()
    assert fine.barred[0, 3]
    wrong = Constraints.of(5, [[0, 1], [1, 2], [3, 4]], [[0, 2]])
    assert wrong.contradictory.tolist() == [True, True, True, False, False]


def test_allow_checks_all_pairs() -> None:
    rng = np.random.default_rng(1)
    for seed in range(30):
        constraints = compatible(seed, 8)
        members = rng.choice(8, 4, replace=False)
        assert constraints.allow(members) == all(not constraints.barred[i, j] for i, j in combinations(members, 2))


def test_constrained_variance_is_least_within_units_and_largest_for_barred_pairs() -> None:
    rng = np.random.default_rng(2)
    variance = rng.uniform(0, 4, (6, 6))
    variance = variance + variance.T
    np.fill_diagonal(variance, 0)
    constraints = Constraints.of(8, [[1, 2]], [[4, 6]])
    members = np.array([0, 1, 2, 4, 6, 7])
    shaped = constraints.constrained_variance(variance, members)
    assert (shaped == shaped.T).all()
    assert shaped[1, 2] == 0
    assert shaped[3, 4] > variance.max()
    untouched = np.ones((6, 6), dtype=bool)
    untouched[[1, 2, 3, 4], [2, 1, 4, 3]] = False
    assert (shaped[untouched] == variance[untouched]).all()


@pytest.mark.parametrize("seed", range(10))
def test_nearest_bodies_without_constraints_have_the_least_distance(seed: int) -> None:
    square = np.random.default_rng(seed).uniform(size=(4, 7))
    members = np.random.default_rng(seed).permutation(10)[:7]
    assert (Constraints.of(10).nearest_bodies(square, members) == np.argmin(square, axis=0)).all()


@pytest.mark.parametrize("seed", range(60))
def test_nearest_bodies_keep_units_together_and_separate_barred_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    constraints = compatible(seed, 9)
    members = np.sort(rng.permutation(9)[:7])
    square = rng.uniform(size=(3, 7))
    body = constraints.nearest_bodies(square, members)
    unit = constraints.unit[members]
    barred = constraints.barred[np.ix_(members, members)]
    least = {int(u): int(np.argmin(square[:, unit == u].sum(axis=1))) for u in np.unique(unit)}
    for k, u in enumerate(unit):
        assert (body[unit == u] == body[k]).all()
        if not barred[k].any():
            assert body[k] == least[int(u)]
    for i, j in np.argwhere(np.triu(barred)):
        if body[i] == body[j]:  # then neither could go anywhere
            for k in (i, j):
                assert set(body[barred[k]]) >= set(range(3)) - {body[k]}


def test_of_a_barred_pair_the_marker_with_less_loss_moves() -> None:
    constraints = Constraints.of(3, (), [[0, 1]])
    square = np.array([[1.0, 1.0, 1.0], [9.0, 2.0, 5.0], [8.0, 7.0, 5.0]])
    assert constraints.nearest_bodies(square, np.arange(3)).tolist() == [0, 1, 0]
    assert constraints.nearest_bodies(square[:, [1, 0, 2]], np.arange(3)).tolist() == [1, 0, 0]


def held(segment: np.ndarray, constraints: Constraints) -> bool:
    """Return whether every unit is on one segment (or on none) and no barred pair shares one."""
    same = segment[:, None] == segment
    whole = same[constraints.unit[:, None] == constraints.unit].all()
    return bool(whole and not (same & (segment >= 0) & constraints.barred).any())


def test_clusters_satisfy_the_constraints(chain) -> None:
    truth = chain(2, joints=2, noise=5e-4)
    moving = np.flatnonzero(truth.segment > 0)
    plain = MarkerClusters(truth.points, moving, Constraints.of(14)).bodies_at(2)
    assert sorted(body.markers.tolist() for body in plain) == [list(range(4, 9)), list(range(9, 14))]
    forced = MarkerClusters(truth.points, moving, Constraints.of(14, [[5, 10]])).bodies_at(2)
    assert any({5, 10} <= set(body.markers.tolist()) for body in forced)
    parted = MarkerClusters(truth.points, moving, Constraints.of(14, (), [[5, 6]])).bodies_at(3)
    assert not any({5, 6} <= set(body.markers.tolist()) for body in parted)


def slipping(truth, start: complex, follows: int) -> np.ndarray:
    """Return a marker near joint 2 that moves with the segment before or after it."""
    turn = np.exp(1j * np.cumsum(truth.relative, axis=1))
    joint = truth.centres[0] + turn[:, 0] * truth.centres[1]
    return joint + turn[:, follows - 1] * start


def test_together_forces_a_misplaced_marker_back(chain) -> None:
    """Rigidity assigns a thigh marker to the shank because its skin moves with it; the user corrects this."""
    truth = chain(3, joints=2, noise=5e-4)
    points = np.concatenate([truth.points, slipping(truth, 0.008 + 0.004j, 1)[:, None]], axis=1)
    lateral = np.append(truth.lateral, 0.0)
    plain = segment_markers(points, lateral, RULES)
    assert plain.segment.tolist() == [*truth.segment, 1]
    told = Constraints.of(15, [[14, 10]])
    forced = segment_markers(points, lateral, RULES, told)
    assert forced.segment.tolist() == [*truth.segment, 2]
    assert forced.residual[14] > plain.residual[14]


def test_apart_moves_a_malleolus_off_the_base(chain) -> None:
    """Its residual is larger on the shank than on the base, so without the constraint it stays."""
    truth = chain(13, noise=3e-4)
    angle = np.cumsum(truth.relative, axis=1)[:, 0]
    malleolus = truth.centres[0] + 4e-3 * np.exp(1j * (0.3 - 0.2 * angle))
    points = np.concatenate([truth.points, malleolus[:, None]], axis=1)
    lateral = np.append(truth.lateral, 0.0)
    last = points.shape[1] - 1
    plain = segment_markers(points, lateral, RULES)
    assert plain.segment.tolist() == [*truth.segment, 0]
    told = Constraints.of(last + 1, (), [[last, marker] for marker in range(4)])
    found = segment_markers(points, lateral, RULES, told)
    assert last not in found.base.markers
    assert found.segment.tolist() == [*truth.segment, 1]


def test_the_base_keeps_the_stiller_of_a_barred_pair_and_no_marker_of_a_moving_unit(chain) -> None:
    truth = chain(4, noise=3e-4)
    scatter = find_base(truth.points, 0.015, Constraints.of(19)).scatter
    assert find_base(truth.points, 0.015, Constraints.of(19)).markers.tolist() == [0, 1, 2, 3]
    still, less = sorted((0, 2), key=lambda marker: scatter[marker])
    kept = find_base(truth.points, 0.015, Constraints.of(19, (), [[0, 2]])).markers
    assert still in kept
    assert less not in kept
    assert find_base(truth.points, 0.015, Constraints.of(19, [[1, 7]])).markers.tolist() == [0, 2, 3]
    assert find_base(truth.points, 0.015, Constraints.of(19, [[1, 3]])).markers.tolist() == [0, 1, 2, 3]


def test_true_constraints_change_nothing(chain) -> None:
    """This includes a group of all base markers, which leaves no candidate for the axis."""
    truth = chain(5, noise=1e-3)
    groups = [np.flatnonzero(truth.segment == k).tolist() for k in range(4)]
    apart = [[group[1] for group in groups]]
    plain = segment_markers(truth.points, truth.lateral, RULES)
    told = segment_markers(truth.points, truth.lateral, RULES, Constraints.of(19, groups, apart))
    assert (plain.segment == truth.segment).all()
    assert (told.segment == truth.segment).all()
    assert told.residual == pytest.approx(plain.residual)


def test_still_markers_tied_to_moving_ones_are_no_base(chain) -> None:
    truth = chain(6)
    with pytest.raises(Refused) as refused:
        segment_markers(truth.points, truth.lateral, RULES, Constraints.of(19, [[0, 1, 2, 3, 8]]))
    assert refused.value.code == "no-fixed-base"


@pytest.mark.parametrize(
    ("together", "apart", "hidden"),
    [((), [[4, 5]], [4, 5]), ([[4, 9]], (), [4]), ([[4, 9]], (), [4, 9]), ((), [[4, 14]], [4])],
    ids=["two left over", "one of a unit", "a whole unit", "one on the axis"],
)
def test_adopted_markers_satisfy_the_constraints(chain, together, apart, hidden: list[int]) -> None:
    """They are seen too rarely to form a body, and join the segment that fits them."""
    truth = chain(13, joints=2, noise=3e-4)
    points = truth.points.copy()
    points[16:, hidden] = np.nan
    turn = np.exp(1j * truth.relative[:, 0])
    rng = np.random.default_rng(0)
    noise = 3e-4 * (rng.standard_normal(len(turn)) + 1j * rng.standard_normal(len(turn)))
    malleolus = truth.centres[0] + turn * (0.001 + 0.001j) + noise
    points, lateral = np.concatenate([points, malleolus[:, None]], axis=1), np.append(truth.lateral, 0.0)
    free = segment_markers(points, lateral, RULES)
    assert free.segment.tolist() == [*truth.segment, 1]
    constraints = Constraints.of(15, together, apart)
    assert held(segment_markers(points, lateral, RULES, constraints).segment, constraints)


@pytest.mark.parametrize("marker", [0, 5, 10])
def test_a_marker_never_seen_is_on_no_segment_even_in_a_unit(chain, marker: int) -> None:
    truth = chain(14, joints=2, noise=3e-4)
    points = truth.points.copy()
    points[:, marker] = np.nan
    found = segment_markers(points, truth.lateral, RULES, Constraints.of(14, [[marker, marker + 1, marker + 2]]))
    expected = truth.segment.copy()
    expected[marker] = -1
    assert (found.segment == expected).all()
    assert np.isnan(found.residual[marker])


def sloppy(truth, seed: int) -> np.ndarray:
    """Return trajectories in which two of five wander by some millimetres, so that some are left over."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * np.pi, len(truth.points))
    points = truth.points.copy()
    for marker in np.flatnonzero(rng.random(points.shape[1]) < 0.4):
        direction = np.exp(1j * rng.uniform(0, 6))
        points[:, marker] += rng.uniform(2e-3, 1e-2) * direction * np.sin(t * rng.uniform(1, 7) + rng.uniform(0, 6))
    return points


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(k, marks=pytest.mark.slow) for k in range(8, 25))])
def test_every_result_satisfies_the_constraints(chain, seed: int) -> None:
    truth = chain(seed, joints=2, frames=120, noise=3e-4)
    constraints = compatible(seed, truth.points.shape[1], most=3)
    try:
        found = segment_markers(sloppy(truth, seed), truth.lateral, RULES, constraints)
    except Refused as refusal:
        assert refusal.code in {"no-chain", "no-fixed-base", "no-motion"}
    else:
        assert held(found.segment, constraints)
