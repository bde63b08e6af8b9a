"""Units: conversion factors to SI, and units of force-plate channels that are declared, configured or assumed."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.recording.plate_types import UnusablePlateError

LENGTHS: dict[str, float] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 1e-2),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1e-3),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
}
"""Metres per length unit, by name."""

FORCES: dict[str, float] = {
    **dict.fromkeys(("n", "nt", "newt", "newto", "newton", "newtons"), 1.0),
    **dict.fromkeys(("kn", "kilonewton", "kilonewtons"), 1e3),
    **dict.fromkeys(("dan", "decanewton", "decanewtons"), 10.0),
    **dict.fromkeys(("millinewton", "millinewtons"), 1e-3),
    **dict.fromkeys(("lb", "lbs", "lbf", "pound", "pounds"), 4.4482216152605),
    **dict.fromkeys(("kgf", "kp", "kilopond"), 9.80665),
}
"""Newtons per force unit, by lower-case name, including truncated forms of ``newton``."""

_FEET = dict.fromkeys(("ft", "foot", "feet"), 0.3048)
_ARMS: dict[str, float] = {**LENGTHS, **_FEET}

_SHORTEST_PREFIX = 3


_TIMES = r"[\s.*·x-]"

_QUANTITIES = {
    1: ("force",) * 3 + ("point",) * 2 + ("moment",),
    2: ("force",) * 3 + ("moment",) * 3,
    3: ("force",) * 8,
}
"""Quantity of each channel, by plate type. The channels of type 4 are inputs of a calibration matrix."""


def find_length_scale(declared: str) -> float | None:
    """Return the size of a declared unit of length, m; None if the name is empty, unknown or ambiguous.

    C3D files truncate strings. A prefix of at least three letters is accepted if all matching names are the same unit.

    Examples
    --------
    >>> find_length_scale("MM"), find_length_scale("mete"), find_length_scale("furlong")
    (0.001, 1.0, None)
    """
    name = strip_padding(declared).strip("()").lower()
    if name in LENGTHS:
        return LENGTHS[name]
    if len(name) < _SHORTEST_PREFIX:
        return None
    meanings = {scale for full, scale in LENGTHS.items() if full.startswith(name)}
    return meanings.pop() if len(meanings) == 1 else None


def check_length_unit(units: str) -> float:
    """Return the size of the unit of length in the user's setting ``units``, m; ConfigError if it is unknown."""
    scale = find_length_scale(units)
    if scale is None:
        raise ConfigError(f"units: {units!r} is not a unit of length; expected one of {', '.join(LENGTHS)}")
    return scale


def find_force_scale(declared: str) -> float | None:
    """Return the size of a declared unit of force, N; None if the name is empty or not a unit of force.

    Examples
    --------
    >>> find_force_scale("N"), find_force_scale("lbf"), find_force_scale("V")
    (1.0, 4.4482216152605, None)
    """
    return FORCES.get(_fold_case(declared))


def find_moment_scale(declared: str) -> float | None:
    """Return the size of a declared unit of moment, N·m; None if the name is empty or not a unit of moment.

    The name consists of a unit of force and a unit of length, with or without a separator. The length may come first;
    without a separator only feet and inches may, because ``mN`` is a millinewton.

    Examples
    --------
    >>> find_moment_scale("N.mm"), round(find_moment_scale("ft-lb"), 4), find_moment_scale("N")
    (0.001, 1.3558, None)
    """
    match = _MOMENT.fullmatch(_fold_case(declared))
    if match is None:
        return None
    force = match["force"] or match["second_force"] or match["last_force"]
    arm = match["arm"] or match["first_arm"] or match["feet"]
    return FORCES[force] * _ARMS[arm]


def strip_padding(declared: str) -> str:
    """Return a text field without blanks and NUL characters at its ends."""
    return declared.strip().strip("\x00").strip()


def _fold_case(declared: str) -> str:
    """Convert a unit to lower case; ``mN`` becomes ``millinewton``, so that it differs from ``MN``."""
    return re.sub("^mN", "millinewton", strip_padding(declared)).lower()


def _join_names(names: dict[str, float]) -> str:
    return "|".join(sorted(names, key=len, reverse=True))


_IMPERIAL = _join_names({**_FEET, **dict.fromkeys(("in", "inch", "inches"), 0.0254)})
_MOMENT = re.compile(
    rf"(?P<force>{_join_names(FORCES)}){_TIMES}*(?P<arm>{_join_names(_ARMS)})"
    rf"|(?P<first_arm>{_join_names(_ARMS)}){_TIMES}+(?P<second_force>{_join_names(FORCES)})"
    rf"|(?P<feet>{_IMPERIAL})(?P<last_force>{_join_names(FORCES)})"
)


_SCALES: dict[str, Callable[[str], float | None]] = {
    "force": find_force_scale,
    "point": find_length_scale,
    "moment": find_moment_scale,
}


@dataclass(frozen=True)
class ForceUnits:
    """Configured units of force and moment, which replace the units in the file; None if not configured.

    Raises ConfigError if a unit is unknown.
    """

    force: str | None = None
    moment: str | None = None

    def __post_init__(self) -> None:
        for what, unit, known in (
            ("force", self.force, "N, kN, mN or lbf"),
            ("moment", self.moment, "Nm, Nmm or ft.lbf"),
        ):
            if unit is not None and _SCALES[what](unit) is None:
                raise ConfigError(f"{what}_unit: {unit!r} is not a unit of {what}; expected a unit such as {known}")

    def __getitem__(self, quantity: str) -> str | None:
        return {"force": self.force, "moment": self.moment}.get(quantity)

    def factor(self, quantity: str) -> float:
        """Return the size of the configured unit of ``"force"`` or ``"moment"`` in SI units; 1 if there is none."""
        unit = self[quantity]
        scale = None if unit is None else _SCALES[quantity](unit)
        return 1.0 if scale is None else scale

    @property
    def configured(self) -> bool:
        """Whether a unit is configured."""
        return self.force is not None or self.moment is not None


def find_channel_scales(
    kind: int, declared: Sequence[str], metres: float, configured: ForceUnits
) -> tuple[FloatArray, list[str], list[str]]:
    """Return the factors (C,) that convert the channels of a plate of type 1, 2 or 3 to N, m and N·m.

    Sentences follow about units that were assumed because the file does not declare them, and about contradictions.

    ``declared`` are the ANALOG:UNITS of the channels, empty if undeclared; ``metres`` is the size of POINT:UNITS, m.
    Every channel has its declared unit, unless ``configured`` replaces it. A missing unit is taken from the other
    channels of the same quantity. If they have none either, N is assumed for forces, POINT:UNITS for lengths, and their
    product for moments. If all channels declare N, this is used for forces only, and the units of moments and lengths
    count as missing.

    Raises UnusablePlateError if a channel declares an unknown unit or a unit of another quantity.
    """
    quantities = np.array(_QUANTITIES[kind])
    names = [strip_padding(name) for name in declared]
    only_newtons = {find_force_scale(name) for name in names} == {1.0} and len(set(quantities)) > 1
    factors = np.ones(len(quantities))
    assumptions: list[str] = []
    oddities: list[str] = []
    for quantity in dict.fromkeys(quantities.tolist()):
        at = np.flatnonzero(quantities == quantity)
        own = [names[i] for i in at]
        if (override := configured[quantity]) is not None:
            scale_of = _SCALES[quantity]
            other = sorted({name for name in own if name and scale_of(name) != scale_of(override)})
            if other:
                oddities.append(
                    f"its {quantity} channels declare {', '.join(other)}, the configuration says {override}: "
                    f"{override} was used"
                )
            own = [override] * len(own)
        elif only_newtons and quantity != "force":
            own = [""] * len(own)
        scales = [_SCALES[quantity](name) for name in own]
        wrong = sorted({name for name, scale in zip(own, scales, strict=True) if name and scale is None})
        if wrong:
            remedy = (
                f"if you know it, set `planarise: {{{quantity}_unit: …}}` in the configuration"
                if quantity != "point"
                else "export the file again with the units of its channels"
            )
            raise UnusablePlateError(
                f"its {quantity} channels declare {', '.join(map(repr, wrong))}, which is not a known unit of "
                f"{'length' if quantity == 'point' else quantity}; {remedy}"
            )
        if len(set(scales) - {None}) > 1:
            oddities.append(f"its {quantity} channels declare different units ({', '.join(own)}): each was converted")
        if None in scales:
            force = None if quantity == "force" else float(factors[0])
            assumed, sentence = _assume(quantity, own, scales, metres, force)
            scales = [assumed if scale is None else scale for scale in scales]
            assumptions.append(sentence)
        factors[at] = np.array(scales, dtype=np.float64)
    return factors, assumptions, oddities


def _assume(
    quantity: str, own: Sequence[str], scales: Sequence[float | None], metres: float, force: float | None
) -> tuple[float, str]:
    """Return the factor for channels without a declared unit, and a sentence that states the assumption."""
    known = {scale: name for scale, name in zip(scales, own, strict=True) if scale is not None}
    if len(known) > 1:
        raise UnusablePlateError(
            f"some of its {quantity} channels declare no unit, the others declare {', '.join(known.values())}; set "
            f"`planarise: {{{quantity}_unit: …}}` in the configuration"
        )
    length = {1e-3: "mm", 1e-2: "cm", 1.0: "m", 0.0254: "in"}[metres]
    if known:
        ((scale, name),) = known.items()
        return float(scale), f"some of its {quantity} channels declare no unit: {name} was assumed, as for the others"
    if quantity == "point":
        return metres, f"its centre-of-pressure channels declare no unit of length: {length} was assumed"
    if quantity == "moment" and force != 1.0:
        raise UnusablePlateError(
            "its moment channels declare no unit of moment, and its forces are not in N; set "
            "`planarise: {moment_unit: …}` in the configuration"
        )
    unit, scale = ("N", 1.0) if quantity == "force" else (f"N·{length}", metres)
    return scale, f"its {quantity} channels declare no unit of {quantity}: {unit} was assumed"
