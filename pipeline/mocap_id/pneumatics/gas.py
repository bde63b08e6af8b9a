"""Gas that a change of the setting takes from the supply, and how many changes a reservoir allows."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.pneumatics.cylinder import Cylinder, Setting

_GAS_CONSTANT = 287.05  # J/(kg K), dry air
_NORMAL_DENSITY = 1.2929  # kg/m³, air at 0 °C and 101,325 Pa


def gas_of_change(cylinder: Cylinder, before: Setting, after: Setting, temperature: float = 293.15) -> float:
    """Return the gas for a change of the setting, kg; a chamber that loses pressure vents and takes none.

    The content of a chamber is P₀V₀/RT, whatever the angle at which the setting is changed. The hoses between valve
    and supply are not counted.

    Parameters
    ----------
    cylinder : Cylinder
    before, after : Setting
        An open chamber has the pressure of the atmosphere at full flexion.
    temperature : float
        K.
    """
    change = _sealed(after, cylinder) - _sealed(before, cylinder)
    volumes = cylinder.volumes(np.asarray(cylinder.full_flexion))
    return float(np.maximum(change, 0.0) @ volumes / (_GAS_CONSTANT * temperature))


def normal_litres(gas: float) -> float:
    """Return the volume of a mass of air, kg, at 0 °C and 101,325 Pa, in litres."""
    return 1e3 * gas / _NORMAL_DENSITY


def usable_gas(volume: float, pressure: float, supply: float, temperature: float = 293.15) -> float:
    """Return the gas, kg, that a reservoir (m³, Pa) gives before it falls to the supply's pressure, Pa."""
    return max(pressure - supply, 0.0) * volume / (_GAS_CONSTANT * temperature)


def _sealed(setting: Setting, cylinder: Cylinder) -> FloatArray:
    given = (setting.flexion, setting.extension)
    return np.array([cylinder.atmosphere if pressure is None else pressure for pressure in given])
