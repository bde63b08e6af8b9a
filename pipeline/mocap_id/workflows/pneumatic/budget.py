"""Gas for each change between the conditions of a device."""

from __future__ import annotations

import itertools
from typing import Any

from mocap_id.config.device import DeviceConfig
from mocap_id.errors import ConfigError
from mocap_id.pneumatics.gas import gas_of_change, normal_litres, usable_gas


def gas_budget(config: DeviceConfig) -> dict[str, Any]:
    """Return the gas of every change between two worn conditions, and how often a reservoir allows each.

    Raises
    ------
    ConfigError
        There are fewer than two worn conditions.
    """
    keys = config.keys
    worn = {name: one.setting() for name, one in keys.conditions.items() if one.worn}
    if len(worn) < 2:
        where = config.source.where(("conditions",))
        raise ConfigError(f"{where}: a budget needs at least two worn conditions in `conditions:`, found {len(worn)}")
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
