"""Laws of a cylinder as a spring: energy, limits of the exponent, symmetry, stiffness; the simulated device."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from mocap_id.config.device import load_device
from mocap_id.dynamics.cylinder import ADIABATIC, ISOTHERMAL, Cylinder, Setting, compute_torque_and_sd

ROOT = Path(__file__).resolve().parents[2]
ELBOW = Cylinder(0.03, 2.8e-4, 2.5e-4, 0.05, 0.07, 0.08, 2.4, 1.2, 0.2, 0.02)
FIVE = Setting(446e3, 101_325.0)
cylinders = st.builds(
    Cylinder,
    pulley_radius=st.floats(0.01, 0.08),
    area_flexion=st.floats(5e-5, 2e-3),
    area_extension=st.floats(5e-5, 2e-3),
    dead_flexion=st.floats(0.005, 0.2),
    dead_extension=st.floats(0.005, 0.2),
    stroke=st.floats(0.02, 0.2),
    full_flexion=st.floats(-1.0, 3.0),
    exponent=st.floats(ISOTHERMAL, ADIABATIC),
)
pressure = st.none() | st.floats(2e4, 1e6)
states = st.builds(Setting, flexion=pressure, extension=pressure)


@settings(max_examples=60, deadline=None)
@given(cylinders, states, st.floats(0.02, 0.98))
def test_stiffness_is_the_slope_of_the_torque(cylinder: Cylinder, setting: Setting, share: float) -> None:
    low, high = cylinder.limits
    at, step = low + share * (high - low), 1e-5 * (high - low)
    one, other = cylinder.torque(np.array([at - step, at + step]), setting)
    stiffness = float(cylinder.stiffness(np.array(at), setting))
    assert (one - other) / (2 * step) == pytest.approx(stiffness, rel=1e-5, abs=1e-6)
    assert stiffness >= 0


@settings(max_examples=60, deadline=None)
@given(cylinders, st.builds(Setting, flexion=st.floats(2e4, 1e6), extension=st.floats(2e4, 1e6)))
def test_the_work_is_that_of_the_gas(cylinder: Cylinder, setting: Setting) -> None:
    """From full flexion to full extension: P₀V₀ ((V₀/V)ⁿ⁻¹ - 1) / (n - 1), or P₀V₀ ln(V₀/V), and the atmosphere."""
    low, high = cylinder.limits
    work, _ = quad(lambda angle: float(cylinder.torque(np.array(angle), setting)), low, high)
    start, end = cylinder.volumes(np.array(high)), cylinder.volumes(np.array(low))
    n = cylinder.exponent
    factor = np.log(start / end) if n - 1 < 1e-6 else np.expm1((n - 1) * np.log(start / end)) / (n - 1)
    stored = float(setting.pressures() @ (start * factor)) + cylinder.atmosphere * float((end - start).sum())
    assert work == pytest.approx(stored, rel=1e-5, abs=1e-4)


def test_a_closed_cycle_loses_only_friction() -> None:
    phase = np.linspace(0, 2 * np.pi, 20_001)
    angle, velocity = 1.2 + np.sin(phase), np.cos(phase)
    torque = ELBOW.torque(angle, FIVE)
    assert np.trapezoid(torque, angle) == pytest.approx(0, abs=1e-6)
    dry = replace(ELBOW, viscous=0.0)
    lost = np.trapezoid(torque + dry.friction(velocity), angle)
    assert lost == pytest.approx(-4 * dry.coulomb, rel=0.01)  # the way is four amplitudes
    wet = replace(ELBOW, coulomb=0.0)
    assert np.trapezoid(wet.friction(velocity), angle) == pytest.approx(-np.pi * wet.viscous, rel=1e-6)


def test_slow_and_fast_changes_of_volume() -> None:
    angle = np.linspace(*ELBOW.limits, 50)
    volumes = ELBOW.volumes(angle)
    for n in (ISOTHERMAL, ADIABATIC):
        constant = ELBOW.at_exponent(n).compression(angle) * volumes**n
        np.testing.assert_allclose(constant, np.broadcast_to(constant[-1], constant.shape))
    slow, fast = (ELBOW.at_exponent(n).stiffness(angle[-1], FIVE) for n in (ISOTHERMAL, ADIABATIC))
    assert fast == pytest.approx(1.4 * slow)


@settings(max_examples=30, deadline=None)
@given(cylinders, st.floats(1.1e5, 8e5), st.floats(0.0, 0.5))
def test_equal_sides_are_symmetrical_about_the_middle(cylinder: Cylinder, pressure: float, share: float) -> None:
    even = replace(cylinder, area_extension=cylinder.area_flexion, dead_extension=cylinder.dead_flexion)
    low, high = even.limits
    middle, off = 0.5 * (low + high), share * (high - low)
    setting = Setting(*(pressure / even.compression(np.array(middle))))
    one, other = even.torque(np.array([middle - off, middle + off]), setting)
    assert one == pytest.approx(-other, abs=1e-6 * pressure * even.area_flexion * even.pulley_radius)
    assert even.rest_angle(setting) == pytest.approx(middle, abs=1e-9)


def test_open_chambers_are_no_spring() -> None:
    angle = np.linspace(*ELBOW.limits, 20)
    assert not ELBOW.torque(angle, Setting(None, None)).any()
    assert not ELBOW.stiffness(angle, Setting(None, None)).any()
    assert np.isnan(ELBOW.torque(np.array([ELBOW.limits[0] - 0.01, ELBOW.limits[1] + 0.01]), FIVE)).all()


def test_the_deviation_is_that_of_random_devices() -> None:
    angle, rng = np.linspace(0.0, 2.0, 9), np.random.default_rng(0)
    deviations = {"area_flexion": 5e-6, "dead_flexion": 0.004, "full_flexion": 0.03, "exponent": 0.03, "gauge": 3e3}
    _, deviation = compute_torque_and_sd(ELBOW, FIVE, angle, deviations, np.full(9, 1.0), 0.02)
    drawn = []
    for _ in range(800):
        sizes = {k: getattr(ELBOW, k) + s * rng.normal() for k, s in deviations.items() if k != "gauge"}
        setting = Setting(*(FIVE.pressures() + 3e3 * rng.normal(size=2)).tolist())
        drawn.append(replace(ELBOW, **sizes).torque(angle + 0.02 * rng.normal(), setting))
    np.testing.assert_allclose(np.nanstd(drawn, axis=0), deviation, rtol=0.12)


def test_the_device_of_the_simulated_curls(recordings: Path) -> None:
    folder = recordings / "simulated-arm" / "curl-5"
    true = json.loads((folder / "truth.json").read_text("utf-8"))["device"]
    names = ("pulley_radius_m", "area_flexion_m2", "area_extension_m2", "dead_flexion_m", "dead_extension_m")
    more = ("stroke_m", "q_full_rad", "polytropic_n", "friction_coulomb_Nm", "friction_viscous_Nms", "P_atm")
    cylinder = Cylinder(*(true[name] for name in (*names, *more)))
    setting = Setting(true["P_flexion_sealed"], true["P_extension_sealed"])
    with np.load(folder / "truth.npz") as truth:
        hinge, torque = truth["q_hinge"], truth["tau_device"]
    np.testing.assert_allclose(cylinder.torque(hinge[:, 0], setting) + cylinder.friction(hinge[:, 1]), torque)
    described = load_device(ROOT / "configs" / "devices" / "elbow.yaml")  # another device of this kind
    found, deviation = described.keys.torque(described.condition("5"), hinge[:, 0], hinge[:, 1])
    assert (np.abs(found - torque) < 1.96 * deviation).all()
    assert not described.keys.torque(described.condition("C"), hinge[:, 0])[0].any()
