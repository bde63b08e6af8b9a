"""One revolute joint, symbol by symbol, against the published form in Denavit-Hartenberg parameters.

The source is W. Khalil and E. Dombre, *Modeling, Identification and Control of Robots*, Hermes Penton, 2002, chapter 9
(the Newton-Euler form that is linear in the inertial parameters) in modified Denavit-Hartenberg notation: axis z of
frame 1 along the joint, parameters XX XY XZ YY YZ ZZ MX MY MZ M about the frame's origin,

    F = M V̇ + U MS,        N = J ω̇ + MS × V̇ + ω × (J ω),        Γ = N_z,

with U = [ω̇]^ + [ω]^², V̇ the origin's acceleration less gravity, all in frame 1. For one joint ω = (0, 0, q̇) and, with
gravity along -y of the base, V̇ = g (sin q, cos q, 0), so that

    Γ = ZZ q̈ + g (MX cos q - MY sin q).

``PUBLISHED`` holds F and N multiplied out and turned into the base's axes.

Each entry of the regressor is a sum of the monomials {1, cos q, sin q, cos²q, sin q cos q} × {1, q̇², q̈} × {1, g} with
whole coefficients. More samples than there are monomials tell them: that the sum fits to rounding shows that there
is no other term, and the coefficients are the form itself.
"""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.dynamics.regressor import (
    LINK_PARAMETERS,
    planar_regressor,
    planar_torque_regressor,
    spatial_regressor,
    spatial_torque_regressor,
)
from mocap_id.geometry import planar

ANGLES = ("1", "c", "s", "cc", "sc")
RATES = ("", "v", "a")  # 1, q̇², q̈
KHALIL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
OURS = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mx", "my", "mz", "m")

# base frame at the joint; rows Fx Fy Fz Mx My Mz; "+2sa" means 2 q̈ sin q, "g" gravity
PUBLISHED = {
    "M": {"Fy": "+g", },
    "MX": {"Fx": "-sa -cv", "Fy": "+ca -sv", "Mz": "+gc"},
    "MY": {"Fx": "-ca +sv", "Fy": "-sa -cv", "Mz": "-gs"},
    "MZ": {"Mx": "-g", },
    "XZ": {"Mx": "+ca -sv", "My": "+sa +cv"},
    "YZ": {"Mx": "-sa -cv", "My": "+ca -sv"},
    "ZZ": {"Mz": "+a"},
}  # fmt: skip
TORQUE = {"ZZ": "+a", "MX": "+gc", "MY": "-gs"}
ROWS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def monomials(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, g: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Names and values (T, k) of the monomials."""
    c, s = np.cos(q), np.sin(q)
    angles = {"": np.ones_like(q), "c": c, "s": s, "cc": c * c, "sc": s * c}
    rates = {"": np.ones_like(q), "v": dq**2, "a": ddq}
    gravity = {"": np.ones_like(q), "g": g}
    names, values = [], []
    for g_name, g_value in gravity.items():
        for angle, angle_value in angles.items():
            for rate, rate_value in rates.items():
                names.append(g_name + angle + rate)
                values.append(g_value * angle_value * rate_value)
    return names, np.stack(values, axis=1)


def read_off(entry: np.ndarray, names: list[str], values: np.ndarray) -> dict[str, int]:
    """The whole coefficients of an entry (T,), by monomial."""
    coefficient, *_ = np.linalg.lstsq(values, entry, rcond=None)
    whole = np.rint(coefficient)
    np.testing.assert_allclose(coefficient, whole, atol=1e-9)
    np.testing.assert_allclose(values @ whole, entry, atol=1e-12 * max(1.0, float(np.abs(entry).max())))
    return {name: int(number) for name, number in zip(names, whole, strict=True) if number}


def parsed(form: str) -> dict[str, int]:
    return {term[1:]: 1 if term[0] == "+" else -1 for term in form.split()}


@pytest.fixture(scope="module")
def samples() -> tuple[np.ndarray, ...]:
    """q, q̇, q̈ and g in general position, twice as many as monomials."""
    rng = np.random.default_rng(0)
    return rng.uniform(-3, 3, 64), rng.normal(size=64) * 2, rng.normal(size=64) * 3, rng.uniform(0, 12, 64)


def test_the_spatial_regressor_is_the_published_form(samples: tuple[np.ndarray, ...]) -> None:
    q, dq, ddq, g = samples
    names, values = monomials(*samples)
    chain = planar.spatial_chain(np.zeros((1, 2)))
    wrench = np.stack(
        [
            spatial_regressor(chain, *(x[k : k + 1, None] for x in (q, dq, ddq)), np.array([0, g[k], 0, 0, 0, 0]))[0]
            for k in range(len(q))
        ]
    )
    torque = spatial_torque_regressor(chain, q[:, None], wrench)[:, 0]
    for theirs, ours in zip(KHALIL, OURS, strict=True):
        column = len(LINK_PARAMETERS) + LINK_PARAMETERS.index(ours)  # behind the base's own ten
        for i, row in enumerate(ROWS):
            expected = parsed(PUBLISHED.get(theirs, {}).get(row, ""))
            assert read_off(wrench[:, i, column], names, values) == expected, (theirs, row)
        assert read_off(torque[:, column], names, values) == parsed(TORQUE.get(theirs, "")), theirs
        assert not torque[:, LINK_PARAMETERS.index(ours)].any(), "the base has no part in the torque"


def test_the_planar_regressor_is_the_published_form(samples: tuple[np.ndarray, ...]) -> None:
    q, dq, ddq, g = samples
    names, values = monomials(*samples)
    centre = np.zeros((1, 2))
    wrench = np.stack(
        [planar_regressor(centre, *(x[k : k + 1, None] for x in (q, dq, ddq)), gravity=g[k])[0] for k in range(len(q))]
    )
    torque = planar_torque_regressor(centre, q[:, None], wrench)[:, 0]
    for column, theirs in enumerate(("M", "MX", "MY", "ZZ"), start=4):
        for i, row in enumerate(("Fx", "Fy", "Mz")):
            expected = parsed(PUBLISHED[theirs].get(row, ""))
            assert read_off(wrench[:, i, column], names, values) == expected, (theirs, row)
        assert read_off(torque[:, column], names, values) == parsed(TORQUE.get(theirs, "")), theirs


def test_reading_off_fails_on_what_is_not_the_form(samples: tuple[np.ndarray, ...]) -> None:
    q, dq, ddq, g = samples
    names, values = monomials(*samples)
    assert read_off(ddq + g * np.cos(q), names, values) == {"a": 1, "gc": 1}
    with pytest.raises(AssertionError):
        read_off(ddq + dq, names, values)
    with pytest.raises(AssertionError):
        read_off(0.5 * ddq, names, values)
