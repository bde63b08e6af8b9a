"""Configuration of a pneumatic device on one joint."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap_id.config.parsing import json_schema, nearest, parse, raise_mistakes
from mocap_id.config.source import Source, read
from mocap_id.errors import ConfigError
from mocap_id.stages.device import Condition, DeviceFile


@dataclass(frozen=True)
class DeviceConfig:
    """A checked configuration and its source, for messages."""

    keys: DeviceFile
    source: Source

    def condition(self, name: str | None) -> Condition:
        """Return a named condition, or `sealed:` without a name.

        Raises
        ------
        ConfigError
            There is no condition of this name.
        """
        if name is None:
            return self.keys.sealed
        if name not in self.keys.conditions:
            known = list(self.keys.conditions)
            hint = nearest(name, known) if known else "`conditions:` has none"
            raise ConfigError(f"{self.source.where(('conditions',))}: there is no condition `{name}`: {hint}")
        return self.keys.conditions[name]


def load_device(file: Path) -> DeviceConfig:
    """Read and check a device's YAML file.

    Raises
    ------
    ConfigError
        One line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read(file.absolute())
    parsed = parse(source, DeviceFile, "keys such as `device:`, `pulley_radius_m:` and `stroke_m:`")
    raise_mistakes(_contradictions(parsed, source))
    return DeviceConfig(parsed, source)


def device_schema() -> dict[str, Any]:
    """Return the JSON Schema of a device's YAML file, for editors."""
    return json_schema(DeviceFile)


def _contradictions(keys: DeviceFile, source: Source) -> list[str]:
    """Return mistakes that no single key shows."""
    wrong = []
    if keys.supply_Pa <= keys.atmosphere_Pa:
        wrong.append(
            f"{source.where(('supply_Pa',))}: the supply's {keys.supply_Pa:g} Pa are not above the atmosphere's "
            f"{keys.atmosphere_Pa:g} Pa: pressures are absolute (gauge pressure plus that of the atmosphere)"
        )
    places = {("sealed",): keys.sealed} | {("conditions", name): one for name, one in keys.conditions.items()}
    for place, one in places.items():
        for side in ("flexion_Pa", "extension_Pa"):
            pressure = getattr(one, side)
            if not isinstance(pressure, str) and not 0 < pressure <= keys.supply_Pa * (1 + 1e-9):
                wrong.append(
                    f"{source.where((*place, side))}: `{side}` is {pressure:g}, expected an absolute pressure above 0 "
                    f"and up to that of the supply, {keys.supply_Pa:g} Pa"
                )
    return wrong
