"""The reference body says what it had to assume."""

from __future__ import annotations

import numpy as np
import pytest
from protocol_cases import CENTRES

from mocap_id.protocols.reference_body import reference_body

KNOWN = {"height": 1.75, "mass": 70.0, "sex": "female", "plate_mass": 71.0}


def body(centres=CENTRES, name="winter", **changes):
    return reference_body(name, centres, -1, **{**KNOWN, **changes})


def test_a_known_subject_needs_no_assumption() -> None:
    found = body()
    assert found.table == "winter"
    assert found.reasons == ()
    assert found.parameters[::4].sum() == pytest.approx(70.0)


@pytest.mark.parametrize(
    ("missing", "name", "said"),
    [
        ({"mass": None}, "winter", "a mass of 71.0 kg, from the plates"),
        ({"height": None}, "winter", "a height of 1.71 m, from the lengths of shank and thigh"),
        ({"sex": None}, "de-leva", "the mean of the female and the male table"),
    ],
)
def test_what_is_missing_is_estimated_and_said(missing, name, said) -> None:
    found = body(name=name, **missing)
    (reason,) = found.reasons
    assert reason.level == "ok"
    assert said in reason.message
    assert np.isfinite(found.parameters).all()


def test_the_sex_does_not_matter_to_winter() -> None:
    assert body(sex=None).reasons == ()


@pytest.mark.parametrize(
    ("centres", "changes", "said"),
    [(CENTRES[:2], {}, "4 or 5 segments"), (CENTRES, {"mass": None, "plate_mass": None}, "mass")],
)
def test_where_no_reference_applies_it_says_why(centres, changes, said) -> None:
    found = body(centres, **changes)
    assert found.table is None
    assert np.isnan(found.parameters).all()
    assert len(found.parameters) == 4 * (len(centres) + 1)
    (reason,) = found.reasons
    assert reason.level == "ok"
    assert said in reason.message
