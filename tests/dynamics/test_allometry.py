"""Reference bodies: whole, possible, and what the tables say."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.dynamics.allometry import full_parameters, height_from_legs, table

TABLES = [("winter", None), ("de-leva", "female"), ("de-leva", "male"), ("de-leva", None)]
FOUR = np.array([[-0.03, 0.07], [0.0, 0.43], [0.0, 0.42]])
FIVE = np.vstack([FOUR, [[0.01, 0.14]]])
tables = pytest.mark.parametrize(("name", "sex"), TABLES)


@tables
@pytest.mark.parametrize("centres", [FOUR, FIVE], ids=["torso", "pelvis and trunk"])
def test_masses_sum_to_the_body_s_and_every_segment_can_exist(name, sex, centres) -> None:
    m, mx, my, inertia = full_parameters(table(name, sex), centres, 1.75, 70.0, -1).reshape(-1, 4).T
    assert m.sum() == pytest.approx(70.0, rel=1e-9)
    assert (m > 0).all()
    assert (m * inertia >= mx**2 + my**2).all()


@tables
def test_a_divided_trunk_is_upright_the_whole_one(name, sex) -> None:
    whole = full_parameters(table(name, sex), FOUR, 1.75, 70.0, -1).reshape(-1, 4)
    parts = full_parameters(table(name, sex), FIVE, 1.75, 70.0, -1).reshape(-1, 4)
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
    link = getattr(table(name, sex), segment)
    mass, centre, gyration, length = published
    assert link.mass / 2 == pytest.approx(mass, abs=6e-5)
    assert link.gyration == pytest.approx(gyration, abs=6e-4)
    assert link.length == pytest.approx(length, abs=6e-5)
    if centre is not None:
        assert 1 - link.centre == pytest.approx(centre, abs=6e-5)


@pytest.mark.parametrize(("sex", "mass"), [("male", 0.603), ("female", 0.582)])
def test_head_arms_and_trunk_of_de_leva(sex, mass) -> None:
    hat = table("de-leva", sex).hat
    assert hat.mass == pytest.approx(mass, abs=6e-4)
    assert 0.3 < hat.centre < 1
    winter = table("winter", None).hat
    # composed from another source, yet a body of about the same size
    assert hat.centre * hat.length == pytest.approx(winter.centre * winter.length, rel=0.15)
    assert hat.gyration * hat.length == pytest.approx(winter.gyration * winter.length, rel=0.15)


@tables
def test_height_from_legs_inverts_the_table(name, sex) -> None:
    reference = table(name, sex)
    assert height_from_legs(reference, 1.8 * reference.shank.length, 1.8 * reference.thigh.length) == pytest.approx(1.8)


def test_facing_the_other_way_mirrors_the_body() -> None:
    mirrored = FOUR * [-1, 1]
    left = full_parameters(table("winter", None), FOUR, 1.75, 70.0, -1).reshape(-1, 4)
    right = full_parameters(table("winter", None), mirrored, 1.75, 70.0, 1).reshape(-1, 4)
    np.testing.assert_allclose(right, left * [1, -1, 1, 1])


def test_the_toes_are_in_front() -> None:
    foot = full_parameters(table("winter", None), FOUR, 1.75, 70.0, -1)[:4]
    assert foot[1] / foot[0] < FOUR[0, 0]


def test_three_segments_are_no_person() -> None:
    with pytest.raises(ValueError, match="3 or 4 joints"):
        full_parameters(table("winter", None), FOUR[:2], 1.75, 70.0, -1)
