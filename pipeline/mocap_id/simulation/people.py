"""What real people have and a pinned chain has not: a hip that gives, a spine, arms, heels, a weight in the hands."""

from __future__ import annotations

from dataclasses import dataclass, fields

from mocap_id.errors import ConfigError


@dataclass(frozen=True)
class People:
    """How far a simulated person differs from four rigid segments on pins; all zero is no difference.

    Ranges hold approximately for a sit-to-stand: the seed makes some repetitions wider than others.

    Parameters
    ----------
    hip_gap_mm : float
        Range of the torso's displacement against the thigh's hip centre, mm; real people 6 to 16.
    lumbar_deg : float
        Range of the trunk's rotation against the pelvis, degrees; real people 10 to 20.
    arm_swing_deg : float
        Range of the arms' swing about the shoulders, degrees.
    heel_lift_mm : float
        Height to which the heel comes up while the person rises; the foot turns about the toes, mm.
    held_mass_kg : float
        A weight in the hands, kg; the person's own mass stays what it is.

    Raises
    ------
    ConfigError
        A value is out of range.
    """

    hip_gap_mm: float = 0.0
    lumbar_deg: float = 0.0
    arm_swing_deg: float = 0.0
    heel_lift_mm: float = 0.0
    held_mass_kg: float = 0.0

    def __post_init__(self) -> None:
        limits = (
            ("hip_gap_mm", self.hip_gap_mm, 40, "mm"),
            ("lumbar_deg", self.lumbar_deg, 40, "degrees"),
            ("arm_swing_deg", self.arm_swing_deg, 120, "degrees"),
            ("heel_lift_mm", self.heel_lift_mm, 60, "mm"),
            ("held_mass_kg", self.held_mass_kg, 20, "kg"),
        )
        for name, value, most, unit in limits:
            if not 0 <= value <= most:
                raise ConfigError(f"simulate: people: {name} is {value!r}; expected 0 … {most} {unit}")

    @property
    def differ(self) -> bool:
        """Whether anything is asked for."""
        return self != People()


def read_people(text: str) -> People:
    """People from text such as ``hip_gap_mm=10,held_mass_kg=2``; empty text asks for nothing.

    Raises
    ------
    ConfigError
        Something is no pair of a name and a number, stands twice or is out of range.
    """
    names = [each.name for each in fields(People)]
    values: dict[str, float] = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = (part.strip() for part in pair.partition("="))
        if name not in names or name in values:
            raise ConfigError(f"simulate: people: {pair!r} is not expected; expected each once: {', '.join(names)}")
        try:
            values[name] = float(number)
        except ValueError:
            raise ConfigError(f"simulate: people: {name} is {number!r}; expected a number") from None
    return People(**values)
