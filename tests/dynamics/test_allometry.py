"""Reference bodies: whole, possible, and what the tables say."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.dynamics.priors import _DE_LEVA, _SHOULDER, estimate_height, look_up_table, scale_reference
from mocap_id.dynamics.regressor import planar_regressor

TABLES = [("winter", None), ("de-leva", "female"), ("de-leva", "male"), ("de-leva", None)]
FOUR = np.array([[-0.03, 0.07], [0.0, 0.43], [0.0, 0.42]])
FIVE = np.vstack([FOUR, [[0.01, 0.14]]])
tables = pytest.mark.parametrize(("name", "sex"), TABLES)


@tables
@pytest.mark.parametrize("centres", [FOUR, FIVE], ids=["torso", "pelvis and trunk"])
def test_masses_sum_to_the_body_s_and_every_segment_can_exist(name, sex, centres) -> None:
    m, mx, my, inertia = scale_reference(look_up_table(name, sex), centres, 1.75, 70.0, -1).reshape(-1, 4).T
    assert m.sum() == pytest.approx(70.0, rel=1e-9)
    assert (m > 0).all()
    assert (m * inertia >= mx**2 + my**2).all()


@tables
def test_a_divided_trunk_is_upright_the_whole_one(name, sex) -> None:
    whole = scale_reference(look_up_table(name, sex), FOUR, 1.75, 70.0, -1).reshape(-1, 4)
    parts = scale_reference(look_up_table(name, sex), FIVE, 1.75, 70.0, -1).reshape(-1, 4)
    np.testing.assert_allclose(parts[:3], whole[:3])
    pelvis, (m, mx, my, inertia) = parts[3], parts[4]
    x, y = FIVE[3]
    raised = np.array([m, mx + m * x, my + m * y, inertia + 2 * (mx * x + my * y) + m * (x * x + y * y)])
    np.testing.assert_allclose(pelvis + raised, whole[3], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "sex", "segment", "published"),
    [
        ("winter", None, "foot", (0.0145, None, 0.475, 0.152)),
        ("winter", None, "shank", (0.0465, 0.433, 0.302, 0.246)),
        ("winter", None, "thigh", (0.100, 0.433, 0.323, 0.245)),
        ("de-leva", "male", "shank", (0.0433, 0.4459, 0.249, 0.2493)),
        ("de-leva", "female", "shank", (0.0481, 0.4416, 0.267, 0.2492)),
        ("de-leva", "male", "thigh", (0.1416, 0.4095, 0.329, 0.2425)),
        ("de-leva", "female", "thigh", (0.1478, 0.3612, 0.364, 0.2124)),
        ("de-leva", "male", "foot", (0.0137, None, 0.245, 0.1482)),
        ("de-leva", "female", "foot", (0.0129, None, 0.279, 0.1316)),
    ],
)
def test_the_published_fractions(name, sex, segment, published) -> None:
    """Mass of one side, centre from the upper end, radius of gyration, length."""
    link = getattr(look_up_table(name, sex), segment)
    mass, centre, gyration, length = published
    assert link.mass / 2 == pytest.approx(mass, abs=6e-5)
    assert link.gyration == pytest.approx(gyration, abs=6e-4)
    assert link.length == pytest.approx(length, abs=6e-5)
    if centre is not None:
        assert 1 - link.centre == pytest.approx(centre, abs=6e-5)


@pytest.mark.parametrize("sex", ["female", "male"])
def test_the_published_table_is_whole(sex) -> None:
    """Its masses are those of one body, to the table's rounding."""
    rows = _DE_LEVA[sex]
    sides = {"head": 1, "trunk": 1, "upper arm": 2, "forearm": 2, "hand": 2, "thigh": 2, "shank": 2, "foot": 2}
    assert sum(count * rows[name][0] for name, count in sides.items()) == pytest.approx(100, abs=0.02)


ELSEWHERE = {
    # de Leva's table 4 between other landmarks: length mm, centre %, transverse radius of gyration %
    ("female", "head"): (200.2, 58.94, 35.9),
    ("male", "head"): (203.3, 59.76, 37.6),
    ("female", "trunk"): (529.3, 41.51, 33.9),
    ("male", "trunk"): (531.9, 44.86, 34.7),
    ("female", "shank"): (438.6, 43.52, 26.3),
    ("male", "shank"): (440.3, 43.95, 24.6),
}


@pytest.mark.parametrize(("sex", "segment"), ELSEWHERE)
def test_other_rows_of_the_published_table_describe_the_same_segments(sex, segment) -> None:
    """The radius of gyration is the body's; so is the centre, from an end that both rows share."""
    _, length, centre, gyration = _DE_LEVA[sex][segment]
    other, other_centre, other_gyration = ELSEWHERE[sex, segment]
    assert gyration * length == pytest.approx(other_gyration * other, rel=0.005)
    here, there = length * centre / 100, other * other_centre / 100
    if segment == "trunk":  # they share the lower end, mid-hip
        here, there = length - here, other - there
    assert here == pytest.approx(there, abs=1.5)


THIRDS = {  # upper, middle, lower trunk: mass %, length mm, centre % from above
    "female": ((15.45, 228.0, 50.50), (14.65, 205.3, 45.12), (12.47, 181.5, 49.20)),
    "male": ((15.96, 242.1, 50.66), (16.33, 215.5, 45.02), (11.17, 145.7, 61.15)),
}


@pytest.mark.parametrize("sex", THIRDS)
def test_the_trunk_is_the_sum_of_its_published_thirds(sex) -> None:
    """Cervicale to xiphion, to omphalion, to mid-hip."""
    mass, length, centre, _ = _DE_LEVA[sex]["trunk"]
    parts = np.array(THIRDS[sex])
    assert parts[:, 0].sum() == pytest.approx(mass, abs=0.01)
    assert parts[:, 1].sum() == pytest.approx(length, abs=0.1)
    tops = np.r_[0.0, np.cumsum(parts[:, 1])[:-1]]
    whole = parts[:, 0] @ (tops + parts[:, 2] / 100 * parts[:, 1]) / mass
    assert whole == pytest.approx(centre / 100 * length, abs=3.0)
    assert _DE_LEVA[sex]["lower trunk"][:3] == tuple(parts[2])


@pytest.mark.parametrize("sex", ["female", "male"])
def test_the_hat_is_composed_of_head_trunk_and_hanging_arms(sex) -> None:
    """Against point masses: every part a pair of points with its mass, centre and gyration."""
    rows, masses, heights = _DE_LEVA[sex], [], []
    top = rows["trunk"][1]
    starts = {"head": top + rows["head"][1], "trunk": top, "upper arm": _SHOULDER[sex]}
    starts["forearm"] = starts["upper arm"] - rows["upper arm"][1]
    starts["hand"] = starts["forearm"] - rows["forearm"][1]
    for name, start in starts.items():
        mass, length, centre, gyration = rows[name]
        middle = start - centre / 100 * length
        for side in (-1, 1):
            masses.append(mass * (0.5 if name in ("head", "trunk") else 1.0))
            heights.append(middle + side * gyration / 100 * length)
    masses, heights = np.array(masses), np.array(heights)
    hat, whole = look_up_table("de-leva", sex).hat, masses @ heights / masses.sum()
    assert hat.centre * _SHOULDER[sex] == pytest.approx(whole)
    spread = np.sqrt(masses @ (heights - whole) ** 2 / masses.sum())
    assert hat.gyration * _SHOULDER[sex] == pytest.approx(spread)
    assert hat.length * {"female": 1735.0, "male": 1741.0}[sex] == pytest.approx(_SHOULDER[sex])


@pytest.mark.parametrize(("sex", "mass"), [("male", 0.603), ("female", 0.582)])
def test_head_arms_and_trunk_of_de_leva(sex, mass) -> None:
    hat = look_up_table("de-leva", sex).hat
    assert hat.mass == pytest.approx(mass, abs=6e-4)
    assert 0.3 < hat.centre < 1
    winter = look_up_table("winter", None).hat
    # composed from another source, yet a body of about the same size
    assert hat.centre * hat.length == pytest.approx(winter.centre * winter.length, rel=0.15)
    assert hat.gyration * hat.length == pytest.approx(winter.gyration * winter.length, rel=0.15)


@tables
def test_height_from_legs_inverts_the_table(name, sex) -> None:
    reference = look_up_table(name, sex)
    assert estimate_height(reference, 1.8 * reference.shank.length, 1.8 * reference.thigh.length) == pytest.approx(1.8)


def test_facing_the_other_way_mirrors_the_body() -> None:
    mirrored = FOUR * [-1, 1]
    left = scale_reference(look_up_table("winter", None), FOUR, 1.75, 70.0, -1).reshape(-1, 4)
    right = scale_reference(look_up_table("winter", None), mirrored, 1.75, 70.0, 1).reshape(-1, 4)
    np.testing.assert_allclose(right, left * [1, -1, 1, 1])


@tables
@pytest.mark.parametrize("centres", [FOUR, FIVE], ids=["torso", "pelvis and trunk"])
def test_how_the_markers_turn_a_segment_s_frame_does_not_turn_the_person(name, sex, centres) -> None:
    """The frames above the hip are a gauge; upright while standing, the body feels the same whatever they are."""
    rng = np.random.default_rng(2)
    joints = len(centres)
    q, dq, ddq = rng.normal(size=(3, 20, joints))
    turned_q, turned_centres, standing = q.copy(), centres.copy(), np.zeros(joints)
    first, second = 0.3, -0.2
    turned_q[:, 2] += first
    standing[2:] = first
    if joints == 4:  # the joint's place in the pelvis's frame turns with it, and the trunk's own frame once more
        cos, sin = np.cos(first), np.sin(first)
        turned_centres[3] = [cos * centres[3, 0] + sin * centres[3, 1], -sin * centres[3, 0] + cos * centres[3, 1]]
        turned_q[:, 3] += second - first
        standing[3] = second
    straight = scale_reference(look_up_table(name, sex), centres, 1.75, 70.0, -1)
    gauged = scale_reference(look_up_table(name, sex), turned_centres, 1.75, 70.0, -1, standing=standing)
    np.testing.assert_allclose(
        planar_regressor(turned_centres, turned_q, dq, ddq) @ gauged,
        planar_regressor(centres, q, dq, ddq) @ straight,
        atol=1e-9,
    )


def test_the_toes_are_in_front() -> None:
    foot = scale_reference(look_up_table("winter", None), FOUR, 1.75, 70.0, -1)[:4]
    assert foot[1] / foot[0] < FOUR[0, 0]


def test_three_segments_are_no_person() -> None:
    with pytest.raises(ValueError, match="3 or 4 joints"):
        scale_reference(look_up_table("winter", None), FOUR[:2], 1.75, 70.0, -1)
