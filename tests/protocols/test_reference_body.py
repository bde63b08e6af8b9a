"""The reference body reports its assumptions."""

from __future__ import annotations

import numpy as np
import pytest
from protocol_cases import CENTRES, HIGH, sit_to_stand

from mocap_id.protocols.body_names import build_reference_body
from mocap_id.protocols.repetitions import compute_posture, measure_standing_angles

KNOWN = {"height": 1.75, "mass": 70.0, "sex": "female", "plate_mass": 71.0}


def body(centres=CENTRES, name="winter", **changes):
    return build_reference_body(name, centres, -1, **{**KNOWN, **changes})


def test_a_known_subject_needs_no_assumption() -> None:
    found = body()
    assert found.table == "winter"
    assert found.reasons == ()
    assert (found.height, found.mass, found.assumed, found.why) == (1.75, 70.0, (), None)
    assert found.parameters[::4].sum() == pytest.approx(70.0)


@pytest.mark.parametrize(
    ("missing", "name", "said"),
    [
        ({"mass": None}, "winter", "a mass of 71.0 kg, from the plates"),
        ({"height": None}, "winter", "a height of 1.71 m, from the lengths of shank and thigh (0.840 m / 0.491)"),
        ({"height": None}, "de-leva", "a height of 1.82 m, from the lengths of shank and thigh (0.840 m / 0.462)"),
        ({"height": None, "sex": "male"}, "de-leva", "a height of 1.71 m, from the lengths of shank and thigh"),
        ({"sex": None}, "de-leva", "the mean of the female and the male table"),
    ],
)
def test_missing_values_are_estimated_and_reported(missing, name, said) -> None:
    found = body(name=name, **missing)
    (reason,) = found.reasons
    assert reason.level == "ok"
    assert said in reason.message
    assert said in found.assumed[0]
    assert np.isfinite(found.parameters).all()
    assert found.parameters[::4].sum() == pytest.approx(found.mass)


def test_the_sex_does_not_matter_to_winter() -> None:
    assert body(sex=None).reasons == ()


@pytest.mark.parametrize(
    ("centres", "changes", "said"),
    [(CENTRES[:2], {}, "4 or 5 segments"), (CENTRES, {"mass": None, "plate_mass": None}, "mass")],
)
def test_a_missing_reference_has_a_reason(centres, changes, said) -> None:
    found = body(centres, **changes)
    assert found.table is None
    assert found.height is None
    assert said in found.why
    assert np.isnan(found.parameters).all()
    assert len(found.parameters) == 4 * (len(centres) + 1)
    (reason,) = found.reasons
    assert reason.level == "ok"
    assert said in reason.message


def test_only_the_mass_is_required() -> None:
    found = body(height=None, mass=None, sex=None, name="de-leva")
    assert len(found.assumed) == 3
    assert found.mass == 71.0
    (reason,) = found.reasons
    assert all(assumption in reason.message for assumption in found.assumed)


def test_standing_angles_are_those_of_upright_pauses() -> None:
    recorded, _ = sit_to_stand(3)
    q = recorded.q.copy()
    q[100:130] = np.nan
    body_posture = compute_posture(q, recorded.dq, CENTRES)
    np.testing.assert_allclose(measure_standing_angles(q, body_posture), np.cumsum(HIGH), atol=0.06)
    assert measure_standing_angles(np.full_like(q, np.nan), body_posture) is None


def test_without_a_rise_every_sample_counts_as_standing() -> None:
    recorded, _ = sit_to_stand(2)
    q = 0.02 * recorded.q + 0.1
    still = compute_posture(q, 0.02 * recorded.dq, CENTRES)
    assert not still.moves
    np.testing.assert_allclose(measure_standing_angles(q, still), np.median(np.cumsum(q, axis=1), axis=0))


def test_a_rotated_trunk_frame_gives_the_same_trunk() -> None:
    upright = body(standing=np.array([0.0, 0.0, 0.0])).parameters.reshape(-1, 4)
    turned = body(standing=np.array([0.0, 0.0, 0.3])).parameters.reshape(-1, 4)
    np.testing.assert_array_equal(turned[:3], upright[:3])
    m, mx, my, izz = turned[3]
    np.testing.assert_allclose([m, np.hypot(mx, my), izz], [upright[3, 0], upright[3, 2], upright[3, 3]])
    assert np.arctan2(my, mx) == pytest.approx(np.pi / 2 - 0.3)  # upright in the plane, so turned back in the frame
