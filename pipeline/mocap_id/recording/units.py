"""Units: conversion factors to SI, and the units that the user configures."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from mocap_id.errors import ConfigError

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


SCALES: dict[str, Callable[[str], float | None]] = {
    "force": find_force_scale,
    "point": find_length_scale,
    "moment": find_moment_scale,
}
"""Functions for the units of the channels of a force plate, by quantity."""


@dataclass(frozen=True)
class ReadingOptions:
    """Options of :func:`mocap_id.recording.read`; ConfigError if a unit of force or moment is unknown."""

    units: str | None
    vertical: str | None  # checked by :func:`mocap_id.recording.model.check_axis`
    force_unit: str | None
    moment_unit: str | None
    unit_required: bool

    def __post_init__(self) -> None:
        for what, known in (("force", "N, kN, mN or lbf"), ("moment", "Nm, Nmm or ft.lbf")):
            unit = self.force_units.get(what)
            if unit is not None and SCALES[what](unit) is None:
                raise ConfigError(f"{what}_unit: {unit!r} is not a unit of {what}; expected a unit such as {known}")

    @property
    def force_units(self) -> dict[str, str]:
        """Configured units of force and moment by quantity, which replace the units in the file."""
        given = {"force": self.force_unit, "moment": self.moment_unit}
        return {what: unit for what, unit in given.items() if unit is not None}
