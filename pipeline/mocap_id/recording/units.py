"""Declared units → SI. What is undeclared or ambiguous is refused, never guessed."""

from __future__ import annotations

import re

LENGTHS: dict[str, float] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 1e-2),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1e-3),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
}
"""Length units by name, in metres."""

_SHORTEST_PREFIX = 3


def length_scale(declared: str) -> float | None:
    """Metres per declared unit; None where the name is empty, unknown or an ambiguous truncation.

    C3D files cut strings short, so a prefix of three letters or more counts where every name it could stand for is
    the same unit.

    Examples
    --------
    >>> length_scale("MM"), length_scale("mete"), length_scale("furlong")
    (0.001, 1.0, None)
    """
    name = declared.strip().strip("\x00").strip("()").lower()
    if name in LENGTHS:
        return LENGTHS[name]
    if len(name) < _SHORTEST_PREFIX:
        return None
    meanings = {scale for full, scale in LENGTHS.items() if full.startswith(name)}
    return meanings.pop() if len(meanings) == 1 else None


_NEWTON = r"(?:n|nt|newton|newtons)"
_METRE = r"(?:m|meter|meters|metre|metres)"
_MILLIMETRE = r"(?:mm|millimeter|millimeters|millimetre|millimetres)"
_TIMES = r"[\s.*·x-]*"


def force_scale(declared: str) -> float | None:
    """Newtons per declared unit of a plate's force channel; None where the unit is not a force."""
    name = declared.strip().strip("\x00").lower()
    if re.fullmatch(_NEWTON, name):
        return 1.0
    return 1e3 if name in ("kn", "kilonewton") else None


def moment_scale(declared: str) -> float | None:
    """Newton metres per declared unit of a plate's moment channel; None where the unit is not a moment."""
    name = declared.strip().strip("\x00").lower()
    if re.fullmatch(_NEWTON + _TIMES + _MILLIMETRE, name):
        return 1e-3
    return 1.0 if re.fullmatch(_NEWTON + _TIMES + _METRE, name) else None
