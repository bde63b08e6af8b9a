"""Configuration of a pneumatic device on one joint."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mocap_id.config.parsing import Source, parse, raise_mistakes, read_source, suggest_name
from mocap_id.errors import ConfigError
from mocap_id.stages.device import Condition, DeviceFile


@dataclass(frozen=True)
class DeviceConfig:
    """The checked configuration of a device, and its source for messages."""

    keys: DeviceFile
    source: Source

    def condition(self, name: str | None) -> Condition:
        """Return the condition called ``name``, or that of `sealed:` if it is None; ConfigError if it is unknown."""
        if name is None:
            return self.keys.sealed
        if name not in self.keys.conditions:
            known = list(self.keys.conditions)
            hint = suggest_name(name, known) if known else "`conditions:` has none"
            raise ConfigError(f"{self.source.where(('conditions',))}: there is no condition `{name}`: {hint}")
        return self.keys.conditions[name]


def load_device(file: Path) -> DeviceConfig:
    """Read and check a device's YAML file.

    Raises ConfigError with one line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read_source(file.absolute())
    parsed = parse(source, DeviceFile, "keys such as `device:`, `pulley_radius_m:` and `stroke_m:`")
    # pressures that contradict another key
    mistakes = []
    if parsed.supply_Pa <= parsed.atmosphere_Pa:
        mistakes.append(
            f"{source.where(('supply_Pa',))}: the supply, {parsed.supply_Pa:g} Pa, is not above the atmosphere, "
            f"{parsed.atmosphere_Pa:g} Pa: pressures are absolute (gauge pressure plus the pressure of the atmosphere)"
        )
    conditions: dict[tuple[str, ...], Condition] = {("sealed",): parsed.sealed}
    conditions |= {("conditions", name): condition for name, condition in parsed.conditions.items()}
    for location, condition in conditions.items():
        for side in ("flexion_Pa", "extension_Pa"):
            pressure = getattr(condition, side)
            if not isinstance(pressure, str) and not 0 < pressure <= parsed.supply_Pa * (1 + 1e-9):
                mistakes.append(
                    f"{source.where((*location, side))}: `{side}` is {pressure:g}, expected an absolute pressure "
                    f"above 0, up to the supply's {parsed.supply_Pa:g} Pa"
                )
    raise_mistakes(mistakes)
    return DeviceConfig(parsed, source)
