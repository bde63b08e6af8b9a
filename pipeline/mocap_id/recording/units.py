"""Conversion factors from declared units to SI; unknown and ambiguous units have none."""

from __future__ import annotations

import re

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


def find_length_scale(declared: str) -> float | None:
    """Return the metres per declared unit; None if the name is empty, unknown or ambiguous.

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
    """Return the metres per unit of length in the user's ``units``; ConfigError if the unit is unknown."""
    scale = find_length_scale(units)
    if scale is None:
        raise ConfigError(f"units: {units!r} is not a unit of length; expected one of {', '.join(LENGTHS)}")
    return scale


def find_force_scale(declared: str) -> float | None:
    """Return the newtons per declared unit of force; None if the name is empty or not a force.

    Examples
    --------
    >>> find_force_scale("N"), find_force_scale("lbf"), find_force_scale("V")
    (1.0, 4.4482216152605, None)
    """
    return FORCES.get(_fold_case(declared))


def find_moment_scale(declared: str) -> float | None:
    """Return the newton metres per declared unit of moment; None if the name is empty or not a moment.

    The unit is a force and a length, with or without a separator. The length may come first, but without a separator
    only if it is in feet or inches, since ``mN`` is a millinewton.

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
    """Remove the padding of a text field."""
    return declared.strip().strip("\x00").strip()


def _fold_case(declared: str) -> str:
    """Convert a unit to lower case; ``mN`` becomes ``millinewton``, so that it differs from ``MN``."""
    return re.sub("^mN", "millinewton", strip_padding(declared)).lower()


def _join_names(names: dict[str, float]) -> str:
    return "|".join(sorted(names, key=len, reverse=True))


_TIMES = r"[\s.*·x-]"
_IMPERIAL = _join_names({**_FEET, **dict.fromkeys(("in", "inch", "inches"), 0.0254)})
_MOMENT = re.compile(
    rf"(?P<force>{_join_names(FORCES)}){_TIMES}*(?P<arm>{_join_names(_ARMS)})"
    rf"|(?P<first_arm>{_join_names(_ARMS)}){_TIMES}+(?P<second_force>{_join_names(FORCES)})"
    rf"|(?P<feet>{_IMPERIAL})(?P<last_force>{_join_names(FORCES)})"
)
