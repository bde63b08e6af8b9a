"""Unit accelerations through composite bodies: the regressor's and the markers' Jacobian's, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, random_chain

from mocap_id.dynamics.regressor import composite_inertia, planar_regressor, planar_torque_regressor, regroup_columns
from mocap_id.geometry import planar


def columns(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, first and second moments of parameters (m, mx, my, Izz) of every segment."""
    return parameters[:, 0], parameters[:, 1:3], parameters[:, 3]


def by_regressor(q: np.ndarray, centres: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wrench (T, 3, n) and torques (T, n, n) of one joint's unit acceleration after the other, at rest, no gravity."""
    wrench, torque = [], []
    for unit in np.eye(q.shape[1]):
        still = np.zeros_like(q)
        regressor = planar_regressor(centres, q, still, still + unit, gravity=0.0)
        wrench.append(regressor @ parameters.ravel())
        torque.append(planar_torque_regressor(centres, q, regressor) @ parameters.ravel())
    return np.stack(wrench, axis=-1), np.stack(torque, axis=-1)


@pytest.mark.parametrize("joints", [1, 2, 3, 6])
def test_what_the_regressor_says_of_unit_accelerations(joints: int) -> None:
    """For any parameters, such as no body has, too: the base parameters are such."""
    rng = np.random.default_rng(joints)
    q, centres = rng.normal(size=(40, joints)), random_chain(rng, joints)
    parameters = rng.normal(size=(joints + 1, 4))
    found, expected = composite_inertia(q, centres, *columns(parameters)), by_regressor(q, centres, parameters)
    for ours, each in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, each, atol=1e-10)


def test_base_parameters_stand_for_a_body() -> None:
    """Regrouping changes nothing that the joints' accelerations do."""
    states = np.random.default_rng(5).normal(size=(3, 60, len(CENTRES)))
    base = regroup_columns(planar_regressor(CENTRES, *states).reshape(-1, BODY.size))
    regrouped = np.zeros(BODY.size)
    regrouped[base.kept] = base.regrouping @ BODY.ravel()
    assert np.count_nonzero(regrouped) < BODY.size
    body, stand_in = (
        composite_inertia(states[0], CENTRES, *columns(each)) for each in (BODY, regrouped.reshape(-1, 4))
    )
    for ours, each in zip(stand_in, body, strict=True):
        np.testing.assert_allclose(ours, each, atol=1e-10)


@pytest.mark.parametrize("joints", [1, 3, 5])
def test_markers_of_unit_mass_give_the_information_on_the_angles(joints: int) -> None:
    rng = np.random.default_rng(joints)
    q, centres = rng.normal(size=(40, joints)), random_chain(rng, joints)
    segment = np.repeat(np.arange(joints + 1), 3)
    local = rng.uniform(-0.4, 0.4, size=(len(segment), 2))
    jacobian = planar.marker_jacobian(q, centres, segment, local).reshape(40, -1, joints)
    count = np.bincount(segment).astype(float)
    first = np.array([local[segment == s].sum(axis=0) for s in range(joints + 1)])
    second = np.array([np.sum(local[segment == s] ** 2) for s in range(joints + 1)])
    found = composite_inertia(q, centres, count, first, second)[1]
    np.testing.assert_allclose(found, np.swapaxes(jacobian, 1, 2) @ jacobian, atol=1e-10)


def test_the_mass_matrix_is_one() -> None:
    """Symmetric, positive for a body that can exist, and the same whichever way the whole chain is turned."""
    q = np.random.default_rng(3).normal(size=(30, 3))
    found = composite_inertia(q, CENTRES, *columns(BODY))[1]
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))
    assert np.linalg.eigvalsh(found).min() > 0.0
    turned = composite_inertia(q + np.array([0.7, 0.0, 0.0]), CENTRES, *columns(BODY))[1]
    np.testing.assert_allclose(turned, found, atol=1e-10)


def test_unknown_postures_have_no_inertia() -> None:
    q = np.array([[0.1, 0.2, np.nan], [0.1, 0.2, 0.3]])
    for found in composite_inertia(q, CENTRES, *columns(BODY)):
        assert np.isnan(found[0]).any()
        assert np.isfinite(found[1]).all()
