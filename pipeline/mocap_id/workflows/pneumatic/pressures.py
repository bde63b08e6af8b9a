"""Pressures with which a device best approximates a prescribed spring, and gas for changes between conditions."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from mocap_id.config.device import DeviceConfig
from mocap_id.errors import ConfigError
from mocap_id.pneumatics.cylinder import gas_of_change, normal_litres, usable_gas
from mocap_id.pneumatics.nearest_spring import NearestSpring, find_nearest_setting
from mocap_id.reporting.results.columns import to_finite

_GRID = 361


def spring_pressures(
    config: DeviceConfig, stiffness: float, rest: float, span: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Return the pressures with which a device best approximates a spring, and the spring that results.

    ConfigError is raised if the stiffness is not above zero, or the range is empty or beyond the stroke.

    Parameters
    ----------
    config : DeviceConfig
    stiffness, rest : float
        Stiffness, N·m/rad, and rest angle, rad, of the spring.
    span : (low, high), optional
        Range in which both torques should agree, rad; by default, they should agree near the rest angle.
    """
    if not 0 < stiffness < np.inf or not np.isfinite(rest):
        raise ConfigError(
            f"the spring has {stiffness:g} N·m/rad and a rest angle of {rest:g} rad; expected a stiffness above zero "
            "and a finite rest angle"
        )
    if span is not None and not span[0] < span[1]:
        raise ConfigError(
            f"the range {span[0]:g} to {span[1]:g} rad is empty: the first angle must be below the second"
        )
    angles = None if span is None else np.linspace(*span, _GRID)
    keys = config.keys
    try:
        nearest = find_nearest_setting(keys.cylinder(), stiffness, rest, keys.limits(), angles)
    except ValueError as error:
        raise ConfigError(f"{keys.device}: {error}") from error
    return {"device": keys.device, **spring_document(nearest)}


def spring_document(spring: NearestSpring) -> dict[str, Any]:
    """Return the approximation of a spring by a device as JSON values."""
    return {
        "flexion_Pa": spring.setting.flexion,
        "extension_Pa": spring.setting.extension,
        "achieved": {
            "stiffness_Nm_rad": to_finite(spring.stiffness),
            "rest_angle_rad": to_finite(spring.rest),
            "range_rad": list(spring.range),
            "largest_torque_error_Nm": spring.largest_error,
            "rms_torque_error_Nm": spring.rms_error,
        },
        "why": spring.why,
    }


def gas_budget(config: DeviceConfig) -> dict[str, Any]:
    """Return the gas of each change between two worn conditions, and how often a reservoir allows this change.

    ConfigError is raised if the device is worn in fewer than two conditions.
    """
    keys = config.keys
    worn = {name: one.setting() for name, one in keys.conditions.items() if one.worn}
    if len(worn) < 2:
        where = config.source.where(("conditions",))
        raise ConfigError(f"{where}: a budget needs at least two worn conditions in `conditions:`; found {len(worn)}")
    cylinder, store = keys.cylinder(), keys.reservoir
    usable = (
        None if store is None else usable_gas(store.volume_m3, store.pressure_Pa, keys.supply_Pa, keys.temperature_K)
    )
    changes = []
    for before, after in itertools.permutations(worn, 2):
        gas = gas_of_change(cylinder, worn[before], worn[after], keys.temperature_K)
        changes.append(
            {
                "from": before,
                "to": after,
                "gas_g": 1e3 * gas,
                "normal_litres": normal_litres(gas),
                "changes_per_reservoir": None if usable is None or gas == 0 else int(usable / gas),
            }
        )
    return {"device": keys.device, "reservoir_g": None if usable is None else 1e3 * usable, "changes": changes}
