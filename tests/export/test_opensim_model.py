"""The OpenSim model as XML: it is the chain of the run, with the same physics."""

from __future__ import annotations

from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.workflows.export.opensim_model import convert_planar_inertia


def vector(node: ElementTree.Element, path: str) -> np.ndarray:
    text = node.findtext(path)
    assert text is not None
    return np.array([float(word) for word in text.split()])


@pytest.fixture
def model(exported) -> ElementTree.Element:
    found = ElementTree.parse(exported().file(".osim")).getroot().find("Model")
    assert found is not None
    return found


def test_masses_add_up_and_no_body_is_impossible(model: ElementTree.Element, exported) -> None:
    bodies = model.findall("BodySet/objects/Body")
    with h5py.File(exported().run / "dynamics.h5") as file:
        full = np.asarray(file["full/value"]).reshape(-1, 4)
        total = np.asarray(file["base/value"])[0]
    masses = np.array([vector(body, "mass")[0] for body in bodies])
    assert masses.sum() == pytest.approx(full[:, 0].sum(), rel=1e-12)
    assert masses.sum() == pytest.approx(total, rel=1e-6)  # the first base parameter is the whole mass
    for body in bodies:
        ixx, iyy, izz, *products = vector(body, "inertia")
        assert vector(body, "mass")[0] > 0
        assert min(ixx, iyy, izz) >= 0
        assert max(ixx, iyy, izz) <= ixx + iyy + izz - max(ixx, iyy, izz) + 1e-12
        assert products == [0.0, 0.0, 0.0]


def test_inertia_about_the_centre_of_mass_is_the_runs_about_the_origin(model: ElementTree.Element, exported) -> None:
    with h5py.File(exported().run / "dynamics.h5") as file:
        full = np.asarray(file["full/value"]).reshape(-1, 4)
    for body, (_, mx, my, inertia) in zip(model.findall("BodySet/objects/Body"), full, strict=True):
        centre = vector(body, "mass_center")
        np.testing.assert_allclose(vector(body, "mass")[0] * centre, [mx, my, 0.0], atol=1e-9)
        about = vector(body, "inertia")[2] + vector(body, "mass")[0] * centre @ centre
        assert about == pytest.approx(inertia, abs=1e-9)


def test_joints_and_markers_are_the_chains(model: ElementTree.Element, exported) -> None:
    with h5py.File(exported().run / "chain.h5") as file:
        centres, local = np.asarray(file["joints/centre"]), np.asarray(file["markers/local"])
        segment = np.asarray(file["markers/segment"])
    pins = model.findall("JointSet/objects/PinJoint")
    found = np.array([vector(pin, "frames/PhysicalOffsetFrame/translation") for pin in pins])
    np.testing.assert_allclose(found[:, :2], centres, atol=1e-15)
    markers = model.findall("MarkerSet/objects/Marker")
    np.testing.assert_allclose([vector(marker, "location")[:2] for marker in markers], local, atol=1e-15)
    parents = [marker.findtext("socket_parent_frame") for marker in markers]
    bodies = [f"/bodyset/{body.get('name')}" for body in model.findall("BodySet/objects/Body")]
    assert parents == [bodies[k] for k in segment]


def test_the_base_is_held_at_the_plane_frame(model: ElementTree.Element) -> None:
    base = model.find("JointSet/objects/PlanarJoint")
    assert base is not None
    coordinates = base.findall("coordinates/Coordinate")
    assert [each.findtext("locked") for each in coordinates] == ["true"] * 3
    assert [vector(each, "default_value")[0] for each in coordinates] == [0.0] * 3


def test_the_model_says_where_its_masses_come_from(exported) -> None:
    text = exported().file(".osim").read_text("utf-8")
    assert "base parameters" in text
    assert "placeholders" in exported(False).file(".osim").read_text("utf-8")


@settings(deadline=None)  # the first example waits for what the others find there
@given(
    body=st.tuples(st.floats(0.1, 50), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0, 5)),
    motion=st.tuples(st.floats(-3, 3), st.floats(-5, 5), st.floats(-20, 20)),
)
def test_both_forms_need_the_same_moment(body: tuple[float, ...], motion: tuple[float, ...]) -> None:
    """Compares Newton's and Euler's equations about the centre of mass with the regressor about the origin."""
    mass, x, y, own = body
    angle, speed, acceleration = motion
    block = np.array([mass, mass * x, mass * y, own + mass * (x * x + y * y)])
    total, centre, inertia = convert_planar_inertia(block)
    states = (np.array([[value]]) for value in motion)
    needed = planar_regressor(np.zeros((1, 2)), *states, 9.81)[0, :, 4:] @ block
    c, s = np.cos(angle), np.sin(angle)
    arm = np.array([c * centre[0] - s * centre[1], s * centre[0] + c * centre[1]])
    force = total * (acceleration * np.array([-arm[1], arm[0]]) - speed**2 * arm + np.array([0.0, 9.81]))
    moment = inertia[2] * acceleration + arm[0] * force[1] - arm[1] * force[0]
    np.testing.assert_allclose([*force, moment], needed, rtol=1e-9, atol=1e-7)


def test_a_body_without_mass_can_still_be_loaded() -> None:
    mass, _, inertia = convert_planar_inertia(np.zeros(4))
    assert mass > 0
    assert inertia[2] == 0
    assert convert_planar_inertia(np.array([0.0, 0.0, 0.0, 0.02]))[2][2] == 0.02, (
        "a wheel without mass still resists turning"
    )


def test_rounding_does_not_make_an_inertia_negative() -> None:
    assert convert_planar_inertia(np.array([1.0, 0.0, 0.1, 0.01 * (1 - 1e-15)]))[2][2] >= 0
