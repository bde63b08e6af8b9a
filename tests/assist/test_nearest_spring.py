"""Pressures for a spring: an attainable spring is reproduced; for any other, the nearest spring is given."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mocap_id.dynamics.cylinder import Cylinder, PressureLimits, Setting
from mocap_id_assist.devices import find_nearest_setting, gas_of_change, normal_litres

LIMITS = PressureLimits(101_325.0, 7e5)
cylinders = st.builds(
    Cylinder,
    pulley_radius=st.floats(0.02, 0.05),
    area_flexion=st.floats(2e-4, 8e-4),
    area_extension=st.floats(2e-4, 8e-4),
    dead_flexion=st.floats(0.02, 0.1),
    dead_extension=st.floats(0.02, 0.1),
    stroke=st.floats(0.05, 0.12),
    full_flexion=st.just(2.4),
    exponent=st.floats(1.0, 1.4),
)
pressures = st.floats(1.05e5, 6.9e5)


@settings(max_examples=80, deadline=None)
@given(cylinders, pressures, pressures)
@example(Cylinder(0.0234375, 2e-4, 2e-4, 0.0625, 0.09375, 0.0625, 2.4, 1.25), 1.05e5, 1.05e5)  # at rest fully flexed
def test_an_attainable_spring_is_reproduced(cylinder: Cylinder, flexion: float, extension: float) -> None:
    rest = cylinder.rest_angle(Setting(flexion, extension))
    if rest is None:
        return
    stiffness = float(cylinder.stiffness(np.array(rest), Setting(flexion, extension)))
    found = find_nearest_setting(cylinder, stiffness, rest, LIMITS)
    assert found.setting.pressures() == pytest.approx([flexion, extension], rel=1e-6)
    assert (found.stiffness, found.rest, found.why) == (pytest.approx(stiffness), pytest.approx(rest), "")


def test_over_a_range_no_other_pressures_are_nearer() -> None:
    cylinder = Cylinder(0.03, 2.8e-4, 2.5e-4, 0.05, 0.05, 0.08, 2.4, 1.2)
    angles = np.linspace(0.5, 2.0, 50)
    side = np.linspace(LIMITS.lowest, LIMITS.supply, 31)
    for stiffness, rest in ((1.5, 1.4), (3.0, 1.0), (0.7, 5.0), (20.0, 1.2)):
        found = find_nearest_setting(cylinder, stiffness, rest, LIMITS, angles)
        errors = [
            np.sqrt(np.mean((cylinder.torque(angles, Setting(a, b)) + stiffness * (angles - rest)) ** 2))
            for a in side.tolist()
            for b in side.tolist()
        ]
        assert found.rms_error <= min(errors) + 1e-9
        assert found.largest_error >= found.rms_error


def test_what_is_not_attainable_is_told() -> None:
    cylinder = Cylinder(0.03, 2.8e-4, 2.5e-4, 0.05, 0.05, 0.08, 2.4, 1.2)
    stiff = find_nearest_setting(cylinder, 20.0, 1.2, LIMITS)
    assert stiff.setting.pressures().max() == pytest.approx(LIMITS.supply)
    assert "would need" in stiff.why
    assert stiff.stiffness < 20.0
    far = find_nearest_setting(cylinder, 1.0, 6.0, LIMITS)
    assert "beyond the stroke" in far.why
    with pytest.raises(ValueError, match="no angle of the range"):
        find_nearest_setting(cylinder, 1.0, 1.0, LIMITS, np.array([5.0]))


def test_gas_of_a_change() -> None:
    cylinder = Cylinder(0.03, 3e-4, 3e-4, 0.0, 0.0, 0.1, 2.4)  # 30 ml on the flexion side
    gas = gas_of_change(cylinder, Setting(None, None), Setting(2 * 101_325.0, None), 273.15)
    assert normal_litres(gas) == pytest.approx(0.030, rel=1e-3)
    assert gas_of_change(cylinder, Setting(4e5, 2e5), Setting(2e5, None)) == 0.0
