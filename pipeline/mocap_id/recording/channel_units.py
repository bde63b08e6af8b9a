"""The units of a plate's channels: converted where declared, assumed aloud where missing, refused where nonsense."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.recording.plate_types import UnusablePlateError
from mocap_id.recording.units import bare, force_scale, length_scale, moment_scale

_QUANTITIES = {
    1: ("force",) * 3 + ("point",) * 2 + ("moment",),
    2: ("force",) * 3 + ("moment",) * 3,
    3: ("force",) * 8,
}
"""What the channels measure, by the plate's type; type 4 holds whatever its calibration matrix takes."""

_SCALES: dict[str, Callable[[str], float | None]] = {
    "force": force_scale,
    "point": length_scale,
    "moment": moment_scale,
}


@dataclass(frozen=True)
class ForceUnits:
    """Units of force and moment that the configuration declares in the file's stead; None where it does not.

    Raises
    ------
    ConfigError
        One of them is no such unit.
    """

    force: str | None = None
    moment: str | None = None

    def __post_init__(self) -> None:
        for what, unit, known in (
            ("force", self.force, "N, kN, mN or lbf"),
            ("moment", self.moment, "Nm, Nmm or ft.lbf"),
        ):
            if unit is not None and _SCALES[what](unit) is None:
                raise ConfigError(f"{what}_unit: {unit!r} is no unit of {what}; expected one like {known}")

    def __getitem__(self, quantity: str) -> str | None:
        return {"force": self.force, "moment": self.moment}.get(quantity)

    def factor(self, quantity: str) -> float:
        """SI units per configured unit of ``"force"`` or ``"moment"``; 1 where none is configured."""
        unit = self[quantity]
        scale = None if unit is None else _SCALES[quantity](unit)
        return 1.0 if scale is None else scale

    @property
    def given(self) -> bool:
        """Whether there are any."""
        return self.force is not None or self.moment is not None


@dataclass(frozen=True)
class ChannelScales:
    """Factors to N, m and N·m.

    Parameters
    ----------
    factors : (C,) array
    assumptions : tuple of str
        What the file does not say and was assumed.
    oddities : tuple of str
        What it says oddly.
    """

    factors: FloatArray
    assumptions: tuple[str, ...]
    oddities: tuple[str, ...]


def channel_scales(kind: int, declared: Sequence[str], metres: float, configured: ForceUnits) -> ChannelScales:
    """Find the unit of every channel of a plate of type 1, 2 or 3.

    A unit that is declared and known is converted, channel by channel. One that is missing is that of the other
    channels of the same quantity, or the format's custom: N, and POINT:UNITS for lengths. Where every channel declares
    N, that speaks for the forces alone and the others count as missing.

    Parameters
    ----------
    declared : sequence of str
        ANALOG:UNITS of the channels; empty where there is none.
    metres : float
        Metres per POINT unit.

    Raises
    ------
    UnusablePlateError
        A channel declares a unit that is unknown or of another quantity.
    """
    quantities = np.array(_QUANTITIES[kind])
    names = [bare(name) for name in declared]
    newtons_alone = {force_scale(name) for name in names} == {1.0} and len(set(quantities)) > 1
    factors = np.ones(len(quantities))
    assumptions: list[str] = []
    oddities: list[str] = []
    for quantity in dict.fromkeys(quantities.tolist()):
        at = np.flatnonzero(quantities == quantity)
        own = [names[i] for i in at]
        if (override := configured[quantity]) is not None:
            own, found = _overruled(quantity, own, override)
            oddities += found
        elif newtons_alone and quantity != "force":
            own = [""] * len(own)
        scales = _declared(quantity, own)
        if len(set(scales) - {None}) > 1:
            oddities.append(f"its {quantity} channels declare different units ({', '.join(own)}): each was converted")
        if None in scales:
            force = None if quantity == "force" else float(factors[0])
            assumed, sentence = _assumed(quantity, own, scales, metres, force)
            scales = [assumed if scale is None else scale for scale in scales]
            assumptions.append(sentence)
        factors[at] = np.array(scales, dtype=np.float64)
    return ChannelScales(factors, tuple(assumptions), tuple(oddities))


def _overruled(quantity: str, own: Sequence[str], override: str) -> tuple[list[str], list[str]]:
    """The configuration's unit for all channels, and a note where they declare another."""
    scale = _SCALES[quantity]
    other = sorted({name for name in own if name and scale(name) != scale(override)})
    note = f"its {quantity} channels declare {', '.join(other)}, the configuration says {override}: that was taken"
    return [override] * len(own), [note] if other else []


def _declared(quantity: str, own: Sequence[str]) -> list[float | None]:
    """SI factor by channel, None where no unit is declared."""
    scales = [_SCALES[quantity](name) for name in own]
    wrong = sorted({name for name, scale in zip(own, scales, strict=True) if name and scale is None})
    if wrong:
        remedy = (
            f"say `planarise: {{{quantity}_unit: …}}` in the configuration if you know it"
            if quantity != "point"
            else "export the file again with the units of its channels"
        )
        raise UnusablePlateError(
            f"its {quantity} channels declare {', '.join(map(repr, wrong))}, which is no known unit of "
            f"{'length' if quantity == 'point' else quantity}; {remedy}"
        )
    return scales


def _assumed(
    quantity: str, own: Sequence[str], scales: Sequence[float | None], metres: float, force: float | None
) -> tuple[float, str]:
    """Factor for channels that declare no unit, and the sentence that says so."""
    known = {scale: name for scale, name in zip(scales, own, strict=True) if scale is not None}
    if len(known) > 1:
        raise UnusablePlateError(
            f"some of its {quantity} channels declare no unit, the others {', '.join(known.values())}; say "
            f"`planarise: {{{quantity}_unit: …}}` in the configuration"
        )
    length = {1e-3: "mm", 1e-2: "cm", 1.0: "m", 0.0254: "in"}[metres]
    if known:
        ((scale, name),) = known.items()
        return float(scale), f"some of its {quantity} channels declare no unit: {name} was assumed, as of the others"
    if quantity == "point":
        return metres, f"its centre-of-pressure channels declare no unit of length: {length} was assumed"
    if quantity == "moment" and force != 1.0:
        raise UnusablePlateError(
            "its moment channels declare no unit of moment, and its forces are not in N; say "
            "`planarise: {moment_unit: …}` in the configuration"
        )
    unit, scale = ("N", 1.0) if quantity == "force" else (f"N·{length}", metres)
    return scale, f"its {quantity} channels declare no unit of {quantity}: {unit} was assumed"
